"""The exercises of the notebooks, by notebook and number: see :mod:`sfmkit.teaching`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .teaching import Exercise

Inputs = Callable[[], tuple[tuple[Any, ...], ...]]


def _random(make: Callable[[np.random.Generator], tuple[Any, ...]], n: int = 4) -> Inputs:
    """`n` inputs from a fixed seed."""
    return lambda: tuple(make(np.random.default_rng(seed)) for seed in range(n))


def _hat(t: np.ndarray) -> np.ndarray:
    return np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def _rotation(g: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(g.normal(size=(3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def _camera(g: np.random.Generator) -> np.ndarray:
    return np.array(
        [[g.uniform(700, 1500), 0, g.uniform(300, 700)], [0, g.uniform(700, 1500), g.uniform(200, 500)], [0, 0, 1]]
    )


# --- 00 quick start -------------------------------------------------------------------------------------------------

_QUICK_START = {
    "00.1": Exercise(
        "How many degrees wide is the view of a camera with a focal length of 1472 px and an image of 1600 px?",
        lambda: np.degrees(2 * np.arctan(800 / 1472)),
        (
            (lambda: 2 * np.arctan(800 / 1472), "That is the angle in radians; np.degrees converts it."),
            (
                lambda: np.degrees(np.arctan(800 / 1472)),
                "That is the angle from the middle to the edge: half of the view.",
            ),
            (
                lambda: np.degrees(np.arctan(1600 / 1472)),
                "The triangle's legs are the focal length and HALF the image's width.",
            ),
        ),
    ),
    "00.2": Exercise(
        "The cloud is in units of the baseline. The cameras stood 1.36 m apart: how many metres deep is a point with z = 8?",
        lambda: 8 * 1.36,
        (
            (
                lambda: 8 / 1.36,
                "One unit of the cloud is one baseline: 1.36 m. Eight of them are more than eight metres.",
            ),
        ),
    ),
    "00.3": Exercise(
        "Which of these numbers of one run cannot be larger than any of the others: 'keypoints', 'matches', 'inliers', "
        "'points'?",
        lambda: "points",
        (
            (lambda: "inliers", "Close: a point of the cloud is a triangulated inlier, and some are left out."),
            (lambda: "matches", "Matches are made first; the geometry then throws some of them out."),
            (
                lambda: "keypoints",
                "There are as many keypoints as the detector finds; only some of them find a partner.",
            ),
        ),
    ),
}


# --- 01 features ----------------------------------------------------------------------------------------------------


def _longest_run(on: np.ndarray, circular: bool = True) -> int:
    best = run = 0
    for v in np.tile(on, 2 if circular else 1):
        run = run + 1 if v else 0
        best = max(best, run)
    return min(best, len(on))


def _fast(ring: np.ndarray, centre: float, threshold: float) -> bool:
    return max(_longest_run(ring > centre + threshold), _longest_run(ring < centre - threshold)) >= 9


def _fast_inputs() -> tuple[tuple[Any, ...], ...]:
    def ring(*bright: int) -> np.ndarray:
        values = np.full(16, 100.0)
        values[list(bright)] = 160
        return values

    wraps = (12, 13, 14, 15, 0, 1, 2, 3, 4)
    dark = 200 - ring(*range(9))
    mixed = ring(*range(5))
    mixed[5:9] = 40
    rings = (ring(*range(9)), ring(*range(8)), ring(*wraps), ring(*range(0, 16, 2), 1, 3), dark, mixed, ring())
    return tuple((values, 100.0, 20.0) for values in rings)


def _orientation(patch: np.ndarray) -> float:
    r = len(patch) // 2
    y, x = np.mgrid[-r : r + 1, -r : r + 1]
    return np.arctan2((y * patch).sum(), (x * patch).sum())


def _box(S: np.ndarray, x0: int, y0: int, x1: int, y1: int) -> float:
    return S[y1, x1] - S[y0, x1] - S[y1, x0] + S[y0, x0]


_FEATURES = {
    "01.1": Exercise(
        "is_fast_corner(ring, centre, threshold): are 9 contiguous ones of the 16 ring pixels all brighter than centre + "
        "threshold, or all darker than centre - threshold? The ring has no ends.",
        _fast,
        (
            (
                lambda ring, c, t: max((ring > c + t).sum(), (ring < c - t).sum()) >= 9,
                "You count the pixels; the nine must also be neighbours of one another.",
            ),
            (
                lambda ring, c, t: max(_longest_run(ring > c + t, False), _longest_run(ring < c - t, False)) >= 9,
                "The ring has no ends: pixel 15 is a neighbour of pixel 0.",
            ),
            (
                lambda ring, c, t: _longest_run(ring > c + t) >= 9,
                "A dark corner counts as well: also look for nine pixels darker than centre - threshold.",
            ),
            (
                lambda ring, c, t: _longest_run(np.abs(ring - c) > t) >= 9,
                "All nine must differ in the same direction: brighter, or darker, not some of each.",
            ),
        ),
        _fast_inputs,
    ),
    "01.2": Exercise(
        "harris(A, k): the corner response det(A) - k trace(A)^2 of the 2 x 2 structure tensor A.",
        lambda A, k: np.linalg.det(A) - k * np.trace(A) ** 2,
        (
            (
                lambda A, k: np.linalg.det(A) - k * np.trace(A),
                "The trace is squared: both terms must have the same units.",
            ),
            (
                lambda A, k: np.linalg.det(A) + k * np.trace(A) ** 2,
                "The trace is subtracted: on an edge one eigenvalue is large and the response must be negative.",
            ),
        ),
        _random(lambda g: ((B := g.normal(size=(2, 2)) * 3) @ B.T, 0.05)),
    ),
    "01.3": Exercise(
        "box_sum(S, x0, y0, x1, y1): the sum of image[y0:y1, x0:x1] from four entries of the integral image S, where "
        "S[y, x] = image[:y, :x].sum().",
        _box,
        (
            (
                lambda S, x0, y0, x1, y1: S[y1, x1] - S[y0, x1] - S[y1, x0],
                "The corner (x0, y0) was taken away twice: add it once.",
            ),
            (
                lambda S, x0, y0, x1, y1: S[y1, x1] - S[y0, x0],
                "Two entries leave two strips outside the box in the sum; four are needed.",
            ),
        ),
        _random(lambda g: (np.pad(g.random((12, 15)), ((1, 0), (1, 0))).cumsum(0).cumsum(1), 3, 2, 11, 9)),
    ),
    "01.4": Exercise(
        "orientation(patch): the angle in radians from the middle of a square patch to its centroid of intensity, x to the "
        "right, y down, measured from x towards y.",
        _orientation,
        (
            (
                lambda p: np.pi / 2 - _orientation(p),
                "The arguments of arctan2 are (y, x): the moment of y comes first.",
            ),
            (
                lambda p: -_orientation(p),
                "y points down in an image: the angle grows from x towards y, clockwise on the screen.",
            ),
            (lambda p: np.degrees(_orientation(p)), "Radians are asked for."),
        ),
        _random(lambda g: (g.random((7, 7)) * np.linspace(0.2, 2, 7),)),
    ),
}


# --- 02 matching ----------------------------------------------------------------------------------------------------


def _mutual(D: np.ndarray) -> np.ndarray:
    nearest = D.argmin(1)
    rows = np.flatnonzero(D.argmin(0)[nearest] == np.arange(len(D)))
    return np.column_stack([rows, nearest[rows]])


_MATCHING = {
    "02.1": Exercise(
        "hamming(a, b): in how many bits do two descriptors of packed bytes (uint8) differ?",
        lambda a, b: int(np.unpackbits(a ^ b).sum()),
        (
            (lambda a, b: int((a != b).sum()), "You count bytes that differ; each of them holds eight bits."),
            (
                lambda a, b: int(np.abs(a.astype(int) - b.astype(int)).sum()),
                "The bytes are not numbers to subtract: every bit is an answer of its own. Compare them with ^.",
            ),
        ),
        _random(lambda g: tuple(g.integers(0, 256, (2, 32), dtype=np.uint8))),
    ),
    "02.2": Exercise(
        "mutual(D): the pairs (i, j), ordered by i, that are each other's nearest neighbours in the (N1, N2) distances D, "
        "as an (M, 2) array.",
        _mutual,
        (
            (
                lambda D: np.column_stack([np.arange(len(D)), D.argmin(1)]),
                "These are the nearest neighbours of image 1 alone: keep (i, j) only where i is nearest to j as well.",
            ),
            (lambda D: _mutual(D)[:, ::-1], "The columns are swapped: i, of image 1, comes first."),
        ),
        _random(lambda g: (g.random((9, 7)),)),
    ),
    "02.3": Exercise(
        "ratio(d): for the distances d of one feature to all candidates, the nearest over the second-nearest.",
        lambda d: np.sort(d)[0] / np.sort(d)[1],
        (
            (
                lambda d: np.sort(d)[1] / np.sort(d)[0],
                "Upside down: the ratio lies in [0, 1] and is small for a distinctive match.",
            ),
            (lambda d: d[0] / d[1], "The candidates come in no order: sort the distances first."),
            (lambda d: d.min() / d.max(), "The rival is the second-nearest candidate, not the farthest."),
        ),
        _random(lambda g: (g.random(12) + 0.1,)),
    ),
}


# --- 03 homography --------------------------------------------------------------------------------------------------


def _mapped(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    y = H @ np.append(x, 1)
    return y[:2] / y[2]


def _near_identity(g: np.random.Generator) -> np.ndarray:
    return np.diag([1, 1, 1e-3]) @ (np.eye(3) + 0.3 * g.uniform(-1, 1, (3, 3))) @ np.diag([1, 1, 1e3])


_HOMOGRAPHY = {
    "03.1": Exercise(
        "transfer(H, x1): the pixel (x, y) of image 2 to which the homography H takes the pixel x1 = (x, y) of image 1.",
        _mapped,
        (
            (
                lambda H, x: (H @ np.append(x, 1))[:2],
                "Homogeneous coordinates are not pixels yet: divide by the third.",
            ),
            (lambda H, x: _mapped(np.linalg.inv(H), x), "That is the way back, from image 2 to image 1."),
            (
                lambda H, x: (H[:2, :2] @ x + H[:2, 2]) / H[2, 2],
                "The third row counts as well: without it, H would be affine and keep parallels parallel.",
            ),
        ),
        _random(lambda g: (_near_identity(g), g.uniform(0, 640, 2))),
        tolerance=1e-5,
    ),
    "03.2": Exercise(
        "between(H12, H13): the homography from image 2 to image 3 of one plane, given those from image 1 to 2 and from 1 "
        "to 3; any scale.",
        lambda H12, H13: H13 @ np.linalg.inv(H12),
        (
            (
                lambda H12, H13: np.linalg.inv(H12) @ H13,
                "The order: what is done first stands next to the pixel, on the right.",
            ),
            (lambda H12, H13: H13 @ H12, "H12 leads from image 1 to image 2; you start in image 2, so undo it."),
            (lambda H12, H13: H12 @ np.linalg.inv(H13), "That leads from image 3 to image 2."),
        ),
        _random(lambda g: (_near_identity(g), _near_identity(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "03.3": Exercise(
        "turning(K, R): the homography between two photographs from one place, X2 = R X1, with one camera K; any scale.",
        lambda K, R: K @ R @ np.linalg.inv(K),
        (
            (
                lambda K, R: np.linalg.inv(K) @ R @ K,
                "K takes rays to pixels: its inverse stands on the right, where the pixel of image 1 comes in.",
            ),
            (lambda K, R: K @ R.T @ np.linalg.inv(K), "R turns from camera 1 to camera 2 already."),
            (lambda K, R: R, "R turns rays, and pixels are no rays: K is missing on either side."),
        ),
        _random(lambda g: (_camera(g), _rotation(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "03.4": Exercise(
        "How many matches at least does a homography take?",
        lambda: 4,
        (
            (lambda: 8, "Eight degrees of freedom, right; but every match gives two equations."),
            (lambda: 9, "Nine entries, of which the scale says nothing; and every match gives two equations."),
            (lambda: 3, "Three matches make six equations, enough for an affine map."),
        ),
    ),
}


# --- 04 epipolar geometry -------------------------------------------------------------------------------------------


def _line(F: np.ndarray, x: np.ndarray) -> np.ndarray:
    line = F @ np.append(x, 1)
    return line / np.linalg.norm(line[:2])


_EPIPOLAR = {
    "04.1": Exercise(
        "line(F, x1): the epipolar line (a, b, c) in image 2 of the pixel x1 = (x, y) in image 1, any scale.",
        _line,
        (
            (
                lambda F, x: _line(F.T, x),
                "That is the line in image 1 of a pixel of image 2: F itself takes image 1 to image 2.",
            ),
            (
                lambda F, x: F @ np.append(x, 0),
                "The third homogeneous coordinate of a pixel is 1; with 0 it is a direction.",
            ),
        ),
        _random(lambda g: (g.normal(size=(3, 3)), g.uniform(0, 3, 2))),
        up_to_scale=True,
    ),
    "04.2": Exercise(
        "distance(line, x): how many pixels the pixel x = (x, y) lies from the line a x + b y + c = 0 (not negative).",
        lambda l, x: abs(l @ np.append(x, 1)) / np.linalg.norm(l[:2]),
        (
            (
                lambda l, x: abs(l @ np.append(x, 1)),
                "Only with a² + b² = 1 is this a distance: divide by sqrt(a² + b²).",
            ),
            (lambda l, x: abs(l @ np.append(x, 1)) / (l[:2] @ l[:2]), "Divide by the root of a² + b²."),
            (
                lambda l, x: abs(l @ np.append(x, 1)) / np.linalg.norm(l),
                "c is no part of the normal: divide by sqrt(a² + b²).",
            ),
            (
                lambda l, x: l @ np.append(x, 1) / np.linalg.norm(l[:2]),
                "This is the signed distance; its absolute value is asked for.",
            ),
        ),
        _random(lambda g: (g.normal(size=3), g.uniform(-5, 5, 2)), 6),
    ),
    "04.3": Exercise(
        "essential(F, K1, K2): the essential matrix of F, which is for pixels, any scale.",
        lambda F, K1, K2: K2.T @ F @ K1,
        (
            (lambda F, K1, K2: K1.T @ F @ K2, "F stands between x2 on its left and x1 on its right: so do K2 and K1."),
            (
                lambda F, K1, K2: np.linalg.inv(K2).T @ F @ np.linalg.inv(K1),
                "The other way about: this makes F from E. Put x = K xn into x2^T F x1 = 0.",
            ),
            (lambda F, K1, K2: K2 @ F @ K1, "x2^T = xn2^T K2^T: the transpose is missing."),
        ),
        _random(lambda g: (g.normal(size=(3, 3)), _camera(g), _camera(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "04.4": Exercise(
        "How many degrees of freedom has a fundamental matrix?",
        lambda: 7,
        (
            (lambda: 9, "Nine entries, but the scale says nothing and the determinant is zero."),
            (lambda: 8, "Eight are left without the scale; the determinant is zero as well."),
            (lambda: 5, "Five has the essential matrix: three of the rotation and two of the translation's direction."),
        ),
    ),
}


# --- 05 motion ------------------------------------------------------------------------------------------------------


def _in_front(X: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    return (X[:, 2] > 0) & ((X @ R.T + t)[:, 2] > 0)


_POSE = _random(lambda g: (_rotation(g), _unit(g.normal(size=3))))

_MOTION = {
    "05.1": Exercise(
        "centre(R, t): where camera 2 stands, in the frame of camera 1, given X2 = R X1 + t.",
        lambda R, t: -R.T @ t,
        (
            (lambda R, t: t, "t is where camera 1 stands in the frame of camera 2: put X1 = 0 in. Solve R X1 + t = 0."),
            (lambda R, t: -t, "-t is a direction in the axes of camera 2; turn it back into those of camera 1."),
            (lambda R, t: R.T @ t, "The sign: the centre is the X1 with R X1 + t = 0."),
            (lambda R, t: -R @ t, "Undo the rotation with its transpose."),
        ),
        _POSE,
    ),
    "05.2": Exercise(
        "essential(R, t): the essential matrix of the motion X2 = R X1 + t, any scale.",
        lambda R, t: _hat(t) @ R,
        (
            (lambda R, t: R @ _hat(t), "The order: X2 = R X1 + t is crossed with t from the left, E = [t]x R."),
            (lambda R, t: _hat(t) @ R.T, "R turns from camera 1 to camera 2 already; it needs no transpose."),
            (lambda R, t: _hat(t), "That is E of a motion without rotation."),
        ),
        _POSE,
        up_to_scale=True,
    ),
    "05.3": Exercise(
        "in_front(X, R, t): which of the points X (N, 3), given in camera 1, lie in front of both cameras? (N,) of booleans.",
        _in_front,
        (
            (lambda X, R, t: X[:, 2] > 0, "In front of camera 1 they are; camera 2 sees X2 = R X + t."),
            (
                lambda X, R, t: (X @ R.T + t)[:, 2] > 0,
                "That is camera 2; a point must lie in front of camera 1 as well.",
            ),
            (lambda X, R, t: (X[:, 2] > 0) & ((X @ R + t)[:, 2] > 0), "Points are rows here: R X becomes X @ R.T."),
        ),
        _random(lambda g: (g.normal(size=(40, 3)), _rotation(g), _unit(g.normal(size=3)))),
    ),
    "05.4": Exercise(
        "What of the motion can no pair of photographs tell, however good: 'rotation', 'direction of t' or 'length of t'?",
        lambda: "length of t",
        (
            (lambda: "rotation", "The rotation is what photographs tell best, even without any translation."),
            (lambda: "direction of t", "The epipoles are its images. Think of a model railway instead of a railway."),
        ),
    ),
}


# --- 06 triangulation -----------------------------------------------------------------------------------------------


def _midpoint(c1: np.ndarray, d1: np.ndarray, c2: np.ndarray, d2: np.ndarray) -> np.ndarray:
    a, b = np.linalg.lstsq(np.column_stack([d1, -d2]), c2 - c1, rcond=None)[0]
    return (c1 + a * d1 + c2 + b * d2) / 2


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


def _nearest_on(c1: np.ndarray, d1: np.ndarray, c2: np.ndarray, d2: np.ndarray) -> np.ndarray:
    a, _ = np.linalg.lstsq(np.column_stack([d1, -d2]), c2 - c1, rcond=None)[0]
    return c1 + a * d1


_STEREO = _random(lambda g: (g.uniform(500, 2000), g.uniform(0.1, 2), g.uniform(2, 60)))

_TRIANGULATION = {
    "06.1": Exercise(
        "depth(f, b, d): the depth of a point with a disparity of d pixels between two parallel cameras of focal length f "
        "pixels that stand b metres apart.",
        lambda f, b, d: f * b / d,
        (
            (lambda f, b, d: f * d / b, "Near things move more: the disparity belongs below the line."),
            (lambda f, b, d: b / d, "Pixels are left over in the units: the focal length is missing."),
        ),
        _STEREO,
    ),
    "06.2": Exercise(
        "depth_sigma(z, f, b, sigma): the standard deviation of the depth z, to first order, when the disparity has the "
        "standard deviation sigma (pixels).",
        lambda z, f, b, s: z**2 / (f * b) * s,
        (
            (
                lambda z, f, b, s: z / (f * b) * s,
                "Derive z = f b / d by d and put d = f b / z back in: z appears squared.",
            ),
            (lambda z, f, b, s: f * b / z**2 * s, "Upside down: the error must grow with the depth."),
        ),
        _random(lambda g: (g.uniform(2, 50), g.uniform(500, 2000), g.uniform(0.1, 2), g.uniform(0.1, 1))),
    ),
    "06.3": Exercise(
        "midpoint(c1, d1, c2, d2): the middle of the shortest segment between the rays c1 + a d1 and c2 + b d2.",
        _midpoint,
        (
            (_nearest_on, "That end of the segment lies on ray 1; the middle between both ends is asked for."),
            (lambda c1, d1, c2, d2: _nearest_on(c2, d2, c1, d1), "That end lies on ray 2; the middle is asked for."),
        ),
        _random(lambda g: (np.zeros(3), _unit(g.normal(size=3)), g.normal(size=3), _unit(g.normal(size=3)))),
    ),
    "06.4": Exercise(
        "angle(a, b): the angle between two rays (any lengths), in degrees.",
        lambda a, b: np.degrees(_angle(a, b)),
        (
            (_angle, "That is in radians; np.degrees converts it."),
            (lambda a, b: np.degrees(np.arccos(np.clip(a @ b, -1, 1))), "The rays need not have unit length."),
        ),
        _random(lambda g: tuple(g.normal(size=(2, 3)) * 2)),
    ),
}


# --- 07 differentiable geometry -------------------------------------------------------------------------------------

_LINEAR = _random(lambda g: (g.normal(size=(20, 3)), g.normal(size=20)))

_DIFFERENTIABLE = {
    "07.1": Exercise(
        "derivative(f, x, h): the central difference quotient of the function f at x with step h.",
        lambda f, x, h: (f(x + h) - f(x - h)) / (2 * h),
        (
            (
                lambda f, x, h: (f(x + h) - f(x)) / h,
                "The one-sided quotient is off by h f''/2; take a step to both sides.",
            ),
            (lambda f, x, h: (f(x + h) - f(x - h)) / h, "From x - h to x + h it is 2 h."),
        ),
        lambda: tuple((f, x, 0.1) for f in (np.sin, np.exp) for x in (0.3, 1.1)),
        tolerance=1e-9,
    ),
    "07.2": Exercise(
        "step(J, r): the step of Gauss-Newton from residuals r (N,) and their Jacobian J (N, P).",
        lambda J, r: -np.linalg.solve(J.T @ J, J.T @ r),
        (
            (lambda J, r: np.linalg.solve(J.T @ J, J.T @ r), "Only the sign is wrong: the step goes downhill."),
            (lambda J, r: -J.T @ r, "That is steepest descent; divide by the curvature, solve with J^T J."),
        ),
        _LINEAR,
    ),
    "07.3": Exercise(
        "covariance(J, sigma): of the least-squares estimate, when each residual has the standard deviation sigma.",
        lambda J, s: s**2 * np.linalg.inv(J.T @ J),
        (
            (lambda J, s: s * np.linalg.inv(J.T @ J), "A covariance has squared units: sigma appears squared."),
            (lambda J, s: J.T @ J / s**2, "That is the information matrix; the covariance is its inverse."),
            (
                lambda J, s: np.linalg.inv(J.T @ J),
                "The noise is missing: twice the noise is four times the covariance.",
            ),
        ),
        _random(lambda g: (g.normal(size=(20, 3)), g.uniform(0.2, 3))),
    ),
}


# --- 08 ablation ----------------------------------------------------------------------------------------------------


def _auc(errors: np.ndarray, threshold: float) -> float:
    return float(np.clip(1 - errors / threshold, 0, None).mean())


def _auc_inputs() -> tuple[tuple[Any, ...], ...]:
    g = np.random.default_rng(0)
    some = g.gamma(1.0, 2.0, 12)
    return (some, 5.0), (np.append(some, [np.inf, np.inf, np.inf]), 5.0), (np.append(some, np.inf), 3.0)


def _paired(g: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    hard = g.normal(0.5, 0.3, 25)
    return hard + g.normal(0.05, 0.05, 25), hard


_ABLATION = {
    "08.1": Exercise(
        "auc(errors, threshold): the area under the curve of the share of runs with an error of at most e, for e from 0 to the "
        "threshold, over the threshold. A run without an answer has an infinite error.",
        _auc,
        (
            (
                lambda errors, t: _auc(errors[np.isfinite(errors)], t),
                "You leave out the runs without an answer: whoever gives up on everything hard would come first.",
            ),
            (
                lambda errors, t: (errors <= t).mean(),
                "That is the height of the curve at the threshold, not the area under it.",
            ),
            (
                lambda errors, t: np.clip(t - errors, 0, None).mean(),
                "That area grows with the threshold; divide by it, so that no error at all gives 1.",
            ),
        ),
        _auc_inputs,
    ),
    "08.2": Exercise(
        "standard_error(a, b): the standard error of the mean difference of two setups, whose scores a and b are of the same "
        "pairs, in the same order (use ddof=1).",
        lambda a, b: np.std(a - b, ddof=1) / np.sqrt(len(a)),
        (
            (
                lambda a, b: np.sqrt((np.var(a, ddof=1) + np.var(b, ddof=1)) / len(a)),
                "That is for two groups of different pairs. Both setups see the same ones, hard and easy; what is hard for one is hard "
                "for the other, and cancels in a - b.",
            ),
            (
                lambda a, b: np.std(a - b, ddof=1),
                "That is how much single pairs scatter; the mean of n of them scatters less, by the square root of n.",
            ),
            (
                lambda a, b: np.std(a - b) / np.sqrt(len(a)),
                "Almost: the mean was estimated from the same differences, so divide by n - 1 (ddof=1).",
            ),
        ),
        _random(_paired),
        tolerance=1e-6,
    ),
    "08.3": Exercise(
        "shapley(v1, v2, v12): the Shapley values of two operators that reach v1 and v2 alone and v12 together; nothing reaches 0.",
        lambda v1, v2, v12: np.array([v1 + v12 - v2, v2 + v12 - v1]) / 2,
        (
            (
                lambda v1, v2, v12: np.array([v12 - v2, v12 - v1]),
                "That is the loss without each: its gain where it joins last. Average with its gain where it comes first.",
            ),
            (
                lambda v1, v2, v12: np.array([v1, v2]),
                "That is what each reaches alone: its gain where it comes first. Average with its gain where it joins last.",
            ),
            (
                lambda v1, v2, v12: v12 * np.array([v1, v2]) / (v1 + v2),
                "The parts add up as they should, but are not what each adds, averaged over both orders of joining.",
            ),
        ),
        lambda: ((0.6, 0.5, 0.8), (0.4, 0.4, 0.8), (0.7, 0.2, 0.7)),
    ),
    "08.4": Exercise(
        "All 31 combinations of five operators are compared with one another, and in truth all are alike. How many of the "
        "uncorrected p-values are below 0.05, on average?",
        lambda: 31 * 30 / 2 * 0.05,
        (
            (lambda: 31 * 0.05, "There are more comparisons than combinations: each with every other."),
            (lambda: 31 * 30 * 0.05, "A with B and B with A is one comparison."),
            (lambda: 0, "A p-value below 0.05 comes by chance once in twenty times, and there are many times here."),
        ),
    ),
}


# --- 09 your own photographs ----------------------------------------------------------------------------------------


def _resized(K: np.ndarray, s: float, half: float = 0.5, focal: bool = True) -> np.ndarray:
    out = K.astype(float).copy()
    if focal:
        out[:2, :2] *= s
    out[:2, 2] = (out[:2, 2] + half) * s - half
    return out


_OWN = {
    "09.1": Exercise(
        "focal_px(f35, w, h): the focal length in pixels of a w x h photograph whose EXIF says f35 mm (35 mm equivalent, "
        "by the diagonal of the 36 x 24 mm frame).",
        lambda f35, w, h: f35 / np.hypot(36, 24) * np.hypot(w, h),
        (
            (
                lambda f35, w, h: f35 / 36 * w,
                "That takes the equivalent by the frame's width; it is defined by the diagonal. For 3:2 it is the same, here not.",
            ),
            (
                lambda f35, w, h: f35 * np.hypot(36, 24) / np.hypot(w, h),
                "Upside down: more pixels make a longer focal length in pixels.",
            ),
        ),
        lambda: ((26.0, 4000, 3000), (50.0, 1920, 1080), (28.0, 3000, 4000)),
    ),
    "09.2": Exercise(
        "resize(K, s): the intrinsics of the photograph resized by the factor s, where the centre of the top-left pixel is "
        "(0, 0).",
        lambda K, s: _resized(K, s),
        (
            (
                lambda K, s: _resized(K, s, half=0.0),
                "The image's corner stays where it is, at (-½, -½), not the first pixel's centre: c' = (c + ½) s - ½.",
            ),
            (lambda K, s: _resized(K, s, focal=False), "The focal length is in pixels too, and scales with them."),
            (lambda K, s: K * s, "The last row stays (0, 0, 1)."),
        ),
        _random(lambda g: (_camera(g), g.choice([0.25, 0.5, 2.0]))),
        tolerance=1e-6,
    ),
    "09.3": Exercise(
        "Which pair gives no cloud at all: 'a step to the side', 'a step forward' or 'turning on the spot'?",
        lambda: "turning on the spot",
        (
            (lambda: "a step to the side", "That is the best pair there is: the parallax is large everywhere."),
            (lambda: "a step forward", "Only what lies straight ahead, near the epipole, has no parallax then."),
        ),
    ),
}

EXERCISES: dict[str, Exercise] = {
    **_QUICK_START,
    **_FEATURES,
    **_MATCHING,
    **_HOMOGRAPHY,
    **_EPIPOLAR,
    **_MOTION,
    **_TRIANGULATION,
    **_DIFFERENTIABLE,
    **_ABLATION,
    **_OWN,
}
