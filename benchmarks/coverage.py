"""Compare the errors of poses and points with the covariances that are stated for them.

    SFMKIT_DATA=... python benchmarks/coverage.py [--views 8] [--size 1024x768]
        [--groups rendered,fountain,temple]

A stated covariance is right if the 68 % region contains the truth in 68 % of the cases, and the
95 % region in 95 %. The regions are ellipsoids of the squared Mahalanobis distance: 5 degrees of
freedom for a pose, 1 for a depth along the ray, 3 for the rotation that remains of a cycle of three
pairs. `ratio` is the square root of the median squared distance over its median for a right
covariance: errors are `ratio` times as large as stated.

* rendered: views of the courtyard and of the dish from random places, exact poses and depths. Once
  with the true camera, whose uncertainty is set to zero, and once with a camera whose focal length,
  principal point and k1 are drawn from the uncertainty of a given camera.
* fountain, temple: neighbours and second neighbours of EPFL fountain-P11 (half size) and of the
  Middlebury temple ring. The true poses have errors too; the second line of each adds 0.03 degrees
  of rotation and 0.1 degrees of direction. Cycles of three photographs need no true poses.

The columns are the covariance of independent pixel noise, that of image regions (block jackknife),
and the stored one, which also contains the cameras.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.stats import chi2
from torch import Tensor

from sfmkit import Camera, Features, detect, read_image
from sfmkit.datasets.middlebury import temple_places
from sfmkit.datasets.rendering import SCENES, Pose, Scene, radiance
from sfmkit.datasets.rendering.raycasting import EXACT, rays
from sfmkit.datasets.rendering.scenes import look
from sfmkit.datasets.strecha import strecha
from sfmkit.datasets.synthetic import photograph
from sfmkit.estimation import within_the_field
from sfmkit.estimation.adjust import LOSS, LOSS_SCALE_PX, adjust
from sfmkit.estimation.two_view import undistorted_pixels
from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.lie import so3_log, tangent_basis
from sfmkit.geometry.uncertainty import covariance
from sfmkit.io.truth import read_truth
from sfmkit.options import DEFAULT
from sfmkit.pipeline.stages import (
    OPERATORS_OF_THE_PAPER,
    estimate_geometry,
    fuse_all,
    make_cloud,
    match_all,
)
from sfmkit.types import IntrinsicsSigma, Verdict

NOISE, REGIONS, STORED = "pixel noise", "image regions", "stored"
TRUTH_DEG = (0.03, 0.1)
EXACT_CAMERA = IntrinsicsSigma(0.0, 0.0, 0.0)
# Where the views of a scene are taken from and look at: lower and upper corner of a box, metres.
STATIONS = {
    "courtyard": (((-1.6, -1.9, 0.0), (2.2, -1.4, 1.0)), ((-0.4, -1.6, 7.0), (0.4, -1.3, 7.0))),
    "dish": (((-1.2, -1.8, 0.0), (1.2, -1.3, 0.6)), ((-0.2, -1.1, 4.0), (0.2, -0.9, 4.0))),
}


@dataclass(frozen=True, eq=False)
class Estimate:
    """A pose with the covariances that are compared.

    Attributes:
        R, t: The estimate.
        covariances: (5, 5) by the name of what it contains.
    """

    R: Tensor
    t: Tensor
    covariances: dict[str, Tensor]


@dataclass(frozen=True, eq=False)
class Shot:
    """A photograph with its true pose, ``x_cam = R X + t``."""

    image: object
    camera: Camera
    R: np.ndarray
    t: np.ndarray
    features: dict[str, Features]


def shoot(
    image: object, camera: Camera, R: np.ndarray, t: np.ndarray, max_size: int | None
) -> Shot:
    """Detect the features of a photograph."""
    read = read_image(image)
    found = {
        name: detect(read, name, budget=DEFAULT.detect.budget, max_size=max_size)
        for name in OPERATORS_OF_THE_PAPER
    }
    return Shot(read, camera, R, t, found)


def relative(first: Shot, second: Shot) -> tuple[Tensor, Tensor]:
    """True pose of the second camera relative to the first."""
    R = second.R @ first.R.T
    return torch.tensor(R), torch.tensor(second.t - R @ first.t)


def estimate(first: Shot, second: Shot, cameras: tuple[Camera, Camera]):
    """Run the pipeline from the matches on; None if the pose is not accepted as general."""
    pairs = {name: (first.features[name], second.features[name]) for name in first.features}
    corr = within_the_field(
        fuse_all(pairs, match_all(pairs, DEFAULT.match), DEFAULT.fuse), *cameras
    )
    view, adjustment = estimate_geometry(corr, cameras, DEFAULT.estimate)
    if view.verdict is not Verdict.GENERAL or adjustment is None:
        return None
    first_exact, second_exact = (replace(camera, sigma=EXACT_CAMERA) for camera in cameras)
    regions = adjust(corr, replace(view, camera1=first_exact, camera2=second_exact))
    x1, x2 = (x[adjustment.rows] for x in undistorted_pixels(corr, *cameras))
    K1, K2 = (camera.tensors()[0] for camera in cameras)
    bundle = bundle_adjust(x1, x2, K1, K2, view.R, view.t, loss=LOSS, loss_scale=LOSS_SCALE_PX)
    found = Estimate(
        adjustment.view.R,
        adjustment.view.t,
        {
            NOISE: covariance(bundle).pose,
            REGIONS: regions.view.pose_covariance,
            STORED: adjustment.view.pose_covariance,
        },
    )
    return found, make_cloud(corr, view, first.image, DEFAULT.triangulate, adjustment)


def pose_distances(found: Estimate, truth: tuple[Tensor, Tensor], add_deg=(0.0, 0.0)):
    """Squared Mahalanobis distance of the error for every covariance, and the errors in degrees."""
    R, t = truth
    t = t / t.norm()
    turn = so3_log(R @ found.R.mT)
    across = t - (t @ found.t) * found.t
    angle = torch.atan2(across.norm(), t @ found.t)
    move = tangent_basis(found.t).mT @ across * (angle / across.norm())
    error = torch.cat((turn, move))
    rotation, direction = np.deg2rad(add_deg)
    more = torch.tensor([rotation**2 / 3] * 3 + [direction**2 / 2] * 2).diag()
    distances = {
        name: float(error @ torch.linalg.solve(C + more, error))
        for name, C in found.covariances.items()
    }
    return distances, (float(turn.norm().rad2deg()), float(move.norm().rad2deg()))


def closure(cycle: Sequence[Estimate]) -> dict[str, float]:
    """Squared Mahalanobis distance of the rotation that is left of a cycle of three pairs.

    The rotations are those of 1 -> 2, 2 -> 3 and 3 -> 1; the errors of the pairs are taken to be
    independent.
    """
    first, second, third = cycle
    turn = so3_log(third.R @ second.R @ first.R)
    distances = {}
    for name in first.covariances:
        total = sum(
            A @ step.covariances[name][:3, :3] @ A.mT
            for step, A in (
                (third, torch.eye(3).double()),
                (second, third.R),
                (first, third.R @ second.R),
            )
        )
        distances[name] = float(turn @ torch.linalg.solve(total, turn))
    return distances


def report(
    what: str, distances: Sequence[dict[str, float]], freedom: int, errors: str = ""
) -> None:
    """Print one line of the table."""
    if not distances:
        print(f"| {what} | 0 | {errors} |" + " – |" * 3, flush=True)
        return
    cells = []
    for name in distances[0]:
        d = np.array([row[name] for row in distances])
        ratio = np.sqrt(np.median(d) / chi2.median(freedom))
        inside = [100 * np.mean(d < chi2.ppf(share, freedom)) for share in (0.68, 0.95)]
        cells.append(f"{ratio:.2f}, {inside[0]:.0f} / {inside[1]:.0f} %")
    cells += ["–"] * (3 - len(cells))
    print(f"| {what} | {len(distances)} | {errors} | " + " | ".join(cells) + " |", flush=True)


def median_errors(errors: Sequence[tuple[float, float]]) -> str:
    """Median rotation and direction error, degrees."""
    return "{:.3f}° / {:.3f}°".format(*np.median(errors, axis=0)) if errors else "–"


# ---- rendered scenes ----


def stations(scene: str, views: int) -> Iterator[Pose]:
    """Camera poses in front of a scene: evenly spaced from left to right, random otherwise."""
    rng = np.random.default_rng(11)
    eyes, targets = (np.array(box) for box in STATIONS[scene])
    for k in range(views):
        share = rng.uniform(size=3)
        share[0] = (k + share[0]) / views
        eye, target = eyes[0] + share * (eyes[1] - eyes[0]), rng.uniform(*targets)
        yield look(tuple(eye), tuple(target), rng.uniform(-4, 4))


def rendered_shots(name: str, views: int, size_wh: tuple[int, int]) -> list[tuple[Pose, Shot]]:
    """Render a scene from random places."""
    scene: Scene = SCENES[name]()
    camera = Camera(scene.K(size_wh), size_wh)
    shots = []
    for k, pose in enumerate(stations(name, views)):
        light = radiance(scene, pose, camera.K, size_wh, 2)
        image = photograph(light, 0.8, 1.2, 1.0, 92, np.random.default_rng((3, k)))
        shots.append((pose, shoot(image, camera, pose.R, -pose.R @ pose.centre, None)))
    return shots


def drawn(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera that a calibration with the stated uncertainty could have given."""
    sigma = camera.uncertainty
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= 1 + sigma.focal * rng.standard_normal()
    K[:2, 2] += sigma.principal_point * rng.standard_normal(2)
    return Camera(K, camera.size_wh, np.array([sigma.k1 * rng.standard_normal(), 0, 0, 0, 0]))


