"""Pair lists in JSON, CSV and the format of the SuperGlue evaluations."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from sfmkit.datasets import pairs
from sfmkit.datasets.pair_list import FIELDS, pair_list
from sfmkit.datasets.pairs_with_gt import pairs_with_gt
from sfmkit.errors import InputError

K = [[90.0, 0, 49.5], [0, 91, 39.5], [0, 0, 1]]
R = [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]


@pytest.fixture
def folder(tmp_path):
    for name in ("a.png", "b.png", "c d.png"):
        Image.new("RGB", (100, 80)).save(tmp_path / name)
    return tmp_path


def write(folder: Path, entries: object) -> Path:
    file = folder / "mine.json"
    file.write_text(json.dumps(entries))
    return file


def test_json_list_holds_cameras_and_truth(folder):
    (folder / "K.txt").write_text("80 0 49.5\n0 80 39.5\n0 0 1\n")
    (folder / "points.txt").write_text("1 2 3 4\n5,6,7,8\n")
    file = write(
        folder,
        [
            {"image1": "a.png", "image2": "b.png", "K1": K, "R": R, "t": [1, 2, 3]},
            {
                "image1": str(folder / "a.png"),
                "image2": "c d.png",
                "camera1": "K.txt",
                "kind": "homography",
                "check_points": "points.txt",
                "name": "wall",
                "sequence": "s",
            },
        ],
    )
    first, second = pairs(file)
    assert (first.dataset, first.sequence, first.name) == ("mine", "mine", "1")
    assert (first.kind, second.kind) == ("two-view", "homography")
    np.testing.assert_array_equal(first.camera1.K, K)
    np.testing.assert_array_equal(first.camera2.K, K)
    np.testing.assert_array_equal(first.R, R)
    np.testing.assert_array_equal(first.t, [1, 2, 3])
    assert second.camera1.K[0, 0] == 80
    assert second.image1 == folder / "a.png"
    np.testing.assert_array_equal(second.check_points, [[1, 2, 3, 4], [5, 6, 7, 8]])
    assert [p.name for p in pairs(f"{file}:s")] == ["wall"]
    with pytest.raises(InputError, match="no sequence x; it has mine, s"):
        list(pairs(f"{file}:x"))


def test_csv_list_equals_the_json_list(folder):
    file = folder / "mine.csv"
    file.write_text(
        "\ufeffimage1,image2,K1,distortion1,H,check_points\n"
        "a.png,b.png,90 0 49.5 0 91 39.5 0 0 1,0.1 0.2,2 0 0 0 2 0 0 0 2,1 2 3 4;5 6 7 8\n"
        '"c d.png",b.png,,,,\n'
    )
    first, second = pairs(file)
    np.testing.assert_array_equal(first.camera2.K, K)
    np.testing.assert_array_equal(first.camera1.distortion[:2], [0.1, 0.2])
    np.testing.assert_array_equal(first.check_points, [[1, 2, 3, 4], [5, 6, 7, 8]])
    assert first.kind == "homography"
    assert second.camera1 is second.H is None


def test_images_may_be_in_another_folder(folder, tmp_path_factory):
    file = write(tmp_path_factory.mktemp("lists"), [{"image1": "a.png", "image2": "b.png"}])
    (pair,) = pairs(file, folder)
    assert pair.image2 == folder / "b.png"


GOOD = {"image1": "a.png", "image2": "b.png"}


@pytest.mark.parametrize(
    "entries, message",
    [
        ({"a": 1}, "must hold a list of pairs"),
        ([], "lists no pairs"),
        ([[1]], "pair 1: must be an object"),
        ([GOOD, {"image1": "a.png"}], "pair 2: image2: missing"),
        ([GOOD | {"image2": "no.png"}], "pair 1: image2: there is no image"),
        ([GOOD | {"image2": "\0"}], "pair 1: image2: there is no image"),
        ([GOOD | {"image1": 3}], "pair 1: image1: must be text"),
        ([GOOD | {"r": R}], "pair 1: unknown field r; the fields are image1"),
        ([GOOD | {"R": R}], "pair 1: .*R and t must be given together"),
        ([GOOD | {"R": [[1, 2]], "t": [0, 0, 1]}], "pair 1: R: must hold 3 x 3 numbers"),
        ([GOOD | {"R": np.diag([1, 1, -1]).tolist(), "t": [0, 0, 1]}], "not a rotation matrix"),
        ([GOOD | {"t": [1, 2, float("nan")]}], "pair 1: t: must hold finite numbers"),
        ([GOOD | {"t": [1, 2, 10**400]}], "pair 1: t: must hold"),
        ([GOOD | {"check_points": [[1, 2, 3]]}], "pair 1: check_points: must hold N x 4"),
        ([GOOD | {"check_points": []}], "pair 1: check_points: must hold finite"),
        ([GOOD | {"K1": K, "camera1": "K.txt"}], "pair 1: K1: give K1 or camera1"),
        ([GOOD | {"K2": np.zeros((3, 3)).tolist()}], "pair 1: K2: "),
        ([GOOD | {"camera2": "no such"}], "pair 1: camera2: "),
        ([GOOD | {"distortion1": [0.1]}], "pair 1: distortion1: needs K1"),
        ([GOOD | {"kind": "plane"}], "pair 1: kind: must be homography or two-view"),
    ],
)
def test_malformed_entries_are_named(folder, entries, message):
    with pytest.raises(InputError, match=message):
        list(pair_list(write(folder, entries)))


def test_files_that_are_not_lists(folder):
    for name, data in (("x.json", b"\xff\xfe\0"), ("x.json", b"[" * 10**5), ("x.csv", b"a\0b\n")):
        (folder / name).write_bytes(data)
        with pytest.raises(InputError):
            list(pair_list(folder / name))
    (folder / "x.csv").write_text("image1,image2\na.png,b.png,c\n")
    with pytest.raises(InputError, match="line 2: more cells"):
        list(pair_list(folder / "x.csv"))
    with pytest.raises(InputError, match="there is no file"):
        list(pairs(folder / "no.json"))
    (folder / "x.docx").write_text("")
    with pytest.raises(InputError, match="not a pair list"):
        list(pairs(folder / "x.docx"))


VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=2), inner),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(entry=st.dictionaries(st.sampled_from(FIELDS), VALUES))
def test_any_entry_is_a_pair_or_an_input_error(tmp_path_factory, entry):
    folder = tmp_path_factory.mktemp("any")
    Image.new("RGB", (100, 80)).save(folder / "a.png")
    message = ""
    try:
        list(pair_list(write(folder, [{"image1": "a.png", "image2": "a.png"} | entry])))
    except InputError as error:
        message = str(error)
    assert not message or "pair 1" in message


def gt_line(turns=(0, 0), K1=K, K2=K, T=None) -> str:
    T = np.block([[np.array(R), np.array([[1.0], [2], [3]])], [np.zeros(3), 1]]) if T is None else T
    numbers = np.concatenate([np.ravel(K1), np.ravel(K2), np.ravel(T)])
    return f"a.png b.png {turns[0]} {turns[1]} " + " ".join(map(repr, numbers.tolist()))


@pytest.mark.parametrize("turns", [(0, 0), (1, 0), (0, 2), (3, 1)])
def test_superglue_list_is_consistent_under_its_rotations(folder, turns):
    """A point projected into the turned images is the turned pixel of its projection."""
    marks = {"a.png": (31, 52), "b.png": (17, 9)}
    for name, (x, y) in marks.items():
        pixels = np.zeros((80, 100, 3), np.uint8)
        pixels[y, x] = 255
        Image.fromarray(pixels).save(folder / name)
    depth, Kinv = 5.0, np.linalg.inv(K)
    X1 = depth * Kinv @ (*marks["a.png"], 1)
    X2 = 4.0 * Kinv @ (*marks["b.png"], 1)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, X2 - np.array(R) @ X1
    (folder / "x_pairs_with_gt.txt").write_text(gt_line(turns, T=T) + "\n\n")
    (pair,) = pairs(folder / "x_pairs_with_gt.txt")
    found = []
    for image, turn in ((pair.image1, turns[0]), (pair.image2, turns[1])):
        rgb = np.asarray(Image.open(image) if isinstance(image, Path) else image)
        assert isinstance(image, Path) == (turn == 0)
        (y, x), *_ = np.argwhere(rgb[..., 0] == 255)
        found.append(np.array([x, y, 1.0]))
    for camera, image in ((pair.camera1, pair.image1), (pair.camera2, pair.image2)):
        shape = (80, 100) if isinstance(image, Path) else image.shape[:2]
        assert camera.size_wh == shape[::-1]
    projected = pair.camera2.K @ (
        pair.R @ (depth * np.linalg.inv(pair.camera1.K) @ found[0]) + pair.t
    )
    np.testing.assert_allclose(projected / projected[2], found[1], atol=1e-9)


def test_lists_without_rotations_hold_a_matrix_or_r_and_t(folder):
    """The three forms of a line describe the same pair."""
    words = gt_line().split()
    matrix = words[:2] + words[4:]
    T = np.array(words[22:], dtype=float).reshape(4, 4)
    pose = [repr(float(v)) for v in (*T[:3, :3].ravel(), *T[:3, 3])]
    r_and_t = matrix[:20] + pose
    assert (len(matrix), len(r_and_t)) == (36, 32)
    lines = [" ".join(line) for line in (words, matrix, r_and_t)]
    (folder / "pairs_calibrated.txt").write_text("\n".join(lines) + "\n")
    first, *others = pairs(folder / "pairs_calibrated.txt")
    for other in others:
        assert (other.image1, other.image2) == (first.image1, first.image2)
        for name in ("R", "t"):
            np.testing.assert_array_equal(getattr(other, name), getattr(first, name))
        for name in ("camera1", "camera2"):
            np.testing.assert_array_equal(getattr(other, name).K, getattr(first, name).K)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "lists no pairs"),
        ("a.png b.png\n", "line 1: 2 words; a line has 38"),
        ("\n" + gt_line().replace("90.0", "x") + "\n", "line 2: could not convert"),
        (gt_line().replace("a.png", "z.png"), "line 1: there is no image"),
        (gt_line(T=2 * np.eye(4)), "line 1: the last row"),
        (gt_line(T=np.diag([1, 1, 2, 1])), "line 1: .*rotation"),
        (gt_line(K1=np.zeros((3, 3))), "line 1: "),
        (gt_line(("q", 0)), "line 1: invalid literal"),
        (gt_line(T=np.full((4, 4), np.nan)), "line 1: "),
    ],
)
def test_malformed_superglue_lists(folder, text, message):
    (folder / "x.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        list(pairs_with_gt(folder / "x.txt"))
