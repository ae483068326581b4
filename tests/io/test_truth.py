"""True poses from files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from sfmkit.errors import InputError
from sfmkit.io.truth import read_truth

K = np.array([[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]])


CAMERA_FILE = "500 0 319.5 \n0 510 239.5 \n0 0 1 \n0 0 0\n{} \n{} \n{} \n{} \n640 480"


def camera_file(path: Path, R: np.ndarray, C: np.ndarray) -> Path:
    path.write_text(CAMERA_FILE.format(*(" ".join(map(repr, row.tolist())) for row in (*R, C))))
    return path


def rotation(axis: list[float], degrees: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    W, a = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), math.radians(degrees)
    return np.eye(3) + math.sin(a) * W + (1 - math.cos(a)) * W @ W


def test_truth_from_camera_files_moves_points_from_one_camera_to_the_other(tmp_path):
    R1, R2 = rotation([1, 2, 3], 40), rotation([3, -1, 0.5], 65)
    C1, C2 = np.array([1.0, -2, 0.5]), np.array([-3.0, 0.7, 2])
    a = camera_file(tmp_path / "1.jpg.camera", R1, C1)
    b = camera_file(tmp_path / "2.jpg.camera", R2, C2)
    X = np.random.default_rng(0).normal(size=(5, 3))
    X1, X2 = (X - C1) @ R1, (X - C2) @ R2  # x_cam = R^T (X - C)
    for source, images in ((f"{a},{b}", ()), (tmp_path, ("x/1.jpg", Path("2.jpg")))):
        R, t = read_truth(source, *images)
        assert np.allclose(X2, X1 @ R.T + t)


def test_truth_from_json(tmp_path):
    R = rotation([0, 1, 0], 10)
    (tmp_path / "truth.json").write_text(
        json.dumps({"K": K.tolist(), "R": R.tolist(), "t": [1, 0, 0.2]})
    )
    assert np.array_equal(read_truth(tmp_path / "truth.json")[0], R)
    assert read_truth(tmp_path / "truth.json")[1].tolist() == [1, 0, 0.2]


@pytest.mark.parametrize(
    "content,message",
    [
        ("{}", "must hold"),
        ("[1]", "must hold"),
        ("x", "not valid JSON"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,-1]], "t": [1,0,0]}', "not a rotation"),
        ('{"R": [[2,0,0],[0,1,0],[0,0,1]], "t": [1,0,0]}', "not a rotation"),
        ('{"R": [[1,0],[0,1]], "t": [1,0,0]}', "not a rotation"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": [1,0]}', "three finite numbers"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": [1,0,NaN]}', "three finite numbers"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": "left"}', "must be numbers"),
    ],
)
def test_files_that_are_not_ground_truth(tmp_path, content, message):
    (tmp_path / "t.json").write_text(content)
    with pytest.raises(InputError, match=message):
        read_truth(tmp_path / "t.json")


def test_truth_that_is_not_there(tmp_path):
    good = camera_file(tmp_path / "a.camera", np.eye(3), np.zeros(3))
    (tmp_path / "b.camera").write_text("1 2 3\n")
    for source, images, message in (
        (tmp_path / "none.json", (), "no file"),
        (f"{good},{tmp_path / 'none.camera'}", (), r"no file .*none\.camera"),
        (f"{good},{tmp_path / 'b.camera'}", (), r"b\.camera is not a \.camera file"),
        (f"{good},{good},{good}", (), "names 3 files"),
        (tmp_path, (), "the names of both images are needed"),
        (tmp_path, ("1.jpg", "2.jpg"), r"no file .*1\.jpg\.camera"),
    ):
        with pytest.raises(InputError, match=message):
            read_truth(source, *images)


@pytest.mark.data
def test_strecha_truth_puts_the_matrices_of_both_views_in_one_frame(data_dir):
    """The fountain's cameras stand on an arc: each turns by a few degrees towards the same
    scene."""
    folder = data_dir / "strecha" / "fountain-P11" / "gt_dense_cameras"
    R, t = read_truth(folder, "0000.jpg", "0001.jpg")
    same = read_truth(f"{folder / '0000.jpg.camera'},{folder / '0001.jpg.camera'}")
    assert np.array_equal(R, same[0])
    back_R, back_t = read_truth(folder, "0001.jpg", "0000.jpg")
    assert np.allclose(back_R, R.T, atol=1e-5)
    assert np.allclose(back_t, -R.T @ t, atol=1e-4)
    assert 1 < math.degrees(math.acos((np.trace(R) - 1) / 2)) < 20