def depth_distances(cloud, scene: Scene, pose: Pose, camera: Camera, baseline: float) -> np.ndarray:
    """Squared error of the depth along the ray over its stated variance, for every point."""
    X = cloud.xyz.numpy().astype(np.float64)
    x = X @ camera.K.T
    x = x[:, :2] / x[:, 2:]
    z = scene.cast(*rays(camera.K, pose, x.T), EXACT)[0]
    variance = cloud.covariance.numpy()[:, 2, 2]
    known = np.isfinite(z) & np.isfinite(variance) & (variance > 0)
    return ((X[:, 2] - z / baseline) ** 2 / variance)[known]


def rendered(views: int, size_wh: tuple[int, int]) -> None:
    """Print the lines of the rendered scenes."""
    rng = np.random.default_rng(5)
    for name in STATIONS:
        scene = SCENES[name]()
        shots = rendered_shots(name, views, size_wh)
        exact, uncertain, depths, errors = [], [], [], []
        refused = 0
        for a in range(views):
            for b in range(a + 1, views):
                (pose, first), (_, second) = shots[a], shots[b]
                truth = relative(first, second)
                if truth[1].norm() < 0.3:
                    continue
                camera = replace(first.camera, sigma=EXACT_CAMERA)
                done = estimate(first, second, (camera, camera))
                if done is None:
                    refused += 1
                    continue
                found, cloud = done
                distances, error = pose_distances(found, truth)
                exact.append(distances)
                errors.append(error)
                d = depth_distances(cloud, scene, pose, camera, float(truth[1].norm()))
                depths.append(d)
                other = drawn(first.camera, rng)
                done = estimate(first, second, (other, other))
                if done is not None:
                    uncertain.append(pose_distances(done[0], truth)[0])
        report(f"{name}, true camera, {refused} refused", exact, 5, median_errors(errors))
        report(f"{name}, drawn camera", uncertain, 5)
        points = [{STORED: float(d)} for of_a_pair in depths for d in of_a_pair]
        report(f"{name}, depth of points", points, 1)


