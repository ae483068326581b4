"""The lives of keypoints and matches against the arrays that were recorded."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from made_up_result import LONELY, OPERATORS, OUTLIERS, POINTS, make_result

from sfmkit.cli import main
from sfmkit.errors import SfmError
from sfmkit.recording import RecordingError, read_recording, save_recording
from sfmkit.recording.inspection import (
    describe_pixel,
    diff_recordings,
    keypoint_life,
    match_life,
    read_tables,
    rejections,
)

RESULT = make_result()


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("lives") / "a.rrd"
    save_recording(path, RESULT)
    return path


@pytest.fixture(scope="module")
def tables(path):
    return read_tables(read_recording(path))


def test_the_tables_hold_what_was_recorded(tables):
    corr, cloud = RESULT.correspondences, RESULT.cloud
    np.testing.assert_allclose(tables.matches.x1, corr.x1, rtol=1e-6)
    np.testing.assert_array_equal(tables.matches.kept, corr.operator_id)
    np.testing.assert_array_equal(tables.matches.mask, corr.operator_mask)
    np.testing.assert_array_equal(tables.matches.keypoint2, corr.index2)
    np.testing.assert_array_equal(tables.points.rgb, cloud.rgb)
    for name in OPERATORS:
        m, pair = RESULT.matches[name], tables.keypoints[name]
        np.testing.assert_array_equal(pair[0].partner[m.index1], m.index2)
        np.testing.assert_array_equal(pair[1].partner[m.index2], m.index1)
        assert (pair[0].partner >= 0).sum() == len(m)


def test_the_life_of_an_inlier(tables):
    life = match_life(tables, 4)  # kept by orb, also found by fast-brief
    steps = dict(life.steps)
    assert (life.fate, life.point) == ("point", 4)
    assert "position of orb was kept; found by orb, fast-brief" in steps["fused"]
    assert "fast-brief keypoints" in str(life)
    assert f"error {float(RESULT.cloud.reprojection_error[4]):.2f} px" in steps["quality"]
    assert f"parallax {float(RESULT.cloud.parallax[4]):.2f} deg" in steps["quality"]
    merged = int(np.flatnonzero(tables.keypoints["fast-brief"][1].match == 4)[0])
    other = keypoint_life(tables, "fast-brief", 2, merged)
    assert (other.match, other.point) == (4, 4)
    assert "merged into match 4 of orb" in dict(other.steps)["fused"]


def test_lives_that_end(tables):
    life = match_life(tables, POINTS)
    assert life.point is None
    assert life.fate.startswith("outlier")
    assert life.steps[-1][1].startswith("ended here: ")
    lonely = keypoint_life(tables, "surf", 1, len(tables.keypoints["surf"][0].xy) - 1)
    assert lonely.fate == "unmatched"
    assert "nearest descriptor in both directions" in str(lonely)


def test_rejections_are_counted(tables):
    found = rejections(tables)
    assert sum(r.count for r in found if r.stage == "estimate") == OUTLIERS
    assert all(r.count == LONELY for r in found if r.stage == "match")
    merged = {r.operator: r.count for r in found if r.stage == "fuse"}
    assert merged == {name: RESULT.correspondences.counts[name].merged for name in OPERATORS}
    mine = [r for r in rejections(tables, "orb") if r.stage == "estimate"]
    bits = RESULT.correspondences.operator_mask.numpy()[POINTS:] >> 1 & 1
    assert sum(r.count for r in mine) == bits.sum()
    for r in mine:
        assert all(match_life(tables, n).fate == r.reason for n in r.examples)


def test_a_pixel(path, tables):
    x, y = RESULT.features["surf"][1].keypoints[7]
    words = describe_pixel(path, x, y, image=2)
    assert str(keypoint_life(tables, "surf", 2, 7)) in words


@pytest.mark.parametrize(
    "options, error",
    [
        (["--pixel", "1"], "two numbers"),
        (["--pixel", "nan,1"], "finite"),
        (["--pixel", "320,1"], "outside image 1"),
        (["--image", "2"], "needs --pixel"),
        (["--match", str(POINTS + OUTLIERS)], f"has 0 to {POINTS + OUTLIERS - 1}"),
        (["--match", "1", "--operator", "orb"], "at a time"),
        (["--rejected", "--operator", "orbb"], "Did you mean"),
    ],
)
def test_bad_questions(path, options, error):
    done = CliRunner().invoke(main, ["inspect", str(path), *options])
    assert done.exit_code == 2
    assert error in done.stderr


def test_the_questions_as_commands(path):
    for options, words in (
        (["--match", "4"], r"match 4 of 340: point"),
        (["--rejected"], r"estimate +outlier: .* of 340"),
        (["--pixel", "100,100"], r"\(100, 100\) of image 1"),
    ):
        done = CliRunner().invoke(main, ["inspect", str(path), *options])
        assert done.exit_code == 0
        assert re.search(words, done.output)


def test_scenes_of_the_same_names_and_sizes_are_distinguished(path, tmp_path):
    save_recording(tmp_path / "b.rrd", make_result(seed=1))
    with pytest.raises(RecordingError, match="different photographs"):
        diff_recordings(path, tmp_path / "b.rrd")


def test_a_recording_without_geometry(tmp_path):
    n = len(RESULT.correspondences)
    view = replace(RESULT.two_view, R=None, t=None, E=None, F=None, H=None)
    save_recording(tmp_path / "a.rrd", replace(RESULT, two_view=view, cloud=None))
    tables = read_tables(read_recording(tmp_path / "a.rrd"))
    for k in (0, n - 1):
        assert match_life(tables, k).point is None


def test_errors_are_ours(tables):
    with pytest.raises(SfmError):
        keypoint_life(tables, "orb", 1, 10**6)
