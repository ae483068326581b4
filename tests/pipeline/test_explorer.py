"""The explorer compared with the rendered truth and OpenCV, and its widgets."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from sfmkit.datasets.synthetic import demo_pair
from sfmkit.errors import InputError
from sfmkit.options import DetectOptions, Options
from sfmkit.pipeline.explorer import EpipolarExplorer
from sfmkit.pipeline.reconstruction import reconstruct


@pytest.fixture(scope="module")
def result():
    image1, image2, truth = demo_pair()
    return reconstruct(
        image1,
        image2,
        truth,
        ("orb", "fast-brief"),
        options=Options(detect=DetectOptions(max_size=800, budget=2000)),
    )


@pytest.fixture(scope="module")
def truth():
    values = json.loads(demo_pair()[2].read_text())
    return SimpleNamespace(**{k: np.array(values[k]) for k in ("R", "t", "K", "K2")})


def true_pixel(truth, x1, depth):
    X1 = depth * np.linalg.inv(truth.K) @ [*x1, 1]
    x2 = truth.K2 @ (truth.R @ X1 + truth.t)
    return x2[:2] / x2[2]


@pytest.mark.parametrize("x1", [(300.0, 400.0), (800.5, 600.25), (1400.0, 1000.0)])
def test_the_line_passes_through_the_rendered_position(result, truth, x1):
    view = EpipolarExplorer(result).look(x1)
    for depth in (4.0, 9.0, 40.0):
        x2 = true_pixel(truth, x1, depth)
        assert abs(view.line[:2] @ x2 + view.line[2]) < 0.5
    by_opencv = cv2.computeCorrespondEpilines(np.array([x1]), 1, result.two_view.F.numpy())[0, 0]
    assert np.allclose(view.line, by_opencv * np.sign(by_opencv @ view.line), atol=1e-4)
    assert np.allclose(view.curve @ view.line[:2] + view.line[2], 0, atol=1e-6)
    assert np.allclose(np.cross(view.ray, np.linalg.inv(truth.K) @ [*x1, 1]), 0, atol=1e-12)


def test_the_candidates_are_exactly_the_keypoints_in_the_band(result):
    explorer = EpipolarExplorer(result, band_px=3.0)
    view = explorer.look((700.0, 500.0))
    expected = 0
    for _, f2 in result.features.values():
        away = np.abs(f2.keypoints.astype(float) @ view.line[:2] + view.line[2])
        expected += int((away <= 3).sum())
    assert len(view.candidates) == expected > 10
    distances = [c.distance_px for c in view.candidates]
    assert distances == sorted(distances)
    c = view.candidates[5]
    assert np.allclose(result.features[c.operator][1].keypoints[c.row], c.x2)


def test_keypoints_outside_the_field_of_the_lens_are_not_candidates(result):
    view = result.two_view
    d = np.array([-3.0, 0, 0, 0, 0])  # folds back within the image
    folded = replace(view, camera2=replace(view.camera2, distortion=d))
    explorer = EpipolarExplorer(replace(result, two_view=folded))
    found = explorer.look((800.0, 600.0)).candidates
    reach = np.linalg.norm([np.subtract(c.x2, view.camera2.K[:2, 2]) for c in found], axis=1)
    assert len(found)
    assert reach.max() < view.camera2.K[0, 0] * 2 / 9  # r (1 - 3 r^2) has its maximum at r = 1/3


def test_an_inlier_is_found_from_its_own_pixel_with_its_point(result):
    cloud, corr = result.cloud, result.correspondences
    k = len(cloud) // 2
    match = int(cloud.match[k])
    view = EpipolarExplorer(result).look(corr.x1[match].numpy())
    assert np.allclose(view.x1_match, view.x1)
    assert view.residual_px < 1.5
    X = view.X
    assert (
        np.linalg.norm(np.cross(view.ray, X)) / np.linalg.norm(X) < 2e-3
    )  # the point lies on the pixel's ray
    assert "its point lies at" in view.describe()


def test_a_pixel_without_a_match_is_described_as_such(result):
    view = EpipolarExplorer(result, reach_px=1e-6).look((10.0, 10.0))
    assert view.match is view.X is view.residual_px is None
    assert "no inlier" in view.describe()


def test_selections_of_the_viewer_become_pixels(result):
    explorer = EpipolarExplorer(result)
    assert np.allclose(
        explorer.selected("/world/cam1/image/keypoints/orb", 7),
        result.features["orb"][0].keypoints[7],
    )
    for path, instance in (
        ("/world/cam2/image/keypoints/orb", 7),
        ("/world/points", 3),
        ("/world/cam1/image/keypoints/orb", None),
        ("/world/cam1/image/keypoints/nope", 1),
    ):
        assert explorer.selected(path, instance) is None


@pytest.mark.parametrize("x1", [(-3, 5), (1600, 5), (np.nan, 5), (1, 2, 3)])
def test_invalid_pixels_are_rejected(result, x1):
    with pytest.raises(InputError, match="pixel"):
        EpipolarExplorer(result).look(x1)


def test_invalid_keypoints_are_rejected(result):
    explorer = EpipolarExplorer(result)
    with pytest.raises(InputError, match="was not used"):
        explorer.keypoint("sift", 0)
    with pytest.raises(InputError, match="does not exist"):
        explorer.keypoint("orb", 10**6)


def test_a_click_draws_the_line_and_a_slider_responds_quickly(result):
    widgets = pytest.importorskip("sfmkit.notebook.widgets")
    widget = widgets.EpipolarWidget(result)
    assert widget.view is None
    widget.left.clicked = [800.0, 600.0]
    assert np.allclose(widget.view.x1, (800, 600))
    points = re.search(r'class="epipolar-line" points="([^"]+)"', widget.right.overlay)[1]
    ends = np.array([[float(v) for v in p.split(",")] for p in points.split()])
    assert np.allclose(ends, widget.view.curve, atol=1e-3)
    taken = []
    for band in (4, 6, 8):
        before = len(widget.view.candidates)
        start = time.perf_counter()
        widget.band.value = band
        taken.append(time.perf_counter() - start)
        assert len(widget.view.candidates) > before
    assert min(taken) < 0.3  # the minimum excludes delays by other programs
    ray = re.search(r'class="ray" points="([^"]+)"', widget.above.overlay)[1]
    start, end = np.array([[float(v) for v in p.split(",")] for p in ray.split()])
    w, h = widget.above.size
    assert 0 < start[0] < w
    assert 0 < end[1] < start[1] < h  # from camera 1 into the scene (upwards)
    widget.left.clicked = [-50.0, 0.0]
    assert "outside image 1" in widget.words.value


def test_a_selected_keypoint_is_handled_like_a_click(result):
    widgets = pytest.importorskip("sfmkit.notebook.widgets")
    widget = widgets.EpipolarWidget(result)
    callbacks, rays = [], []
    viewer = SimpleNamespace(on_event=callbacks.append, show_ray=lambda ray, X: rays.append(ray))
    assert widget.follow(viewer) is viewer
    item = SimpleNamespace(entity_path="/world/cam1/image/keypoints/fast-brief", instance_id=11)
    callbacks[0](SimpleNamespace(items=[item]))
    assert np.allclose(widget.view.x1, result.features["fast-brief"][0].keypoints[11])
    assert np.allclose(np.cross(rays[0][1], widget.view.ray), 0)
    callbacks[0](SimpleNamespace())  # another kind of event
    assert widget.view is not None


def test_the_embedded_viewer_is_made_without_a_server(result):
    embedded = pytest.importorskip("sfmkit.notebook.embedded")
    viewer = embedded.recording_viewer(result, width=600, height=400)
    assert callable(viewer.on_event)


def test_the_scene_from_above_has_one_scale(result):
    from sfmkit.viz.from_above import scene_from_above

    rgb, pixels = scene_from_above(result.cloud, result.two_view)
    origin, right, deep = pixels(np.array([[0.0, 0, 0], [1, 5, 0], [0, -5, 1]]))
    assert np.allclose([right[1], deep[0]], [origin[1], origin[0]])
    assert right[0] - origin[0] > 10
    assert right[0] - origin[0] == pytest.approx(origin[1] - deep[1])
    dark = (rgb.max(-1) < 60).nonzero()
    assert np.hypot(dark[1] - origin[0], dark[0] - origin[1]).min() < 3  # the mark of camera 1


def test_a_slider_redraws_the_figure():
    widgets = pytest.importorskip("sfmkit.notebook.widgets")
    drawn = []

    def draw(value):
        drawn.append(value)
        figure = Figure(figsize=(1, 1))
        figure.add_subplot().bar([0], [value])
        return figure

    whole = widgets.FigureSlider(draw, "threshold", 20, 5, 80, 5)
    first = bytes(whole.picture.value)
    assert first.startswith(b"\x89PNG")
    whole.slider.value = 60
    assert drawn == [20, 60]
    assert bytes(whole.picture.value) != first
    assert isinstance(widgets.FigureSlider(draw, "ratio", 0.8, 0.5, 1.0, 0.05).slider.value, float)
