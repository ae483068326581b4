"""The rendered pairs against independent geometry, and the pictures against what operators need."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise

import cv2
import numpy as np
import pytest
from PIL import Image

from sfmkit.datasets.rendering.materials import BRICK_STEEPNESS, BRICK_THICKNESS, brick_height
from sfmkit.datasets.rendering.raycasting import radiance
from sfmkit.datasets.rendering.scenes import Scene, look
from sfmkit.datasets.rendering.surfaces import Rectangle
from sfmkit.datasets.synthetic import (
    SCENES,
    SyntheticPair,
    demo_pair,
    named_scene,
    photograph,
    render,
)
from sfmkit.errors import InputError


@pytest.fixture(scope="module")
def courtyard() -> SyntheticPair:
    return render("courtyard", size_wh=(640, 480), noise=1.0, seed=3)


@pytest.fixture(scope="module")
def small() -> dict[str, SyntheticPair]:
    return {name: render(name, size_wh=(160, 120), supersample=1, noise=0) for name in SCENES}


def some_pixels(pair: SyntheticPair, n: int = 3000) -> np.ndarray:
    h, w = pair.depth1.shape
    rng = np.random.default_rng(1)
    return np.column_stack([rng.integers(0, w, n), rng.integers(0, h, n)]).astype(float)


def project(K: np.ndarray, X: np.ndarray) -> np.ndarray:
    x = X @ K.T
    return x[:, :2] / x[:, 2:]


def bilinear(image: np.ndarray, x: np.ndarray) -> np.ndarray:
    return cv2.remap(image.astype(np.float32), *x.T.astype(np.float32)[:, None], cv2.INTER_LINEAR)[
        0
    ]


# ---- geometry ----


@pytest.mark.parametrize("name", SCENES)
def test_points_are_where_their_pixels_look(small, name):
    pair = small[name]
    X = pair.points1.reshape(-1, 3)
    seen = np.isfinite(pair.depth1.ravel())
    assert seen.mean() > 0.7
    y, x = np.mgrid[0:120, 0:160].reshape(2, -1)
    np.testing.assert_allclose(
        project(pair.camera1.K, X[seen]), np.column_stack([x, y])[seen], atol=1e-9
    )
    np.testing.assert_array_equal(X[seen, 2], pair.depth1.ravel()[seen])
    assert np.isnan(X[~seen]).all()


@pytest.mark.parametrize("name", ["courtyard", "wide", "forward", "plane", "dish"])
def test_transfer_is_the_pose_applied_to_the_points_and_camera_2_sees_the_same_depth(small, name):
    pair = small[name]
    x1 = some_pixels(pair)
    X1 = pair.points1[x1[:, 1].astype(int), x1[:, 0].astype(int)]
    finite = np.isfinite(X1[:, 0])
    X2 = X1[finite] @ pair.R.T + pair.t
    x2, visible = pair.transfer(x1)
    ahead = X2[:, 2] > 0
    np.testing.assert_allclose(x2[finite][ahead], project(pair.camera2.K, X2[ahead]), atol=1e-8)
    shown = visible[finite]
    assert shown.sum() > 500
    np.testing.assert_allclose(pair.depth_at(2, x2[finite][shown]), X2[shown, 2], rtol=1e-6)
    # what is declared hidden has something nearer in front of it, or lies outside
    hidden = ~shown & ahead & ((x2[finite] > 0) & (x2[finite] < (159, 119))).all(axis=1)
    assert (pair.depth_at(2, x2[finite][hidden]) < X2[hidden, 2]).all()


def test_depth_map_of_the_second_view_agrees_with_transfer_on_a_plane(small):
    # the inverse depth of a plane is linear in the pixel (Hartley and Zisserman, sec. 13.1):
    # interpolation is exact
    pair = small["plane"]
    x1 = some_pixels(pair)
    X2 = pair.points1[x1[:, 1].astype(int), x1[:, 0].astype(int)] @ pair.R.T + pair.t
    x2, visible = pair.transfer(x1)
    x2, z2 = x2[visible], X2[visible, 2]
    j, i = np.clip(np.floor(x2), 0, (158, 118)).astype(int).T
    a, b = (x2 - np.column_stack([j, i])).T
    q = 1 / pair.depth2
    inverse = (q[i, j] * (1 - a) + q[i, j + 1] * a) * (1 - b) + (
        q[i + 1, j] * (1 - a) + q[i + 1, j + 1] * a
    ) * b
    np.testing.assert_allclose(1 / inverse, z2, rtol=1e-9)


def test_plane_obeys_its_homography(small):
    pair = small["plane"]
    X = pair.points1[::7, ::7].reshape(-1, 3)
    n = np.linalg.lstsq(X, np.ones(len(X)), rcond=None)[0]  # n^T X = 1
    H = pair.camera2.K @ (pair.R + np.outer(pair.t, n)) @ np.linalg.inv(pair.camera1.K)
    x1 = some_pixels(pair)
    x2, visible = pair.transfer(x1)
    assert visible.mean() > 0.6
    np.testing.assert_allclose(x2, project(H, np.column_stack([x1, np.ones(len(x1))])), atol=1e-7)


def test_pure_rotation_obeys_its_homography_sky_included(small):
    pair = small["pure-rotation"]
    assert np.linalg.norm(pair.t) == 0
    H = pair.camera2.K @ pair.R @ np.linalg.inv(pair.camera1.K)
    x1 = some_pixels(pair)
    x2, visible = pair.transfer(x1)
    sky = np.isinf(pair.depth1[x1[:, 1].astype(int), x1[:, 0].astype(int)])
    assert (visible & sky).any()
    np.testing.assert_allclose(x2, project(H, np.column_stack([x1, np.ones(len(x1))])), atol=1e-7)
    inside = ((x2 >= -0.5) & (x2 <= (159.5, 119.5))).all(axis=1)
    np.testing.assert_array_equal(visible, inside)  # one centre: nothing can be hidden


def test_forward_moves_into_the_scene(small):
    pair = small["forward"]
    epipole = project(pair.camera2.K, pair.t[None])[0]
    assert ((epipole > 0) & (epipole < (160, 120))).all()
    assert pair.t[2] < 0  # points come nearer


def test_courtyard_is_a_stereo_pair_with_depth(courtyard):
    X1 = courtyard.points1[np.isfinite(courtyard.depth1)]
    centre2 = -courtyard.R.T @ courtyard.t
    a, b = X1, X1 - centre2
    cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    parallax = np.degrees(np.arccos(cosine))
    assert 10 < np.median(parallax) < 15
    assert 7 < np.degrees(np.arccos((np.trace(courtyard.R) - 1) / 2)) < 11
    low, high = np.percentile(X1[:, 2], [2, 98])
    assert high / low > 1.8
    x2, visible = courtyard.transfer(some_pixels(courtyard))
    assert 0.7 < visible.mean() < 0.9


def test_brick_relief_is_geometry_not_paint(courtyard):
    # the wall's points leave their common plane by millimetres to centimetres
    X = courtyard.points1[60:110, 300:400].reshape(-1, 3)
    distance = (X - X.mean(0)) @ np.linalg.svd(X - X.mean(0))[2][2]
    assert 0.002 < distance.std() < 0.02
    assert 0.01 < np.ptp(distance) < 0.05


def test_brick_relief_keeps_its_promises():
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, 7, 400_000), rng.uniform(0, 4, 400_000)
    h = brick_height(u, v)
    assert h.min() >= 0
    assert 0.9 * BRICK_THICKNESS < h.max() <= BRICK_THICKNESS
    step = rng.uniform(-0.002, 0.002, (2, len(u)))
    slope = np.abs(brick_height(u + step[0], v + step[1]) - h) / np.hypot(*step)
    assert slope.max() <= BRICK_STEEPNESS * (1 + 1e-9)


def test_no_overlap_has_none(small):
    assert not small["no-overlap"].transfer(some_pixels(small["no-overlap"]))[1].any()


# ---- pictures ----


@pytest.mark.parametrize(("name", "bound"), [("courtyard", 12), ("plane", 14), ("dish", 12)])
def test_both_pictures_show_the_same_thing(name, bound, courtyard, small):
    pair = courtyard if name == "courtyard" else render(name, size_wh=(320, 240), noise=0)
    x1 = some_pixels(pair)
    x2, visible = pair.transfer(x1)
    one = pair.image1[tuple(x1[visible].T.astype(int)[::-1])].astype(float)
    two = bilinear(pair.image2, x2[visible])
    assert np.median(np.abs(one - two).mean(axis=1)) < bound
    shifted = bilinear(pair.image2, x2[visible] + (5, 3))
    assert np.abs(one - two).mean() < 0.6 * np.abs(one - shifted).mean()
    assert np.corrcoef(one.ravel(), two.ravel())[0, 1] > 0.85


def test_an_edge_is_drawn_where_geometry_puts_it():
    # white to the right of a line on a wall: the light in a row tells, to a fraction of a pixel,
    # where the line runs
    def half_white(u, v, footprint):
        return np.repeat((u > 20.0).astype(np.float32)[:, None], 3, axis=1), None

    wall = Rectangle(
        np.array([-20.0, -20, 5]), np.array([40.0, 0, 0]), np.array([0, 40.0, 0]), half_white
    )
    scene = Scene(
        "edge", (wall,), look((-0.3, 0.2, 0), (0.1, 0.4, 5), 7), look((0.5, 0, 0), (0, 0, 5))
    )
    K = scene.K((64, 48))
    light = radiance(scene, scene.pose1, K, (64, 48), 8)[..., 0]
    first = np.argmax(light > 0, axis=1)[
        :, None
    ]  # the pixel that the edge enters, and maybe the next, are part white
    part, rest, white = (np.take_along_axis(light, first + k, axis=1)[:, 0] for k in (0, 1, 2))
    drawn = first[:, 0] + 1.5 - (part + rest) / white
    ends = (np.array([[0.0, -1, 5], [0.0, 1, 5]]) - scene.pose1.centre) @ scene.pose1.R.T
    (x0, y0), (x1, y1) = project(K, ends)
    np.testing.assert_allclose(drawn, x0 + (np.arange(48) - y0) * (x1 - x0) / (y1 - y0), atol=0.07)


def test_same_arguments_same_bits_and_other_seed_only_other_noise():
    def picture(**kwargs):
        return render("dish", size_wh=(64, 48), supersample=1, **kwargs)

    a, b, c = picture(seed=1), picture(seed=1), picture(seed=2)
    np.testing.assert_array_equal(a.image1, b.image1)
    np.testing.assert_array_equal(a.image2, b.image2)
    np.testing.assert_array_equal(a.depth2, b.depth2)
    assert (a.image1 != c.image1).any()
    np.testing.assert_array_equal(a.points1, c.points1)
    np.testing.assert_array_equal(picture(seed=1, noise=0).image1, picture(seed=2, noise=0).image1)


def test_noise_has_the_deviation_asked_for():
    light = np.full((200, 200, 3), 0.2, dtype=np.float32)
    clean = photograph(light, 0, 0, 1, None, np.random.default_rng(0))
    noisy = photograph(light, 0, 4.0, 1, None, np.random.default_rng(0))
    assert np.std(clean) == 0
    assert np.std(noisy.astype(float)) == pytest.approx(np.hypot(4.0, np.sqrt(1 / 12)), rel=0.01)
    assert noisy.mean() == pytest.approx(clean.mean(), abs=0.5)


def test_blur_spreads_a_point_by_its_deviation():
    light = np.zeros((41, 41, 3), dtype=np.float32)
    light[20, 20] = 30.0
    spread = photograph(light, 2.0, 0, 1, None, np.random.default_rng(0))[..., 0] / 255
    linear = np.where(spread <= 0.04045, spread / 12.92, ((spread + 0.055) / 1.055) ** 2.4)
    d2 = (np.arange(41) - 20.0) ** 2
    assert (linear.sum(0) * d2).sum() / linear.sum() == pytest.approx(4.0, rel=0.06)


def test_knobs_do_what_they_say():
    def energy(image):
        return np.abs(np.diff(image.astype(float), axis=1)).mean()

    def picture(**kwargs):
        return render("plane", size_wh=(96, 64), noise=0, **kwargs).image1

    plain = picture()
    assert energy(picture(blur=1.5)) < 0.6 * energy(plain)
    assert picture(exposure=0.4).mean() < 0.8 * plain.mean() < 0.8 * picture(exposure=2.0).mean()
    coarse, fine = picture(jpeg_quality=10), picture(jpeg_quality=95)
    assert (
        np.abs(coarse.astype(float) - plain).mean()
        > 2 * np.abs(fine.astype(float) - plain).mean()
        > 0
    )
    # supersampling converges: 3 x 3 rays are nearer to 6 x 6 than one ray is
    best = picture(supersample=6).astype(float)
    assert (
        np.abs(picture(supersample=3) - best).mean()
        < 0.5 * np.abs(picture(supersample=1) - best).mean()
    )


def test_spectrum_is_that_of_photographs(courtyard):
    # amplitude over frequency falls like 1 / f^a with a near 1 (Ruderman and Bialek 1994)
    grey = courtyard.image1.astype(float).mean(2)[:, :480]
    window = np.outer(np.hanning(480), np.hanning(480))
    amplitude = np.abs(np.fft.fft2((grey - grey.mean()) * window))
    f = np.hypot(np.fft.fftfreq(480)[:, None], np.fft.fftfreq(480)[None])
    rings = np.geomspace(0.01, 0.35, 12)
    level = [amplitude[(f >= a) & (f < b)].mean() for a, b in pairwise(rings)]
    exponent = -np.polyfit(np.log(np.sqrt(rings[:-1] * rings[1:])), np.log(level), 1)[0]
    assert 0.7 < exponent < 1.4


OPERATORS = {  # matches within 1 px of the truth that must be found at 640 x 480, and their share
    "sift": (cv2.SIFT_create(), None, cv2.NORM_L2, 900, 0.60),
    "orb": (cv2.ORB_create(nfeatures=4000), None, cv2.NORM_HAMMING, 700, 0.38),
    "fast-brief": (
        cv2.FastFeatureDetector_create(25),
        cv2.xfeatures2d.BriefDescriptorExtractor_create(),
        cv2.NORM_HAMMING,
        1500,
        0.5,
    ),
    "akaze": (cv2.xfeatures2d.AKAZE_create(), None, cv2.NORM_HAMMING, 600, 0.6),
}


@pytest.mark.parametrize("operator", OPERATORS)
def test_operators_find_real_matches_and_some_wrong_ones(courtyard, operator):
    detector, descriptor, norm, at_least, share = OPERATORS[operator]
    found = []
    for image in (courtyard.image1, courtyard.image2):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        keypoints, descriptors = (descriptor or detector).compute(grey, detector.detect(grey))
        found.append((np.array([k.pt for k in keypoints]), descriptors))
    (p1, d1), (p2, d2) = found
    matches = cv2.BFMatcher(norm, crossCheck=True).match(d1, d2)
    x1, x2 = p1[[m.queryIdx for m in matches]], p2[[m.trainIdx for m in matches]]
    true = np.linalg.norm(courtyard.transfer(x1)[0] - x2, axis=1) < 1
    assert true.sum() >= at_least
    assert share <= true.mean() <= 0.97

    tx, ty, tz = courtyard.t
    Ki = np.linalg.inv(courtyard.camera1.K)
    F = Ki.T @ np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ courtyard.R @ Ki
    line = np.column_stack([x1, np.ones(len(x1))]) @ F.T
    off = np.abs((line * np.column_stack([x2, np.ones(len(x2))])).sum(1)) / np.hypot(
        line[:, 0], line[:, 1]
    )
    assert (off[true] < 1).all()
    assert (off < 1).mean() >= share


# ---- bad input ----


def test_an_unknown_scene_suggests_the_nearest_name():
    with pytest.raises(InputError, match="'courtyard'"):
        render("curtyard")
    with pytest.raises(InputError, match="Known: courtyard"):
        named_scene("zzz")


@pytest.mark.parametrize(
    ("kwargs", "word"),
    [
        ({"size_wh": (15, 100)}, "size_wh"),
        ({"size_wh": (100, 0)}, "size_wh"),
        ({"size_wh": (64.5, 64)}, "size_wh"),
        ({"size_wh": 640}, "size_wh"),
        ({"blur": -1}, "blur"),
        ({"noise": float("nan")}, "noise"),
        ({"exposure": 0}, "exposure"),
        ({"jpeg_quality": 0}, "jpeg_quality"),
        ({"jpeg_quality": 101}, "jpeg_quality"),
        ({"supersample": 0}, "supersample"),
        ({"seed": -1}, "seed"),
    ],
)
def test_values_out_of_range_are_refused(kwargs, word):
    with pytest.raises(InputError, match=word):
        render("dish", **kwargs)


def test_pixels_of_the_wrong_shape_are_refused(small):
    with pytest.raises(InputError, match=r"\(N, 2\)"):
        small["dish"].transfer(np.zeros(2))


# ---- the bundled pair ----


def test_the_bundled_pair_is_there_with_its_truth():
    path1, path2, path = demo_pair()
    truth = json.loads(path.read_text())
    assert {"R", "t", "K", "size_wh", "scene", "settings"} <= truth.keys()
    assert Image.open(path1).size == Image.open(path2).size == tuple(truth["size_wh"])
    assert path1.stat().st_size + path2.stat().st_size < 4e6
    scene = named_scene(truth["scene"])
    np.testing.assert_allclose(truth["K"], scene.K(truth["size_wh"]), atol=1e-9)
    np.testing.assert_allclose(truth["R"], scene.pose2.R @ scene.pose1.R.T, atol=1e-12)
    np.testing.assert_allclose(
        truth["t"], scene.pose2.R @ (scene.pose1.centre - scene.pose2.centre), atol=1e-12
    )


def test_the_bundled_pair_is_what_the_scene_renders_today():
    # a small rendering against the photographs reduced to its size
    path1, path2, path = demo_pair()
    pair = render(json.loads(path.read_text())["scene"], size_wh=(200, 150), noise=0)
    for file, image in ((path1, pair.image1), (path2, pair.image2)):
        reduced = np.asarray(Image.open(file).resize((200, 150), Image.Resampling.BOX)).astype(
            float
        )
        assert np.abs(reduced - image).mean() < 8
        assert np.corrcoef(reduced.ravel(), image.ravel())[0, 1] > 0.95


@pytest.mark.slow
def test_the_demo_is_written_by_its_command(tmp_path):
    subprocess.run(
        [sys.executable, "-m", "sfmkit.datasets.synthetic", "--write-demo", tmp_path], check=True
    )
    for new, old in zip(("image1.jpg", "image2.jpg", "truth.json"), demo_pair()):
        if new.endswith("json"):
            assert json.loads((tmp_path / new).read_text()) == json.loads(old.read_text())
        else:
            a, b = (np.asarray(Image.open(f)).astype(float) for f in (tmp_path / new, old))
            assert np.abs(a - b).mean() < 0.5
