"""Compare estimates of an unknown focal length with PoseLib and COLMAP.

    SFMKIT_DATA=... python benchmarks/focal.py [--step 2] [--size 1024] [--scenes fountain,temple]

Prints one Markdown table per scene: EPFL fountain-P11 (reduced to `size` pixels), a walk through
the rendered courtyard with two focal lengths, and the temple ring, whose cameras fixate one point
and leave the focal length undetermined. Pairs are at most `step` views apart. All methods get the
same matches of SIFT and ORB, the image centre as principal point, and no focal length:

* sfmkit with the true K, with the guess of 1.2 times the longest side kept, and with the estimate;
  the last also with the true principal point;
* PoseLib's `estimate_shared_focal_relative_pose`;
* COLMAP's two-view geometry of a camera without prior focal length, then `calibrate_view_graph`.

Focal lengths and poses are compared with the truth, medians over the pairs. *Undetermined* counts
pairs where sfmkit keeps the prior because the matches know less; the medians include them.
*Error / sigma* is the median of the error over the stated standard deviation: 0.67 for Gaussian
errors of one coordinate.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import poselib
import pycolmap
import torch
from torch import Tensor

from sfmkit.datasets.middlebury import temple_ring
from sfmkit.datasets.rendering.scenes import Scene, look
from sfmkit.datasets.synthetic import named_scene, relative_pose, render
from sfmkit.estimation import adjust, estimate_with_focal
from sfmkit.features import detect
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.io.cameras import centred_camera
from sfmkit.io.images import read_image
from sfmkit.io.truth import read_truth
from sfmkit.matching.fusion import fuse
from sfmkit.matching.nearest import match
from sfmkit.options import EstimateOptions
from sfmkit.types import Camera, Correspondences, IntrinsicsSigma

OPERATORS = ("sift", "orb")
BUDGET = 6000
GUESS = 1.2  # times the longest side
FIXED = EstimateOptions(focal="fixed")


@dataclass(frozen=True)
class MatchedPair:
    corr: Correspondences
    camera: Camera
    R: Tensor
    t: Tensor


@dataclass(frozen=True)
class Estimate:
    """The results of one method for one pair: errors, standard deviations, whether determined."""

    focal: float
    rotation: float
    translation: float
    sigma: tuple[float, float, float] | None = None
    determined: bool = True


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--step", type=int, default=2, help="most views between two photographs")
    parser.add_argument("--size", type=int, default=1024, help="longest side, pixels")
    parser.add_argument("--scenes", default="fountain,courtyard,courtyard-long,temple")
    args = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    pycolmap.logging.minloglevel = 2
    warnings.simplefilter("ignore")
    for name in args.scenes.split(","):
        began = time.perf_counter()
        pairs = SCENES[name](args.step, args.size)
        rows = {m: [f(p) for p in pairs] for m, f in METHODS.items()}
        seconds = time.perf_counter() - began
        print(f"### {name}: {len(pairs)} pairs, {seconds:.0f} s\n")
        print_table(rows, name)


def print_table(rows: dict[str, list[Estimate]], name: str) -> None:
    print(
        "| method | focal length | within 3 % | rotation | translation | undetermined "
        "| error / sigma: focal, rotation, translation |\n|---|--:|--:|--:|--:|--:|--:|"
    )
    for method, found in rows.items():
        errors = np.abs([(e.focal, e.rotation, e.translation) for e in found])
        focal, rotation, translation = np.median(errors, 0)
        ratio = "–"
        if all(e.sigma is not None for e in found) and method != "sfmkit, true K":
            sigma = np.array([e.sigma for e in found])
            ratio = ", ".join(f"{v:.2f}" for v in np.median(errors / sigma, 0))
        within = int((errors[:, 0] < 0.03).sum())
        undetermined = sum(not e.determined for e in found)
        print(
            f"| {method} | {focal:.1%} | {within} of {len(found)} | {rotation:.3f}° "
            f"| {translation:.3f}° | {undetermined} | {ratio} |"
        )
    print(flush=True)


def matched(
    images: list[np.ndarray], cameras: list[Camera], step: int, truth: Callable
) -> list[MatchedPair]:
    features = [{o: detect(image, o, budget=BUDGET) for o in OPERATORS} for image in images]
    pairs = []
    for i in range(len(features)):
        for j in range(i + 1, min(i + step + 1, len(features))):
            a, b = features[i], features[j]
            corr = fuse({o: (a[o], b[o], match(a[o], b[o])) for o in OPERATORS})
            R, t = (torch.from_numpy(v) for v in truth(i, j))
            pairs.append(MatchedPair(corr, cameras[i], R, t / t.norm()))
    return pairs


def fountain(step: int, size: int) -> list[MatchedPair]:
    folder = Path(os.environ["SFMKIT_DATA"]) / "strecha" / "fountain-P11"
    paths = sorted((folder / "images").glob("*.jpg"))
    full = read_image(paths[0])
    s = size / max(full.size_wh)
    reduced = tuple(round(s * v) for v in full.size_wh)
    camera = Camera(np.loadtxt(folder / "images" / "K.txt")[:3, :3], full.size_wh).scaled(reduced)
    images = [cv2.resize(read_image(p).rgb, reduced, interpolation=cv2.INTER_AREA) for p in paths]
    truth = folder / "gt_dense_cameras"
    return matched(
        images, [camera] * len(paths), step, lambda i, j: read_truth(truth, paths[i], paths[j])
    )


def courtyard(focal: float) -> Callable[[int, int], list[MatchedPair]]:
    """Six views on an arc in front of the wall, not all directed at one place."""

    def pairs(step: int, size: int) -> list[MatchedPair]:
        surfaces = named_scene("courtyard").surfaces
        poses = [
            look(
                (2.0 * a, -1.7 + 0.4 * np.sin(3 * a), 1.0 - abs(a) + 0.5 * np.cos(7 * a)),
                (1.2 * np.sin(9 * a), -1.4 + 0.4 * np.cos(5 * a), 7.0),
                15 * np.sin(5 * a),
            )
            for a in np.linspace(-1, 1, 6)
        ]
        images, camera = [], None
        for i in range(0, len(poses), 2):
            p = render(
                Scene("walk", surfaces, poses[i], poses[i + 1], focal=focal),
                size_wh=(size, size * 3 // 4),
                blur=0.8,
                noise=2.0,
                jpeg_quality=90,
            )
            images += [p.image1, p.image2]
            camera = p.camera1
        assert camera is not None
        return matched(
            images, [camera] * 6, min(step, 2), lambda i, j: relative_pose(poses[i], poses[j])
        )

    return pairs


def temple(step: int, size: int) -> list[MatchedPair]:
    views = temple_ring()

    def truth(i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        R = views[j].R @ views[i].R.T
        return R, views[j].t - R @ views[i].t

    images = [read_image(v.path).rgb for v in views]
    found = matched(images, [v.camera for v in views], 1, truth)
    return [p for p in found if float(rotation_error(p.R, torch.eye(3).double())) > 5]


SCENES = {
    "fountain": fountain,
    "courtyard": courtyard(0.92),
    "courtyard-long": courtyard(1.6),
    "temple": temple,
}


def prior(p: MatchedPair) -> Camera:
    size = p.camera.size_wh
    return centred_camera(GUESS * max(size), size, "guessed")


def sfmkit(p: MatchedPair, camera1: Camera, camera2: Camera, options: EstimateOptions) -> Estimate:
    view = estimate_with_focal(p.corr, camera1, camera2, options)
    adjustment = adjust(p.corr, view)
    view = view if adjustment is None else adjustment.view
    camera = view.camera1
    focal = camera.K[0, 0] / p.camera.K[0, 0] - 1
    determined = camera.source.startswith("estimated")
    if view.R is None or view.t is None:
        return Estimate(focal, 180.0, 180.0, (0.3, 180.0, 180.0), determined)
    sigma = (camera.uncertainty.focal, *(view.sigma_deg or (np.inf, np.inf)))
    return Estimate(focal, *pose_errors(p, view.R, view.t), sigma, determined)


def with_point(p: MatchedPair) -> Estimate:
    K = prior(p).K.copy()
    K[:2, 2] = p.camera.K[:2, 2]
    camera = Camera(K, p.camera.size_wh, source="guessed", sigma=IntrinsicsSigma(0.3, 0.5, 0.1))
    return sfmkit(p, camera, camera, EstimateOptions())


def by_poselib(p: MatchedPair) -> Estimate:
    centre = prior(p).K[:2, 2]
    x1, x2 = p.corr.x1.numpy(), p.corr.x2.numpy()
    ransac = {"max_epipolar_error": 1.0, "success_prob": 0.9999, "max_iterations": 10_000}
    pair, _ = poselib.estimate_shared_focal_relative_pose(x1, x2, centre, ransac, {})
    R, t = torch.from_numpy(np.array(pair.pose.R)), torch.from_numpy(np.array(pair.pose.t))
    focal = pair.camera1.params[0] / p.camera.K[0, 0] - 1
    return Estimate(focal, *pose_errors(p, R, t / t.norm()))


def by_colmap(p: MatchedPair) -> Estimate:
    (w, h), focal = p.camera.size_wh, prior(p).K[0, 0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "database.db"
        with pycolmap.Database.open(path) as db:
            camera = pycolmap.Camera(
                model="SIMPLE_PINHOLE", width=w, height=h, params=[focal, w / 2, h / 2]
            )
            camera.has_prior_focal_length = False
            camera.camera_id = db.write_camera(camera)
            pixels = [x.numpy() + 0.5 for x in (p.corr.x1, p.corr.x2)]
            ids = []
            for k, x in enumerate(pixels):
                image = pycolmap.Image(name=str(k), camera_id=camera.camera_id)
                ids.append(db.write_image(image))
                db.write_keypoints(ids[-1], x.astype(np.float32))
            rows = np.repeat(np.arange(len(p.corr), dtype=np.uint32)[:, None], 2, 1)
            db.write_matches(*ids, rows)
            options = pycolmap.TwoViewGeometryOptions()
            options.ransac.max_error = 1.0
            options.ransac.confidence = 0.9999
            geometry = pycolmap.estimate_two_view_geometry(
                camera, pixels[0], camera, pixels[1], rows, options
            )
            db.write_two_view_geometry(*ids, geometry)
        pycolmap.calibrate_view_graph(path)
        with pycolmap.Database.open(path) as db:
            camera, geometry = db.read_all_cameras()[0], db.read_two_view_geometry(*ids)
    error = camera.params[0] / p.camera.K[0, 0] - 1
    pose = geometry.cam2_from_cam1
    if pose is None or not np.linalg.norm(pose.translation):
        return Estimate(error, 180.0, 180.0)
    R, t = (torch.from_numpy(np.array(a)) for a in (pose.rotation.matrix(), pose.translation))
    return Estimate(error, *pose_errors(p, R, t / t.norm()))


def pose_errors(p: MatchedPair, R: Tensor, t: Tensor) -> tuple[float, float]:
    return float(rotation_error(R, p.R)), float(translation_error(t, p.t))


METHODS: dict[str, Callable[[MatchedPair], Estimate]] = {
    "sfmkit, true K": lambda p: sfmkit(p, p.camera, p.camera, FIXED),
    "sfmkit, guess kept": lambda p: sfmkit(p, prior(p), prior(p), FIXED),
    "sfmkit": lambda p: sfmkit(p, prior(p), prior(p), EstimateOptions()),
    "sfmkit, true principal point": with_point,
    "PoseLib": by_poselib,
    "COLMAP": by_colmap,
}


if __name__ == "__main__":
    main()