# ---- photographs ----


def fountain_shots() -> list[Shot]:
    """The photographs of fountain-P11, searched at half size."""
    pairs = list(strecha(sequences=["fountain-P11"]))
    files = [pairs[0].image1, *(pair.image2 for pair in pairs)]
    cameras = [pairs[0].camera1, *(pair.camera2 for pair in pairs)]
    shots = []
    for file, camera in zip(files, cameras):
        R, t = read_truth(Path(file).parents[1] / "gt_dense_cameras", files[0], file)
        shots.append(shoot(file, camera, np.asarray(R), np.asarray(t), 1536))
    return shots


def temple_shots() -> list[Shot]:
    """The photographs of the temple ring, each place once."""
    return [shoot(v.path, v.camera, v.R, v.t, None) for v in temple_places()]


def photographs(name: str, shots: list[Shot], ring: bool) -> None:
    """Print the lines of a sequence of photographs."""
    count = len(shots)
    found: dict[tuple[int, int], Estimate] = {}
    for step in (1, 2):
        distances, with_truth, errors, refused = [], [], [], 0
        for a in range(count if ring else count - step):
            b = (a + step) % count
            done = estimate(shots[a], shots[b], (shots[a].camera, shots[b].camera))
            if done is None:
                refused += 1
                continue
            found[a, b] = done[0]
            truth = relative(shots[a], shots[b])
            d, error = pose_distances(done[0], truth)
            distances.append(d)
            errors.append(error)
            with_truth.append(pose_distances(done[0], truth, TRUTH_DEG)[0])
        which = "neighbours" if step == 1 else "second neighbours"
        report(f"{name}, {which}, {refused} refused", distances, 5, median_errors(errors))
        report(f"{name}, {which}, with the truth's error", with_truth, 5)
    cycles: list[dict[str, float]] = []
    for a in range(count if ring else count - 2):
        b, c = (a + 1) % count, (a + 2) % count
        if all(key in found for key in ((a, b), (b, c), (a, c))):
            cycles.append(closure((found[a, b], found[b, c], reverse(found[a, c]))))
    report(f"{name}, cycles of three", cycles, 3)


def reverse(step: Estimate) -> Estimate:
    """The rotation in the other direction, with its covariance (translation is left as it is)."""
    covariances = {}
    for key, C in step.covariances.items():
        C = C.clone()
        C[:3, :3] = step.R.mT @ C[:3, :3] @ step.R
        covariances[key] = C
    return Estimate(step.R.mT, step.t, covariances)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--views", type=int, default=8, help="of each rendered scene")
    parser.add_argument("--size", default="1024x768", help="of rendered photographs, pixels")
    parser.add_argument("--groups", default="rendered,fountain,temple")
    arguments = parser.parse_args()
    groups = arguments.groups.split(",")
    w, h = (int(v) for v in arguments.size.split("x"))
    print(f"| pairs | number | median error | {NOISE} | {REGIONS} | {STORED} |")
    print("|---|--:|--:|--:|--:|--:|")
    if "rendered" in groups:
        rendered(arguments.views, (w, h))
    if "fountain" in groups:
        photographs("fountain-P11", fountain_shots(), ring=False)
    if "temple" in groups:
        photographs("temple ring", temple_shots(), ring=True)


if __name__ == "__main__":
    main()
