"""SURF compared with OpenCV, and on images with known blobs, gradients and symmetries."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.special import erf

from sfmkit.errors import InputError
from sfmkit.features.surf import describe, surf
from sfmkit.features.surf_descriptor import orientation
from sfmkit.features.surf_detector import fast_hessian

REFERENCES = {
    "boat_img1": "oxford/boat/img1.png",
    "fountain_0000_half": "strecha/fountain-P11/images/0000.jpg",
    "graf_img1": "oxford/graf/img1.png",
    "leuven_img1": "oxford/leuven/img1.png",
}


def texture(height: int = 240, width: int = 320, seed: int = 0) -> np.ndarray:
    """Draw (H, W) uint8 smooth noise of several scales, with blobs of all sizes, no symmetry."""
    rng = np.random.default_rng(seed)
    image = sum(
        40
        * cv2.resize(
            rng.normal(size=(height // c + 2, width // c + 2)),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        for c in (5, 12, 30)
    )
    return np.clip(image + 128, 0, 255).astype(np.uint8)


def blob(x: float, y: float, sigma: float, peak: float = 120, size: int = 200) -> np.ndarray:
    v, u = np.mgrid[:size, :size]
    return (
        np.rint(120 + peak * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * sigma**2)))
        .clip(0, 255)
        .astype(np.uint8)
    )


def partners(xy, size, others, other_sizes) -> np.ndarray:
    """Return the nearest other keypoint within 1 px and 10 % of the size, or -1."""
    distance, index = cKDTree(others).query(xy, k=8, distance_upper_bound=1.0)
    sizes = np.append(other_sizes, np.inf)[index]
    fits = np.isfinite(distance) & (np.abs(sizes - size[:, None]) <= 0.1 * size[:, None])
    return np.where(fits.any(1), index[np.arange(len(xy)), fits.argmax(1)], -1)


def turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle from a to b in radians, in [-pi, pi)."""
    return (b - a + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.data
@pytest.mark.parametrize("threshold", [30, 400])
@pytest.mark.parametrize("name", REFERENCES)
def test_surf_agrees_with_opencv(data_dir, name, threshold):
    image = cv2.imread(str(data_dir / REFERENCES[name]), cv2.IMREAD_GRAYSCALE)
    if name.endswith("half"):
        image = cv2.resize(
            image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA
        )
    with np.load(data_dir / "surf_reference" / f"{name}_h{threshold}.npz") as file:
        reference = dict(file)
    ours = surf(image, hessian_threshold=threshold)
    there = partners(reference["keypoints"], reference["size"], ours.keypoints, ours.scales)
    back = partners(ours.keypoints, ours.scales, reference["keypoints"], reference["size"])
    assert (there >= 0).mean() > 0.999
    assert (back >= 0).mean() > 0.999
    pair, there = there >= 0, there[there >= 0]
    assert np.abs(ours.keypoints[there] - reference["keypoints"][pair]).max() < 0.01
    np.testing.assert_allclose(ours.scores[there], reference["response"][pair], rtol=1e-3)
    np.testing.assert_array_equal(ours.laplacian[there], reference["laplacian_sign"][pair])
    assert np.median(
        np.abs(turn(np.radians(reference["angle_deg"][pair]), ours.angles[there]))
    ) < np.radians(0.1)
    cosine = (ours.descriptors[there] * reference["descriptors"][pair].astype(np.float32)).sum(1)
    assert np.median(cosine) > 0.998
    assert np.quantile(cosine, 0.1) > 0.99


def best_lobe(sigma: float) -> float:
    """Return the width k of the lobes, k x 5k/3, with the largest Dxx on a Gaussian blob.

    The closed form follows from Dxx = Dyy.
    """
    k = np.linspace(1, 8 * sigma, 4000)
    middle, three = erf(k / 2 / np.sqrt(2) / sigma), erf(3 * k / 2 / np.sqrt(2) / sigma)
    height = erf(5 * k / 6 / np.sqrt(2) / sigma) / k
    return k[((3 * middle - three) / k * height).argmax()]


@pytest.mark.parametrize("x, y", [(100.0, 100.0), (90.3, 104.6)])
@pytest.mark.parametrize("sigma", [2.5, 4.0, 9.0, 20.0])
@pytest.mark.parametrize("peak, sign", [(120, -1), (-100, 1)])
def test_blob_is_found_at_its_centre_scale_and_sign(x, y, sigma, peak, sign):
    found = surf(blob(x, y, sigma, peak), hessian_threshold=100)
    np.testing.assert_allclose(found.keypoints[0], (x, y), atol=0.03 * sigma + 0.05)
    assert found.scales[0] == pytest.approx(3 * best_lobe(sigma), rel=0.1, abs=2)
    assert found.laplacian[0] == sign


def _box(size: int, kind: str) -> np.ndarray:
    """Draw the box filters of Bay et al. (2008), figure 2."""
    k, kernel = size // 3, np.zeros((size, size))
    if kind == "xx":
        a, b = round(2 * size / 9), round(7 * size / 9)
        for lobe, weight in enumerate((1, -2, 1)):
            kernel[a:b, lobe * k : (lobe + 1) * k] = weight / (k * (b - a))
        return kernel
    a, b = round(size / 9), round(5 * size / 9)
    for y, x, weight in ((a, a, 1), (a, b, -1), (b, a, -1), (b, b, 1)):
        kernel[y : y + k, x : x + k] = weight / k**2
    return kernel


def test_maxima_agree_with_a_plain_search():
    """Compare every octave with a plain implementation.

    It has complete filters and a search that visits each sample in turn.
    """
    image = texture(150, 170, seed=3)
    found = fast_hessian(torch.from_numpy(cv2.integral(image)), 50.0, 2, 3)
    plain = []
    for octave in range(2):
        step, sizes = 1 << octave, [(9 + 6 * i) << octave for i in range(5)]
        det, shifts = [], []
        for size in sizes:
            xx, yy, xy = (
                cv2.filter2D(image.astype(np.float64), -1, k, anchor=(size // 2, size // 2))
                for k in (_box(size, "xx"), _box(size, "xx").T, _box(size, "xy"))
            )
            shift = size // 2 % step
            shifts.append(shift)
            d = (xx * yy - 0.81 * xy**2)[shift::step, shift::step]
            det.append(d[: image.shape[0] // step, : image.shape[1] // step])
        rows, cols = (min(d.shape[i] for d in det) for i in (0, 1))
        det = np.stack([d[:rows, :cols] for d in det])
        for layer in (1, 2, 3):
            margin = sizes[layer + 1] // 2 // step + 1
            for i in range(margin, image.shape[0] // step - margin):
                for j in range(margin, image.shape[1] // step - margin):
                    cube = det[layer - 1 : layer + 2, i - 1 : i + 2, j - 1 : j + 2]
                    if cube[1, 1, 1] > 50 and (cube >= cube[1, 1, 1]).sum() == 1:
                        offset = _newton(cube)
                        if (np.abs(offset) <= 1).all():
                            # The grid holds every step-th pixel from where filters begin at a
                            # multiple of the step.
                            x, y = (
                                step * (np.array([j, i]) + offset[:2])
                                + shifts[layer]
                                - (1 - sizes[layer] % 2) / 2
                            )
                            plain.append(
                                (cube[1, 1, 1], x, y, np.rint(sizes[layer] + 6 * step * offset[2]))
                            )
    plain = np.array(sorted(plain))
    ours = torch.cat([found.response[:, None], found.xy, found.size[:, None]], 1).numpy()
    np.testing.assert_allclose(ours[np.argsort(ours[:, 0])], plain, rtol=1e-3, atol=1e-2)


def _newton(cube: np.ndarray) -> np.ndarray:
    """Return the offset (x, y, scale) of the maximum of the quadratic through `cube`.

    The quadratic has the central differences of `cube` (scale, y, x).
    """
    unit = np.eye(3, dtype=int)[::-1]

    def at(v: np.ndarray) -> float:
        return cube[tuple(1 + v)]

    gradient = [(at(e) - at(-e)) / 2 for e in unit]
    hessian = [
        [
            (at(e + f) - at(e - f) - at(f - e) + at(-e - f)) / 4
            if (e != f).any()
            else at(e) - 2 * at(0 * e) + at(-e)
            for f in unit
        ]
        for e in unit
    ]
    return np.linalg.solve(hessian, -np.array(gradient))


@pytest.mark.parametrize("degrees", [0, 35, 90, 160, 250, 340])
def test_orientation_is_the_direction_of_a_gradient(degrees):
    v, u = np.mgrid[:121, :121] - 60.0
    a = np.radians(degrees)
    ramp = np.rint(128 + 1.2 * (u * np.cos(a) + v * np.sin(a))).astype(np.uint8)
    angle = orientation(
        torch.from_numpy(cv2.integral(ramp)), torch.tensor([[60.0, 60.0]]), torch.tensor([27.0])
    )
    assert abs(turn(angle.numpy(), a)) < np.radians(3)


def test_rotations_by_90_degrees_change_angles_but_not_descriptors():
    image = texture()
    one, two = (
        surf(image, hessian_threshold=200),
        surf(np.rot90(image).copy(), hessian_threshold=200),
    )
    # rot90 maps (x, y) to (y, W - 1 - x): directions are reduced by 90 degrees.
    moved = np.stack([one.keypoints[:, 1], image.shape[1] - 1 - one.keypoints[:, 0]], 1)
    there = partners(moved, one.scales, two.keypoints, two.scales)
    pair, there = there >= 0, there[there >= 0]
    assert pair.mean() > 0.9  # the sampling grids of the higher octaves start at another corner
    assert np.median(np.abs(turn(one.angles[pair] - np.pi / 2, two.angles[there]))) < np.radians(1)
    assert np.median((one.descriptors[pair] * two.descriptors[there]).sum(1)) > 0.99


def test_a_rotation_changes_angles_but_not_descriptors():
    image, degrees = texture(seed=4), 33
    A = cv2.getRotationMatrix2D((160, 120), degrees, 1)  # anticlockwise on screen
    turned = cv2.warpAffine(image, A, (320, 240), flags=cv2.INTER_CUBIC)
    one, two = surf(image, hessian_threshold=400), surf(turned, hessian_threshold=400)
    two = two.take(
        np.hypot(*(two.keypoints - (160, 120)).T) < 70
    )  # no pixels from outside the image
    there = partners(two.keypoints, two.scales, one.keypoints @ A[:, :2].T + A[:, 2], one.scales)
    pair, there = there >= 0, there[there >= 0]
    assert pair.mean() > 0.45  # box filters are not isotropic
    assert np.median(
        np.abs(turn(one.angles[there] - np.radians(degrees), two.angles[pair]))
    ) < np.radians(8)
    assert np.median((one.descriptors[there] * two.descriptors[pair]).sum(1)) > 0.98


def test_the_descriptor_contains_the_sums_of_gradients_in_its_cells():
    """On a ramp, every cell has sum dx = sum |dx| = its Gaussian weight, and no dy."""
    v, u = np.mgrid[:201, :201]
    ramp = np.rint(20 + u).astype(np.uint8)
    d = describe(ramp, np.array([[100.0, 100.0]]), np.array([30.0]), np.zeros(1))[0].reshape(
        4, 4, 4
    )
    offset = np.arange(20) - 9.5
    gauss = np.exp(-(offset**2) / (2 * 3.3**2)).reshape(4, 5).sum(1)
    expected = np.outer(gauss, gauss) / np.linalg.norm(np.outer(gauss, gauss)) / np.sqrt(2)
    np.testing.assert_allclose(d[..., 0], expected, atol=1e-3)
    np.testing.assert_allclose(d[..., 2], expected, atol=1e-3)
    np.testing.assert_allclose(d[..., [1, 3]], 0, atol=1e-3)


def test_extended_splits_the_sums_of_the_short_descriptor():
    image = texture()
    short, long = surf(image), surf(image, extended=True)
    assert short.descriptors.shape == (len(short), 64)
    assert long.descriptors.shape == (len(short), 128)
    np.testing.assert_array_equal(short.keypoints, long.keypoints)
    for f in (short, long):
        np.testing.assert_allclose(np.linalg.norm(f.descriptors, axis=1), 1, atol=1e-5)
    a = long.descriptors.reshape(
        -1, 16, 2, 2, 2
    )  # dx by the sign of dy, then dy by the sign of dx; plain and absolute
    joined = a.sum(3).transpose(0, 1, 3, 2).reshape(-1, 64)  # dx, dy, |dx|, |dy|
    joined /= np.linalg.norm(joined, axis=1, keepdims=True)
    np.testing.assert_allclose(joined, short.descriptors, atol=1e-4)


def test_upright_leaves_angles_at_zero():
    image = texture()
    upright = surf(image, upright=True)
    assert (upright.angles == 0).all()
    np.testing.assert_allclose(np.linalg.norm(upright.descriptors, axis=1), 1, atol=1e-5)
    turned = surf(image)
    unturned = np.abs(turn(turned.angles, 0)) < 0.02
    assert unturned.any()
    assert ((upright.descriptors * turned.descriptors).sum(1)[unturned] > 0.98).all()
    assert np.median((upright.descriptors * turned.descriptors).sum(1)) < 0.9


def test_describe_agrees_with_surf():
    image = texture()
    f = surf(image)
    for angles in (None, f.angles):
        np.testing.assert_allclose(
            describe(image, f.keypoints, f.scales, angles), f.descriptors, atol=1e-5
        )
    np.testing.assert_allclose(
        describe(image, f.keypoints, f.scales, f.angles, extended=True, upright=True),
        surf(image, extended=True, upright=True).descriptors,
        atol=1e-5,
    )


def test_describe_accepts_keypoints_anywhere_and_no_keypoints():
    image = texture(60, 80)
    xy = np.array([[0, 0], [79, 59], [-30, 500], [40, 30]], dtype=np.float32)
    d = describe(image, xy, np.array([7, 300, 20, 1e-3], dtype=np.float32))
    assert d.shape == (4, 64)
    assert np.isfinite(d).all()
    assert describe(image, np.zeros((0, 2)), np.zeros(0)).shape == (0, 64)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((1, 1), np.uint8),
        np.full((5, 400), 7, np.uint8),
        np.full((200, 200), 255, np.uint8),
        texture(20, 20),
        texture(300, 21),
    ],
    ids=["1x1", "flat strip", "blank", "smaller than the filters", "narrow"],
)
@pytest.mark.parametrize("extended", [False, True])
def test_uniform_images_have_no_keypoints(image, extended):
    f = surf(image, hessian_threshold=0 if image.std() == 0 else 30, extended=extended)
    assert len(f) == 0
    assert f.descriptors.shape == (0, 128 if extended else 64)
    assert f.keypoints.shape == (0, 2)
    assert f.laplacian.dtype == np.int8
    assert f.size_wh == image.shape[::-1]


def test_small_images_omit_the_large_octaves():
    image = texture(60, 300)
    f = surf(image, hessian_threshold=1)
    assert len(f)
    np.testing.assert_array_equal(f.scales, surf(image, hessian_threshold=1, octaves=8).scales)
    half = f.scales / 2
    assert (f.keypoints - half[:, None] > -2).all()
    assert (f.keypoints + half[:, None] < np.array([301, 61])).all()


def test_types_of_images():
    image = texture()
    f = surf(image)
    for other in (
        image.astype(np.float32),
        image.astype(np.int64),
        np.asfortranarray(image),
        image[::-1][::-1],
    ):
        np.testing.assert_array_equal(surf(other).descriptors, f.descriptors)
    assert {f.keypoints.dtype, f.scales.dtype, f.angles.dtype, f.scores.dtype} == {
        np.dtype(np.float32)
    }
    assert (f.descriptors.dtype, f.norm, f.operator, f.size_wh) == (
        np.float32,
        "l2",
        "surf",
        (320, 240),
    )
    assert (np.diff(f.scores) <= 0).all()
    assert (f.scores > 30).all()


@pytest.mark.parametrize(
    "call",
    [
        lambda: surf(np.zeros((9, 9, 3), np.uint8)),
        lambda: surf(np.zeros((0, 9), np.uint8)),
        lambda: surf(np.full((9, 9), np.nan)),
        lambda: surf(np.full((9, 9), 256)),
        lambda: surf(np.full((9, 9), "a")),
        lambda: surf(texture(), hessian_threshold=-1),
        lambda: surf(texture(), hessian_threshold=float("nan")),
        lambda: surf(texture(), octaves=0),
        lambda: surf(texture(), layers=0),
        lambda: describe(texture(), np.zeros((3, 3)), np.ones(3)),
        lambda: describe(texture(), np.zeros((3, 2)), np.ones(2)),
        lambda: describe(texture(), np.zeros((3, 2)), np.zeros(3)),
        lambda: describe(texture(), np.full((3, 2), np.inf), np.ones(3)),
        lambda: describe(texture(), np.zeros((3, 2)), np.ones(3), np.full(3, np.nan)),
    ],
)
def test_bad_input_is_named(call):
    with pytest.raises(InputError):
        call()


def test_strips_and_threads_do_not_change_the_result():
    image = texture(120, 210)
    integral = torch.from_numpy(cv2.integral(image))
    whole = fast_hessian(integral, 30.0, 4, 3, strip=1 << 30)
    assert len(whole) > 100
    before = torch.get_num_threads()
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            for strip in (1500, 20_000):
                part = fast_hessian(integral, 30.0, 4, 3, strip=strip)
                for name in ("xy", "size", "response", "sign"):
                    torch.testing.assert_close(
                        getattr(part, name), getattr(whole, name), rtol=0, atol=0
                    )
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)


def test_the_result_is_reproducible():
    one, two = surf(texture()), surf(texture())
    for name in ("keypoints", "scales", "angles", "scores", "descriptors", "laplacian"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.cuda
def test_cuda_agrees_with_the_cpu_on_surf():
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device here")
    image = texture()
    host, device = surf(image), surf(image, device="cuda")
    np.testing.assert_allclose(device.keypoints, host.keypoints, atol=1e-2)
    assert np.median((device.descriptors * host.descriptors).sum(1)) > 0.9999
