"""The benchmarks of the field: poses of listed pairs, and the sequences of HPatches."""

from __future__ import annotations

import numpy as np
import PIL.Image
import pytest
from click.testing import CliRunner
from small_sweep import HEIGHT, WIDTH, pairs, texture

from sfmkit import detect, read_image
from sfmkit.cli.bench import bench
from sfmkit.errors import InputError
from sfmkit.evaluation.pairs import RESULT, bench_pairs
from sfmkit.evaluation.pairs_tables import pairs_result
from sfmkit.matching.nearest import match
from sfmkit.metrics import match_errors, mean_matching_accuracy
from sfmkit.reports.result import read_result


def make_hpatches(root) -> None:
    """Two sequences in the published layout: shifted crops, and one crop that becomes darker."""
    whole = texture()
    for name, shifts in (("v_shift", (3, 5, 8, 11, 14)), ("i_dark", (0, 0, 0, 0, 0))):
        folder = root / "hpatches" / name
        folder.mkdir(parents=True)
        for k, d in enumerate((0, *shifts), start=1):
            crop = whole[40 + d : 40 + d + HEIGHT, 40 + d : 40 + d + WIDTH]
            crop = crop if name == "v_shift" else (crop * (1 - 0.12 * (k - 1))).astype(np.uint8)
            PIL.Image.fromarray(crop).save(folder / f"{k}.ppm")
            if k > 1:
                (folder / f"H_1_{k}").write_text(f"1 0 {-d}\n0 1 {-d}\n0 0 1\n")


def test_hpatches_gives_matching_accuracy_by_the_kind_of_change(tmp_path):
    make_hpatches(tmp_path)
    out = tmp_path / "out"
    command = ["hpatches", "--data", str(tmp_path), "--operators", "orb", "--out", str(out)]
    done = CliRunner().invoke(bench, command, catch_exceptions=False)
    assert done.exit_code == 0
    result = read_result(out)
    assert result.name == "hpatches"
    tables = {table.name: table for table in result.tables}
    accuracy = {row[1]: row for row in tables["matching-accuracy"].rows}
    assert {part: row[2] for part, row in accuracy.items()} == {
        "all pairs": 10,
        "illumination": 5,
        "viewpoint": 5,
    }
    first = detect(read_image(tmp_path / "hpatches/v_shift/1.ppm"), "orb")
    expected = []
    for k, d in zip(range(2, 7), (3, 5, 8, 11, 14)):
        other = detect(read_image(tmp_path / f"hpatches/v_shift/{k}.ppm"), "orb")
        H = np.array([[1.0, 0, -d], [0, 1, -d], [0, 0, 1]])
        errors = match_errors(first, other, match(first, other), H)
        expected.append(mean_matching_accuracy(errors))
    assert accuracy["viewpoint"][4:] == pytest.approx(np.mean(expected, axis=0)[[0, 1, 2, 4, 9]])
    whole = np.array(accuracy["all pairs"][4:], dtype=float)
    parts = np.array([accuracy[p][4:] for p in ("illumination", "viewpoint")], dtype=float)
    np.testing.assert_allclose(whole, parts.mean(0))
    measures = {row[1]: row[2:] for row in tables["homography-auc"].rows}
    assert measures["mean of max(0, 1 - e/T)"][-1] > 0.95

    command = [*command[:-1], str(tmp_path / "less"), "--without", "i_dark"]
    assert CliRunner().invoke(bench, command, catch_exceptions=False).exit_code == 0
    less = {table.name: table for table in read_result(tmp_path / "less").tables}
    assert [row[1] for row in less["homographies"].rows] == [5]


def test_pose_takes_only_pairs_with_true_poses(tmp_path):
    _, plane, view = pairs(tmp_path / "data", homographies=2, two_views=1)
    numbers = [*view.camera1.K.ravel(), *view.camera2.K.ravel(), *view.R.ravel(), *view.t]
    listed = tmp_path / "data" / "pairs_calibrated.txt"
    listed.write_text(" ".join(["img1.png", "img4.png", *map(repr, map(float, numbers))]) + "\n")
    out = tmp_path / "out"
    command = ["pose", "--data", str(listed), "--operators", "orb", "--out", str(out)]
    done = CliRunner().invoke(bench, command, catch_exceptions=False)
    assert done.exit_code == 0
    result = read_result(out)
    assert result.name == "pose"
    assert [table.name for table in result.tables] == ["poses", "auc", "pose-pairs", "seconds"]
    homography = tmp_path / "data" / "plane.json"
    homography.write_text(
        f'[{{"image1": "img1.png", "image2": "img3.png", "H": {plane.H.tolist()}}}]'
    )
    with pytest.raises(InputError, match=r"no pair of .*plane\.json has a true pose"):
        bench_pairs([homography], tmp_path / "none", operators=("orb",), truth="pose")
    rows = bench_pairs([homography, listed], tmp_path / "both", operators=("orb",), truth="pose")
    assert [row["problem"] for row in rows] == ["two-view"]


def test_areas_of_homographies_have_their_closed_form():
    """Errors of 0.5 and 4 pixels, and one refused pair."""
    rows = [
        {
            **{"kind": RESULT, "dataset": "d", "sequence": "s", "pair": str(k), "digest": str(k)},
            **{"problem": "homography", "has_truth": True, "operator": "orb", "seed": 0},
            **{"corner_error_px": e, "check_error_px": None, "error": e, "refused": e is None},
            **{"verdict": "general", "matches": 9, "inliers": 9, "seconds": {"detect": 1.0}},
        }
        for k, e in enumerate((0.5, 4.0, None))
    ]
    tables = {table.name: table for table in pairs_result(rows, "command", "hpatches").tables}
    mean, trapezoidal = (row[2:] for row in tables["homography-auc"].rows)
    assert mean == pytest.approx([0.5 / 3, (5 / 6) / 3, (0.9 + 0.2) / 3, (0.95 + 0.6) / 3])
    # (0, 0), (0.5, 1/3), (4, 2/3), constant after the last error below T
    rise = 0.5 / 6
    assert trapezoidal[0] == pytest.approx(rise + 0.5 / 3)
    assert trapezoidal[2] == pytest.approx((rise + 3.5 / 2 + 2 / 3) / 5)
    assert "matching-accuracy" not in tables
