"""Feature operators compared with OpenCV and known positions, and on difficult images."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from sfmkit.errors import InputError, OperatorError
from sfmkit.features import (
    DESCRIPTORS,
    DETECTORS,
    OPERATORS,
    available,
    detect,
    find_spec,
    list_operators,
)
from sfmkit.features.subpixel import fast_score, paraboloid_top

contrib = cv2.xfeatures2d


def texture(height: int = 300, width: int = 400, seed: int = 0) -> np.ndarray:
    """Draw an (H, W) uint8 image with corners, blobs and edges of many sizes."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width), np.float32)
    for cell, weight in ((64, 40.0), (24, 35.0), (9, 30.0), (4, 12.0)):
        grid = rng.normal(size=(height // cell + 2, width // cell + 2)).astype(np.float32)
        image += weight * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(40):
        x, y, w, h = rng.integers((0, 0, 6, 6), (width, height, 40, 40))
        image[y : y + h, x : x + w] += rng.uniform(-60, 60)
    return np.clip(image + 128, 0, 255).astype(np.uint8)


def blobs(
    height: int, width: int, sigma: float, n: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Draw Gaussian blobs at known centres (n, 2) between pixels."""
    rng = np.random.default_rng(seed)
    step = int(14 * sigma)
    cells = [
        (x, y) for y in range(step, height - step, step) for x in range(step, width - step, step)
    ][:n]
    centres = np.array(cells) + rng.uniform(0, 1, (len(cells), 2))
    y, x = np.mgrid[:height, :width]
    image = np.full((height, width), 60.0)
    for cx, cy in centres:
        image += 140 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2))
    return np.clip(np.round(image), 0, 255).astype(np.uint8), centres


def nearest(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the difference (n, 2) of the nearest detected point from every true point."""
    return found[cKDTree(found).query(true)[1]].astype(float) - true


def cv_arrays(keypoints) -> tuple[np.ndarray, ...]:
    return tuple(
        np.array([get(k) for k in keypoints], np.float32)
        for get in (
            lambda k: k.pt,
            lambda k: k.size,
            lambda k: np.deg2rad(max(k.angle, 0)),
            lambda k: k.response,
        )
    )


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return texture()


# -- every operator

COMPOSED = (
    "fast+freak",
    "agast+latch",
    "star+daisy",
    "harris+sift",
    "orb+freak",
    "sift+brief",
    "mser+rootsift",
    "fast+beblid",
    "gftt+teblid",
    "brisk+orb",
    "akaze+brisk",
    "sift+rootsift",
    "fast+surf",
    "surf+brief",
    "star+vgg",
)


@pytest.mark.parametrize("name", [*OPERATORS, *COMPOSED])
def test_every_operator_gives_valid_and_reproducible_features(name, image):
    if not available(name)[0]:
        pytest.skip(f"{name}: {available(name)[1]}")
    spec = find_spec(name)
    f = detect(image, name)
    assert len(f) > 10
    assert f.norm == spec.norm
    assert f.operator == spec.name
    assert f.size_wh == (400, 300)
    expected_width = spec.width if spec.norm == "l2" else spec.width // 8
    assert f.descriptors.shape == (len(f), expected_width)
    assert f.descriptors.dtype == (np.float32 if spec.norm == "l2" else np.uint8)
    assert all(a.dtype == np.float32 for a in (f.keypoints, f.scales, f.angles, f.scores))
    assert (f.keypoints >= 0).all()
    assert (f.keypoints <= (399, 299)).all()
    assert (f.scales > 0).all()
    assert len(np.unique(f.descriptors, axis=0)) > 0.9 * len(np.unique(f.keypoints, axis=0))
    again = detect(image, name)
    for field in ("keypoints", "scales", "angles", "scores", "descriptors"):
        np.testing.assert_array_equal(getattr(f, field), getattr(again, field))


@pytest.mark.parametrize("name", ["sift", "orb", "akaze", "kaze", "brisk"])
def test_native_operators_are_bitwise_equal_to_opencv(name, image):
    settings = {k: v for k, v in OPERATORS[name].options.items() if k != "subpixel"}
    create = getattr(cv2, f"{name.upper()}_create", None) or getattr(
        contrib, f"{name.upper()}_create"
    )
    keypoints, descriptors = create(**settings).detectAndCompute(image, None)
    xy, sizes, angles, scores = cv_arrays(keypoints)
    f = detect(image, name, preset="paper")
    np.testing.assert_array_equal(f.keypoints, xy)
    np.testing.assert_array_equal(f.scales, sizes)
    np.testing.assert_allclose(f.angles, angles, atol=1e-6)
    np.testing.assert_array_equal(f.scores, scores)
    np.testing.assert_array_equal(f.descriptors, descriptors)


@pytest.mark.parametrize(
    "name, detector, descriptor",
    [
        ("fast-brief", cv2.FastFeatureDetector_create, contrib.BriefDescriptorExtractor_create),
        ("fast+freak", cv2.FastFeatureDetector_create, contrib.FREAK_create),
        ("agast+beblid", contrib.AgastFeatureDetector_create, lambda: contrib.BEBLID_create(5.0)),
        ("fast+brisk", cv2.FastFeatureDetector_create, contrib.BRISK_create),
        ("fast+daisy", cv2.FastFeatureDetector_create, contrib.DAISY_create),
    ],
)
def test_pairs_are_bitwise_equal_to_opencv(name, detector, descriptor, image):
    keypoints, descriptors = descriptor().compute(image, detector().detect(image))
    f = detect(image, name, preset="paper")
    np.testing.assert_array_equal(f.keypoints, cv_arrays(keypoints)[0])
    np.testing.assert_array_equal(f.descriptors, descriptors)


def test_upright_keypoints_are_described_upright_not_at_minus_one_degree(image):
    keypoints = cv2.FastFeatureDetector_create().detect(image)
    for k in keypoints:
        k.angle = 0
    _, descriptors = cv2.SIFT_create(contrastThreshold=0.01, enable_precise_upscale=True).compute(
        image, keypoints
    )
    np.testing.assert_array_equal(detect(image, "fast+sift").descriptors, descriptors)


def test_the_paper_settings():
    assert OPERATORS["surf"].options["hessian_threshold"] == 30
    assert {**OPERATORS["orb"].options, **OPERATORS["orb"].paper}.items() >= {
        "nfeatures": 35_000,
        "fastThreshold": 7,
        "nlevels": 8,
        "scaleFactor": 1.2,
        "subpixel": False,
    }.items()
    assert (
        OPERATORS["fast-brief"].options["threshold"]
        == cv2.FastFeatureDetector_create().getThreshold()
    )
    assert OPERATORS["fast-brief"].paper == {"subpixel": False}


def test_dense_halves_the_minimum_contrast_and_finds_more_keypoints(image):
    assert OPERATORS["surf"].dense == {"hessian_threshold": 15.0}
    assert OPERATORS["orb"].dense == {"nfeatures": 70_000, "fastThreshold": 4}
    assert OPERATORS["fast-brief"].dense == {"threshold": 5}
    for name in ("surf", "orb", "fast-brief", "sift", "brisk"):
        assert len(detect(image, name, preset="dense")) > len(detect(image, name)), name
    with pytest.raises(InputError, match="default, paper, dense"):
        detect(image, "orb", preset="sparse")


def test_rootsift_is_the_square_root_of_sift_and_its_product_the_hellinger_kernel(image):
    sift, root = detect(image, "sift"), detect(image, "rootsift")
    np.testing.assert_array_equal(sift.keypoints, root.keypoints)
    p = sift.descriptors.astype(np.float64)
    p /= p.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(root.descriptors, np.sqrt(p), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(root.descriptors, axis=1), 1, atol=1e-5)
    hellinger = 2 - 2 * np.sqrt(p[0] * p[1]).sum()
    assert np.sum((root.descriptors[0] - root.descriptors[1]) ** 2) == pytest.approx(
        hellinger, abs=1e-5
    )


# -- rotation


@pytest.mark.parametrize(
    "name, options",
    [
        ("orb", {"nfeatures": 3000}),
        ("sift", {}),
        ("akaze", {}),
        ("brisk", {}),
        ("kaze", {}),
        ("fast+freak", {}),
        ("fast-brief", {"oriented": True}),
        ("fast+daisy", {"oriented": True}),
        ("gftt+latch", {"oriented": True}),
    ],
)
def test_a_rotation_by_90_degrees_rotates_keypoints_and_orientations(name, options):
    image = texture(384, 384)
    turned = np.ascontiguousarray(
        np.rot90(image, -1)
    )  # clockwise on screen: (x, y) -> (H - 1 - y, x)
    f, g = detect(image, name, **options), detect(turned, name, **options)
    norm = cv2.NORM_L2 if f.norm == "l2" else cv2.NORM_HAMMING
    matches = cv2.BFMatcher(norm, crossCheck=True).match(f.descriptors, g.descriptors)
    a, b = (np.array([getattr(m, key) for m in matches]) for key in ("queryIdx", "trainIdx"))
    expected = np.stack([383 - f.keypoints[a, 1], f.keypoints[a, 0]], axis=1)
    right = np.hypot(*(g.keypoints[b] - expected).T) < 1
    assert right.mean() > 0.7
    turn = (g.angles[b] - f.angles[a])[right]
    off = np.rad2deg(np.abs(np.angle(np.exp(1j * (turn - np.pi / 2)))))
    assert np.median(off) < 5


def test_upright_operators_do_not_follow_a_rotation():
    image = texture(384, 384)
    f, g = (
        detect(image, "fast-brief"),
        detect(np.ascontiguousarray(np.rot90(image, -1)), "fast-brief"),
    )
    assert (f.angles == 0).all()
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(f.descriptors, g.descriptors)
    off = [
        np.hypot(
            *(
                g.keypoints[m.trainIdx]
                - (383 - f.keypoints[m.queryIdx, 1], f.keypoints[m.queryIdx, 0])
            )
        )
        for m in matches
    ]
    assert np.mean(np.array(off) < 1) < 0.3


# -- positions


@pytest.mark.parametrize("name", ["sift", "akaze", "kaze"])
@pytest.mark.parametrize("max_size", [None, 400, 317])
def test_positions_of_blobs_are_correct_at_every_working_size(name, max_size):
    image, centres = blobs(420, 600, sigma=6, n=30)
    f = detect(image, name, max_size=max_size)
    error = nearest(f.keypoints, centres)
    found = np.hypot(*error.T) < 1
    assert found.mean() > 0.6  # SIFT misses some blobs whose scale lies between two octaves
    assert np.abs(error[found].mean(axis=0)).max() < 0.04
    assert np.abs(error[found]).max() < 0.1


def test_scales_do_not_depend_on_the_working_size():
    image, centres = blobs(420, 600, sigma=6, n=30)
    sizes = []
    for max_size in (None, 300):
        f = detect(image, "sift", max_size=max_size)
        at = [np.hypot(*(f.keypoints - c).T).argmin() for c in centres]
        sizes.append(np.median(f.scales[at]))
    assert sizes[1] == pytest.approx(sizes[0], rel=0.05)


@pytest.mark.parametrize("name", ["fast-brief", "harris-brief", "gftt-brief", "orb", "sift"])
def test_no_operator_has_a_position_bias(name):
    """Rotate the image by 180 degrees about its centre, which doubles any bias."""
    image = texture(411, 533)  # sizes that the pyramid does not divide
    half_turn = np.ascontiguousarray(image[::-1, ::-1])
    f, g = detect(image, name), detect(half_turn, name)
    difference = nearest(g.keypoints, (532, 410) - f.keypoints)
    near = np.hypot(*difference.T) < 1.5
    assert near.mean() > 0.8
    assert np.abs(difference[near].mean(axis=0)).max() < 0.05


def test_the_test_of_the_position_bias_detects_that_of_opencvs_orb():
    image = texture(411, 533)
    half_turn = np.ascontiguousarray(image[::-1, ::-1])
    f, g = detect(image, "orb", subpixel=False), detect(half_turn, "orb", subpixel=False)
    difference = nearest(g.keypoints, (532, 410) - f.keypoints)
    assert np.abs(difference[np.hypot(*difference.T) < 1.5].mean(axis=0)).max() > 0.1


def test_the_fast_score_agrees_with_opencv(image):
    keypoints = cv2.FastFeatureDetector_create(5, nonmaxSuppression=True).detect(image)
    xy = np.array([k.pt for k in keypoints], int)
    score = fast_score(image, xy[:, 0], xy[:, 1])
    np.testing.assert_array_equal(score - 1, [k.response for k in keypoints])


def test_paraboloid_top_finds_the_vertex_and_returns_zero_without_one():
    y, x = np.mgrid[-1:2, -1:2]
    vertex = np.array([[-0.4, 0.2], [0.0, 0.0], [0.3, -0.1]])
    values = [
        7 - 2 * (x - u) ** 2 - 1.5 * (y - v) ** 2 + 0.8 * (x - u) * (y - v) for u, v in vertex
    ]
    np.testing.assert_allclose(paraboloid_top(np.stack(values, axis=-1)), vertex, atol=1e-12)
    flat, valley, saddle = np.ones((3, 3)), 1.0 * x**2 + y**2, 1.0 * x**2 - y**2 + 0.1 * x
    np.testing.assert_array_equal(paraboloid_top(np.stack([flat, valley, saddle], axis=-1)), 0)
    np.testing.assert_array_equal(
        paraboloid_top((5.0 * x - 0.1 * x**2 - y**2)[..., None]), [[0.5, 0]]
    )


@pytest.mark.parametrize(
    "name, options",
    [
        ("fast-brief", {}),
        ("gftt-brief", {"qualityLevel": 0.01}),
        ("harris-brief", {"qualityLevel": 0.001}),
    ],
)
def test_subpixel_follows_a_shift_of_half_a_pixel(name, options):
    rng = np.random.default_rng(0)
    large = np.full((3200, 4160), 90, np.float32)
    for x, y, w, h in rng.integers((0, 0, 100, 100), (4160, 3200, 600, 600), (500, 4)):
        large[y : y + h, x : x + w] = rng.uniform(20, 235)
    large = np.round(cv2.GaussianBlur(large, (0, 0), 6)).astype(np.uint8)
    views = [
        cv2.resize(large[:, x : x + 4000], (500, 400), interpolation=cv2.INTER_AREA) for x in (0, 4)
    ]

    def error(subpixel: bool) -> np.ndarray:
        f, g = (detect(view, name, subpixel=subpixel, **options).keypoints for view in views)
        difference = nearest(g, f)
        return difference[np.hypot(*difference.T) < 1.5] - (-0.5, 0)

    assert (np.abs(error(False)[:, 0]) >= 0.5).all()
    refined = error(True)
    assert np.median(refined, axis=0) == pytest.approx([0, 0], abs=0.03)
    assert np.median(np.abs(refined), axis=0).max() < 0.2
    assert np.mean(np.abs(refined).max(axis=1) < 0.25) > 0.55


@pytest.mark.data
@pytest.mark.parametrize("name", ["fast-brief", "gftt-brief", "harris-brief", "orb"])
def test_subpixel_reduces_the_distance_of_real_matches_from_the_true_epipolar_lines(name, data_dir):
    folder = data_dir / "strecha" / "fountain-P11"
    images = [
        cv2.imread(str(folder / "images" / f"000{i}.jpg"), cv2.IMREAD_GRAYSCALE) for i in (0, 1)
    ]
    assert images[0] is not None
    assert images[1] is not None
    K, R, C = zip(
        *(_camera(next((folder / "gt_dense_cameras").glob(f"000{i}*.camera"))) for i in (0, 1))
    )
    t = R[1] @ (C[0] - C[1])
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    F_mat = np.linalg.inv(K[1]).T @ cross @ R[1] @ R[0].T @ np.linalg.inv(K[0])
    share = {}
    for subpixel in (False, True):
        f, g = (
            detect(im, name, subpixel=subpixel, **({"nfeatures": 8000} if name == "orb" else {}))
            for im in images
        )
        matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
            f.descriptors, g.descriptors
        )
        x1 = np.array([(*f.keypoints[m.queryIdx], 1) for m in matches], float)
        x2 = np.array([(*g.keypoints[m.trainIdx], 1) for m in matches], float)
        line = x1 @ F_mat.T
        share[subpixel] = np.mean(np.abs((line * x2).sum(axis=1)) / np.hypot(*line[:, :2].T) < 0.5)
    assert share[True] > share[False] + 0.04


def _camera(path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = [
        list(map(float, line.split())) for line in path.read_text().splitlines() if line.strip()
    ]
    return np.array(rows[:3]), np.array(rows[4:7]).T, np.array(rows[7])


# -- images


def test_colour_grey_and_image_objects_agree():
    rgb = np.stack([texture(seed=s) for s in range(3)], axis=-1)
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)

    class Photo:
        pass

    photo = Photo()
    photo.rgb, photo.grey = rgb, grey
    expected = detect(grey, "orb")
    for given in (rgb, photo, np.asfortranarray(grey), np.stack([grey, grey], -1)[..., 0]):
        np.testing.assert_array_equal(detect(given, "orb").descriptors, expected.descriptors)


@pytest.mark.parametrize(
    "shape", [(1, 1), (2, 2), (3, 5), (8, 8), (17, 17), (1, 300), (40, 40), (300, 400)]
)
def test_blank_and_tiny_images_give_empty_features_of_the_right_shapes(shape):
    for name in (
        *OPERATORS,
        "star+daisy",
        "mser+sift",
        "agast+latch",
        "fast+vgg",
        "sift+orb",
        "fast+surf",
    ):
        if not available(name)[0]:
            continue
        spec = find_spec(name)
        f = detect(np.full(shape, 117, np.uint8), name)
        assert len(f) == 0
        assert f.keypoints.shape == (0, 2)
        assert f.descriptors.shape == (0, spec.width if spec.norm == "l2" else spec.width // 8)
        assert f.size_wh == shape[::-1]
        noise = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
        assert detect(noise, name, budget=5).size_wh == shape[::-1]


@pytest.mark.parametrize(
    "name", ["surf", "orb", "fast-brief", "gftt-brief", "agast+latch", "akaze"]
)
def test_images_40_000_pixels_wide_or_high(name):
    strip = texture(80, 40_000)
    for image in (strip, np.ascontiguousarray(strip.T)):
        f = detect(image, name)
        assert f.size_wh == image.shape[::-1]
        assert len(f) > 20
        assert f.keypoints.max() > 30_000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sift", "kaze", "brisk", "gftt+daisy", "mser+sift"])
def test_images_40_000_pixels_wide_slow_operators(name):
    if not available(name)[0]:
        pytest.skip(available(name)[1])
    f = detect(texture(40, 40_000), name)
    assert len(f) > 20
    assert f.keypoints.max() > 30_000


@pytest.mark.parametrize(
    "bad, hint",
    [
        (None, "read_image"),
        ("photo.jpg", "read_image"),
        ([[1, 2]], "array"),
        (np.zeros((4, 4)), "uint8"),
        (np.zeros((4, 4), np.uint16), "uint8"),
        (np.zeros((4, 4, 4), np.uint8), "RGB"),
        (np.zeros(5, np.uint8), "H, W"),
        (np.zeros((0, 4), np.uint8), "one pixel"),
        (np.zeros((2, 4, 4, 3), np.uint8), "H, W"),
    ],
)
def test_unusable_images_are_rejected(bad, hint):
    with pytest.raises(InputError, match=hint):
        detect(bad, "orb")


# -- budget, mask, size


@pytest.mark.parametrize("name", ["orb", "fast-brief", "sift"])
def test_the_budget_selects_from_the_same_features(name, image):
    everything, few = detect(image, name), detect(image, name, budget=50)
    assert len(few) == 50
    every = {
        (*k, *d) for k, d in zip(everything.keypoints.tolist(), everything.descriptors.tolist())
    }
    assert all((*k, *d) in every for k, d in zip(few.keypoints.tolist(), few.descriptors.tolist()))
    assert len(detect(image, name, budget=10**6)) == len(everything)


def test_the_mask_keeps_only_the_keypoints_that_it_covers(image):
    mask = np.zeros(image.shape, np.uint8)
    mask[50:200, 80:300] = 255
    everything = detect(image, "sift")
    x, y = np.rint(everything.keypoints).astype(int).T
    inside = mask[y, x] > 0
    for given in (mask, mask > 0):
        kept = detect(image, "sift", mask=given)
        np.testing.assert_array_equal(kept.keypoints, everything.keypoints[inside])
        np.testing.assert_array_equal(kept.descriptors, everything.descriptors[inside])
    assert len(detect(image, "fast-brief", mask=np.zeros_like(mask))) == 0
    half = detect(image, "orb", mask=mask, max_size=300)
    x, y = np.rint(half.keypoints).astype(int).T
    assert mask[np.clip(y, 51, 198), np.clip(x, 81, 298)].all()
    assert ((x > 77) & (x < 303) & (y > 47) & (y < 203)).all()


@pytest.mark.parametrize(
    "options, hint",
    [
        ({"budget": 0}, "budget"),
        ({"budget": -3}, "budget"),
        ({"budget": 2.5}, "budget"),
        ({"budget": True}, "budget"),
        ({"max_size": 0}, "max_size"),
        ({"max_size": "big"}, "max_size"),
        ({"mask": np.ones((3, 3))}, "mask"),
        ({"preset": "best"}, "preset"),
        ({"hessian_threshold": 3}, "fastThreshold=7"),
        ({"nfeatures": -1}, "nfeatures"),
        ({"nfeatures": 2.5}, "nfeatures"),
        ({"nfeatures": True}, "nfeatures"),
        ({"scaleFactor": float("nan")}, "scaleFactor"),
        ({"scaleFactor": "1.2"}, "scaleFactor"),
        ({"subpixel": 1}, "True or False"),
        ({"nlevels": 0}, "from 1 to 16"),
        ({"scaleFactor": 1.0}, "from 1.01"),
        ({"nfeatures": 10**12}, "nfeatures.* from 0 to"),
        ({"patchSize": 0}, "from 2 to 255"),
    ],
)
def test_messages_about_bad_options_state_the_correction(options, hint, image):
    with pytest.raises(InputError, match=hint):
        detect(image, "orb", **options)


def test_options_reach_detector_and_descriptor(image):
    assert len(detect(image, "orb", nfeatures=100)) <= 101
    assert detect(image, "fast-brief", bytes=64).descriptors.shape[1] == 64
    assert len(detect(image, "fast-brief", threshold=40)) < len(detect(image, "fast-brief"))
    assert len(detect(image, "sift", contrastThreshold=np.float64(0.04))) < len(
        detect(image, "sift")
    )


# -- names


@pytest.mark.parametrize(
    "name, hint",
    [
        ("surff", "Did you mean 'surf'"),
        ("fast_brief", "Did you mean 'fast-brief'"),
        ("orbb+brief", "detector 'orbb'"),
        ("fast+breif", "descriptor 'breif'"),
        ("fast+akaze", "akaze keypoints only"),
        ("akaze+kaze", "kaze keypoints only"),
        ("fast+lucid", "colour"),
        ("msd+brief", "crashes"),
        ("fast", "fast\\+brief"),
        ("freak", "fast\\+freak"),
        ("", "unknown"),
        ("+", "unknown"),
    ],
)
def test_unknown_names_are_rejected(name, hint, image):
    with pytest.raises(OperatorError, match=hint):
        detect(image, name)


def test_every_pair_of_the_two_tables_is_available_or_has_a_reason():
    fits = 0
    for detector in DETECTORS:
        for descriptor in DESCRIPTORS:
            name = f"{detector}+{descriptor}"
            if DESCRIPTORS[descriptor].only_with not in (None, detector) or (
                DETECTORS[detector].only_with not in (None, descriptor)
            ):
                with pytest.raises(OperatorError, match=r"does not fit: .*(because|no size)"):
                    find_spec(name)
                continue
            spec = find_spec(name)
            fits += 1
            assert (spec.detector, spec.descriptor) == (detector, descriptor)
            assert find_spec(spec.name) == spec
    assert fits > 120


def test_a_pair_that_has_a_name_is_that_operator():
    assert find_spec("FAST+BRIEF") is OPERATORS["fast-brief"]
    assert find_spec("sift + rootsift") is OPERATORS["rootsift"]


def test_the_table_of_operators():
    rows = {row.name: row for row in list_operators()}
    assert list(rows) == [*OPERATORS, "aliked", "disk", "xfeat"]
    assert rows["orb"].width == "256 bits"
    assert rows["surf"].width == "64 floats"
    assert "check your jurisdiction" in rows["surf"].licence
    assert all(row.available or row.reason for row in rows.values())
    assert asdict(rows["orb"])["norm"] == "hamming"


def test_an_opencv_without_contrib_is_detected_and_the_repair_is_stated(monkeypatch, image):
    monkeypatch.delattr(cv2, "xfeatures2d")
    assert available("sift") == (True, "")
    for name in ("akaze", "fast-brief"):
        usable_, reason = available(name)
        assert not usable_
        assert "pip uninstall" in reason
        assert "opencv-contrib-python-headless" in reason
        with pytest.raises(OperatorError, match="Repair"):
            detect(image, name)


def test_parallel_threads_do_not_change_the_result(image):
    other = texture(seed=1)
    jobs = [
        (im, name)
        for im in (image, other)
        for name in ("orb", "fast-brief", "sift", "akaze", "fast+freak")
    ]
    alone = [detect(*job).descriptors for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda job: detect(*job).descriptors, jobs))
    for a, b in zip(alone, together):
        np.testing.assert_array_equal(a, b)
