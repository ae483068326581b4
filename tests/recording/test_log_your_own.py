"""The log functions on plain arrays, each read back from the file and compared with the arrays."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up_result import make_result

import sfmkit.recording as recording
from sfmkit.errors import InputError
from sfmkit.viz.colours import operator_rgb

PAGE = Path(__file__).parents[2] / "docs" / "log-your-own.md"
SIZES = ((320, 240), (320, 240))


@pytest.fixture
def rec():
    return recording.new_stream("test")


def read(rec, folder: Path) -> recording.Recording:
    return recording.read_recording(recording.write_stream(rec, folder / "a.rrd"))


def own(read, entity: str, name: str) -> np.ndarray:
    return read.latest(entity)[f"sfmkit:{name}"]


def test_the_code_of_the_page_runs_and_uses_every_public_function(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    namespace: dict = {}
    for block in blocks:
        line = text[: text.index(block)].count("\n")
        exec(compile("\n" * line + block, str(PAGE), "exec"), namespace)
    written = recording.read_recording(tmp_path / "mine.rrd")
    assert own(written, "/world/cam1/image/keypoints/mine", "depth").shape == (300, 1)
    for stage in ("detect", "match", "estimate", "pose", "triangulate", "refine"):
        number = recording.STAGES.index(stage)
        assert any(
            item.times.get("stage") == number
            for entity in written.entities
            for item in written.logged(entity)
        ), stage


def test_keypoints_of_plain_arrays(rec, tmp_path):
    g = np.random.default_rng(0)
    x = g.uniform(0, 200, (50, 2))
    angles = g.uniform(-3, 3, 50)
    recording.log_keypoints(
        rec, 2, x, operator="mine", scales=np.full(50, 6.0), angles=angles, details={"a": range(50)}
    )
    written = read(rec, tmp_path)
    at = "/world/cam2/image/keypoints/mine"
    np.testing.assert_allclose(written.latest(at)["Points2D:positions"], x, rtol=1e-6)
    np.testing.assert_allclose(own(written, at, "angle_deg"), np.degrees(angles), rtol=1e-6)
    assert own(written, at, "a").tolist() == list(range(50))
    ticks = np.array(written.latest("/world/cam2/image/regions/mine/ticks")["LineStrips2D:strips"])
    np.testing.assert_allclose(np.linalg.norm(ticks[:, 1] - ticks[:, 0], axis=1), 3, rtol=1e-4)


def test_keypoints_are_counted_per_cell_and_the_colour_bar_has_the_numbers(rec, tmp_path):
    # Cells of 8 px in an image of 320 x 240: 200 keypoints in one, 10 in another, none elsewhere.
    x = np.concatenate([np.full((200, 2), (4.0, 12.0)), np.full((10, 2), (315.0, 235.0))])
    recording.log_keypoints(rec, 1, x, operator="mine", size_wh=SIZES[0])
    written = read(rec, tmp_path)
    assert SIZES[0] == (320, 240)
    at = "/world/cam1/image/coverage/mine"
    shades = np.array(written.latest(at)["SegmentationImage:buffer"][0]).reshape(30, 40)
    assert np.argwhere(shades).tolist() == [[1, 0], [29, 39]]
    assert shades[1, 0] == 64
    assert shades[29, 39] == np.ceil(64 * np.log(11) / np.log(201))
    np.testing.assert_allclose(written.latest(at)["Transform3D:scale"][0], [8, 8, 1])
    words = written.latest("/scale/coverage/ticks")["Points2D:labels"]
    assert list(words) == ["1", "10", "50", "\u2265 200"]


def test_the_colour_bar_of_the_parallax_has_its_percentiles(rec, tmp_path):
    g = np.random.default_rng(0)
    parallax = g.uniform(1, 5, 500)
    recording.log_cloud(rec, g.uniform(1, 2, (500, 3)), parallax_deg=parallax)
    words = read(rec, tmp_path).latest("/scale/parallax/ticks")["Points2D:labels"]
    low, high = np.percentile(parallax, (5, 95))
    expected = [low, (low + high) / 2, high]
    np.testing.assert_allclose(
        [float(w.strip("\u2264\u2265 ")) for w in words], expected, atol=0.05
    )


def test_few_neighbourhoods_are_drawn_and_spread_over_the_image(rec, tmp_path):
    g = np.random.default_rng(0)
    crowd = g.normal(50, 3, (2000, 2))  # strong keypoints in one place
    rest = g.uniform(0, 300, (2000, 2))
    scores = np.concatenate([np.full(2000, 2.0), np.full(2000, 1.0)])
    x = np.concatenate([crowd, rest])
    recording.log_keypoints(rec, 1, x, scales=np.ones(4000), scores=scores, max_regions=100)
    rows = own(read(rec, tmp_path), "/world/cam1/image/regions/multi", "keypoint")
    assert len(rows) == 100
    quadrants = {(bool(a), bool(b)) for a, b in x[rows] > 150}
    assert len(quadrants) == 4


def test_matches_join_both_images_and_carry_their_columns(rec, tmp_path):
    g = np.random.default_rng(0)
    x1, x2 = g.uniform(0, 200, (2, 500, 2))
    for kind in ("tentative", "merged", "inliers", "outliers"):
        recording.log_matches(
            rec, x1, x2, width1=320, operator="mine", kind=kind, details={"row": np.arange(500)}
        )
    written = read(rec, tmp_path)
    for kind, stage in (("tentative", 2), ("merged", 3), ("inliers", 4), ("outliers", 4)):
        at = f"/matches/{kind}/mine"
        strips, rows = np.array(written.latest(at)["LineStrips2D:strips"]), own(written, at, "row")
        np.testing.assert_allclose(strips[:, 0], x1[rows], rtol=1e-5)
        np.testing.assert_allclose(strips[:, 1] - x2[rows], [[326, 0]] * 80, atol=1e-3)
        assert {i.times["stage"] for i in written.logged(at)} == {stage}
    assert len(written.latest("/world/cam2/image/outliers/mine")["Points2D:positions"]) == 500
    assert "/world/cam1/image/tentative/mine" not in written


def test_epipolar_lines_pass_through_the_points_and_the_epipoles(rec, tmp_path):
    # Forward motion: both epipoles are at the principal point, and lines are radial.
    K = np.array([[300, 0, 160.0], [0, 300, 120], [0, 0, 1]])
    t = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0.0]])  # of t = (0, 0, 1)
    F = np.linalg.inv(K).T @ t @ np.linalg.inv(K)
    x1 = np.array([[200.0, 150], [100, 60], [40, 200]])
    recording.log_epipolar_lines(rec, F, x1, sizes_wh=SIZES)
    written = read(rec, tmp_path)
    for image in (1, 2):
        epipole = written.latest(f"/world/cam{image}/image/epipole")["Points2D:positions"]
        np.testing.assert_allclose(epipole, [[160, 120]], atol=1e-3)
    assert "/world/cam1/image/epipolar/lines" not in written  # needs x2
    strips = np.array(written.latest("/world/cam2/image/epipolar/lines")["LineStrips2D:strips"])
    for x, (a, b) in zip(x1, strips):
        for p in (x, np.array([160.0, 120])):
            off = (b - a)[0] * (p - a)[1] - (b - a)[1] * (p - a)[0]
            assert abs(off) / np.linalg.norm(b - a) < 1e-3
        assert (np.array([a, b]) > -0.501).all()
        assert (np.array([a, b]) < (319.501, 239.501)).all()


def test_a_homography_warps_the_corners(rec, tmp_path):
    recording.log_homography(rec, np.diag([2.0, 2.0, 1.0]), sizes_wh=SIZES)
    written = read(rec, tmp_path)
    for image, factor in ((1, 0.5), (2, 2.0)):
        (outline,) = written.latest(f"/world/cam{image}/image/homography")["LineStrips2D:strips"]
        np.testing.assert_allclose(np.min(outline, 0), [-0.5 * factor] * 2, atol=1e-4)
        np.testing.assert_allclose(np.max(outline, 0), [319.5 * factor, 239.5 * factor], atol=1e-4)


def test_motion_marks_the_true_pose(rec, tmp_path):
    result = make_result(noise_px=0, outliers=0)
    view, corr = result.two_view, result.correspondences
    cameras = (view.camera1, view.camera2)
    counts = recording.log_motion(rec, view.E, corr.x1, corr.x2, cameras)
    assert sorted(counts)[-1] == len(corr)
    assert sorted(counts)[-2] < len(corr)
    written = read(rec, tmp_path)
    for pose in range(1, 5):
        assert own(written, f"/world/poses/{pose}/count", "in_front")[0] == counts[pose - 1]
    place = written.latest("/world/cam2")
    np.testing.assert_allclose(place["Transform3D:translation"][0], view.t, atol=1e-6)


def test_a_cloud_of_arrays_has_the_layers_that_it_has_values_for(rec, tmp_path):
    g = np.random.default_rng(0)
    X = g.uniform(-1, 1, (40, 3)) + [0, 0, 5]
    recording.log_cloud(rec, X, operators=["a", "orb"] * 20, parallax_deg=np.arange(40.0))
    written = read(rec, tmp_path)
    assert set(written.below("/world/points")) == {"operator", "density", "parallax"}
    logged = written.latest("/world/points/operator")
    np.testing.assert_allclose(logged["Points3D:positions"], X, rtol=1e-6)
    r, g_, b = operator_rgb("orb")
    assert logged["Points3D:colors"][1] == r << 24 | g_ << 16 | b << 8 | 255
    shades = written.latest("/world/points/parallax")["Points3D:colors"]
    assert len(np.unique(shades)) > 30


def test_rays_start_at_both_centres(rec, tmp_path):
    X, c2 = np.array([[0, 0, 5.0], [1, 0, 4]]), np.array([1.0, 0, 0])
    recording.log_rays(rec, X, c2, x1=[[10, 20], [30, 40]], names=["p", "q"])
    written = read(rec, tmp_path)
    strips = np.array(written.latest("/world/rays")["LineStrips3D:strips"])
    np.testing.assert_allclose(strips, [[[0] * 3, x] for x in X] + [[c2, x] for x in X])
    assert written.latest("/world/cam1/image/chosen")["Points2D:labels"].tolist() == ["p", "q"]


def test_hypotheses_refinement_steps_and_runs_have_their_timelines(rec, tmp_path):
    result = make_result(outliers=0)
    view, corr = result.two_view, result.correspondences
    recording.log_ransac(
        rec, [view.F] * 3, [10, 20, 30], corr.x1, corr.x2, sizes_wh=SIZES, scores=[0.1, 0.2, 0.3]
    )
    recording.log_refinement(rec, [4.0, 2.0, 1.0], [(view.R, view.t)] * 3, camera=view.camera2)
    recording.log_runs(rec, [{"name": "a", "error": 1.0}, {"name": "b", "error": np.inf}])
    written = read(rec, tmp_path)

    def series(entity: str, timeline: str) -> dict[int, float]:
        return {
            i.times[timeline]: float(i.values[0])
            for i in written.logged(entity)
            if i.component == "Scalars:scalars"
        }

    assert series("/estimation/inliers", "iteration") == {0: 10, 1: 20, 2: 30}
    assert series("/refinement/cost", "step") == {0: 4, 1: 2, 2: 1}
    assert series("/runs/error", "run") == {0: 1.0}  # infinite errors are in the text only
    rows = [i for i in written.logged("/runs/row") if i.component == "TextDocument:text"]
    assert [i.times["run"] for i in rows] == [0, 1]
    assert "| error | inf |" in rows[1].values[0]
    moved = [i.times["step"] for i in written.logged("/world/refinement")]
    assert set(moved) == {0, 1, 2}


def test_a_prefix_moves_every_entity(rec, tmp_path):
    x = np.array([[1.0, 2], [30, 40]])
    recording.log_keypoints(rec, 1, x, prefix="here")
    recording.log_matches(rec, x, x, width1=320, kind="inliers", prefix="here")
    recording.log_cloud(rec, [[0, 0, 1.0], [0, 1, 2]], prefix="here")
    assert all(e.startswith("/here/") for e in read(rec, tmp_path).entities)


def test_a_stream_can_be_written_again_after_more_was_logged(rec, tmp_path):
    recording.log_keypoints(rec, 1, np.zeros((1, 2)), operator="a")
    first = read(rec, tmp_path)
    recording.log_keypoints(rec, 1, np.zeros((1, 2)), operator="b")
    second = read(rec, tmp_path)
    at = "/world/cam1/image/keypoints"
    assert first.below(at) == ("a",)
    assert set(second.below(at)) == {"a", "b"}


def test_recordings_with_one_name_are_merged(tmp_path):
    parts = []
    for k in range(3):
        rec = recording.new_stream("lesson")
        recording.log_keypoints(rec, 1, np.zeros((1, 2)), operator=f"op{k}")
        parts.append(recording.write_stream(rec, tmp_path / f"{k}.rrd"))
    whole = recording.read_recording(recording.merge_recordings(tmp_path / "whole.rrd", parts))
    assert set(whole.below("/world/cam1/image/keypoints")) == {"op0", "op1", "op2"}
    rec = recording.new_stream("other")
    recording.log_keypoints(rec, 1, np.zeros((1, 2)))
    other = recording.write_stream(rec, tmp_path / "other.rrd")
    with pytest.raises(InputError, match="different ids"):
        recording.merge_recordings(tmp_path / "whole.rrd", [*parts, other])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda rec: recording.log_keypoints(rec, 3, np.zeros((1, 2))), "image must be 1 or 2"),
        (lambda rec: recording.log_keypoints(rec, 1, np.zeros((1, 3))), "xy must be N x 2"),
        (lambda rec: recording.log_keypoints(rec, 1, [[np.nan, 0]]), "NaN"),
        (lambda rec: recording.log_keypoints(rec, 1, [[0, 0]], scales=[1, 2]), "scale_px has 2"),
        (lambda rec: recording.log_matches(rec, [[0, 0]], [[0, 0]]), "width1"),
        (lambda rec: recording.log_matches(rec, [[0, 0]], [[0, 0]] * 2, width1=9), "1 x 2"),
        (lambda rec: recording.log_matches(rec, [], [], width1=9, kind="good"), "kind must be"),
        (lambda rec: recording.log_cloud(rec, np.zeros((3, 2))), "points must be"),
        (lambda rec: recording.log_uncertainty(rec, np.ones((3, 3))), "need covariances"),
        (lambda rec: recording.log_refinement(rec, [1.0], [(0, 0)]), "need `camera`"),
        (lambda rec: recording.make_blueprint(["Nowhere"]), "there is no page"),
    ],
)
def test_wrong_arrays_are_refused_before_anything_is_logged(rec, call, words):
    with pytest.raises(InputError, match=words):
        call(rec)


def test_lines_are_clipped_to_the_image():
    from sfmkit.geometry.lines import clip_lines

    lines = torch.tensor([[0.0, 1, -5], [0, 1, -50], [0, 0, 0], [1, -1, 0]], dtype=torch.float64)
    segments, crosses = clip_lines(lines, (20, 10))
    assert crosses.tolist() == [True, False, False, True]
    assert sorted(segments[0].tolist()) == [[-0.5, 5], [19.5, 5]]
    np.testing.assert_allclose(np.sort(segments[3][:, 0]), [-0.5, 9.5])
    wide, _ = clip_lines(lines[:1], (20, 10), margin=3)
    assert sorted(wide[0].tolist()) == [[-3.5, 5], [22.5, 5]]
