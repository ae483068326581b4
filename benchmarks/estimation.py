"""Compare robust estimation with kornia, PoseLib, pycolmap and OpenCV.

    SFMKIT_DATA=... python benchmarks/estimation.py [--threads 2] [--runs 5] [--step 4] [--seeds 3]
    [--scenes fountain,courtyard]

Prints, as Markdown:

* 1000 five-point samples, all real solutions, scored against 10,000 matches: sfmkit, and
  ``kornia.geometry.RANSAC`` for the same number of hypotheses (its stopping criterion disabled);
* on the fused matches of pairs of photographs at most `step` views apart, of EPFL fountain-P11 at
  half size and of a walk through the rendered courtyard: time and pose error of every estimator on
  the same matches, and the AUC of max(rotation, translation) error. sfmkit is shown twice: with the
  matches only, like the others, and with the distance ratio and operator of each match, which the
  others cannot use.

Times are wall-clock times of alternating runs in one process; the median over pairs and the sum are
shown.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import kornia
import numpy as np
import torch
from torch import Tensor

from sfmkit.datasets.rendering.scenes import Scene, look
from sfmkit.datasets.synthetic import named_scene, relative_pose, render
from sfmkit.estimation import RobustModel, opencv, peers, robust
from sfmkit.estimation._problems import EssentialProblem
from sfmkit.features import detect
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.essential import decompose_essential
from sfmkit.geometry.fundamental import fundamental_from_pose, signed_sampson_distance
from sfmkit.geometry.pose import pose_auc, rotation_error, translation_error
from sfmkit.io.images import read_image
from sfmkit.io.truth import read_truth
from sfmkit.matching.fusion import fuse
from sfmkit.matching.nearest import match
from sfmkit.types import Correspondences

OPERATORS = ("surf", "orb", "fast-brief")
THRESHOLDS = (0.25, 0.5, 1.0, 2.0)
SIZE_WH = (1024, 768)  # of the rendered photographs
VIEWS = 10


@dataclass(frozen=True)
class MatchedPair:
    x1: Tensor
    x2: Tensor
    K: Tensor
    corr: Correspondences
    R: Tensor
    t: Tensor


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=5, help="of the five-point samples")
    parser.add_argument("--step", type=int, default=4, help="most views between two photographs")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scenes", default="fountain,courtyard")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    for k, name in enumerate(args.scenes.split(",")):
        pairs = SCENES[name](args.step)
        if k == 0:
            hypotheses(pairs[0], args.runs)
        print(f"### {name}\n")
        estimates(pairs, args.seeds)


def fountain(step: int) -> list[MatchedPair]:
    folder = Path(os.environ["SFMKIT_DATA"]) / "strecha" / "fountain-P11"
    K = np.loadtxt(folder / "images" / "K.txt")[:3, :3]
    K[:2] /= 2
    K[:2, 2] -= 0.25  # pixel centres are at integers
    paths = sorted((folder / "images").glob("*.jpg"))
    images = (
        cv2.resize(read_image(p).rgb, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for p in paths
    )
    return matched(
        images, K, step, lambda i, j: read_truth(folder / "gt_dense_cameras", paths[i], paths[j])
    )


def courtyard(step: int) -> list[MatchedPair]:
    """Render views along an arc of 5 m in front of the wall, directed at about the same place."""
    surfaces = named_scene("courtyard").surfaces
    s = np.linspace(-1, 1, VIEWS)
    poses = [
        look(
            (2.5 * a, -1.7 + 0.3 * np.sin(3 * a), 1.0 - abs(a) + 0.2 * np.cos(7 * a)),
            (0.4 * a, -1.4, 7.0),
            4 * np.sin(5 * a),
        )
        for a in s
    ]
    images, K = [], None
    for i in range(0, VIEWS, 2):
        p = render(
            Scene("walk", surfaces, poses[i], poses[i + 1]),
            size_wh=SIZE_WH,
            blur=0.8,
            noise=2.0,
            jpeg_quality=90,
        )
        images += [p.image1, p.image2]
        K = p.camera1.K
    return matched(images, K, step, lambda i, j: relative_pose(poses[i], poses[j]))


SCENES = {"fountain": fountain, "courtyard": courtyard}


def matched(
    images: Iterable[np.ndarray], K: np.ndarray, step: int, truth: Callable
) -> list[MatchedPair]:
    features = [{o: detect(image, o) for o in OPERATORS} for image in images]
    pairs = []
    for i in range(len(features)):
        for j in range(i + 1, min(i + step + 1, len(features))):
            a, b = features[i], features[j]
            corr = fuse({o: (a[o], b[o], match(a[o], b[o])) for o in OPERATORS})
            R, t = (torch.from_numpy(v) for v in truth(i, j))
            pairs.append(MatchedPair(corr.x1, corr.x2, torch.tensor(K), corr, R, t / t.norm()))
    return pairs


def median_ms(functions: dict[str, Callable[[], object]], runs: int) -> dict[str, float]:
    times: dict[str, list[float]] = {name: [] for name in functions}
    for run in range(runs + 1):
        for name, function in functions.items():
            began = time.perf_counter()
            function()
            if run:
                times[name].append(1e3 * (time.perf_counter() - began))
    return {name: statistics.median(t) for name, t in times.items()}


def hypotheses(pair: MatchedPair, runs: int) -> None:
    x1, x2, K = pair.x1[:10_000], pair.x2[:10_000], pair.K
    n1, n2 = normalize(x1, K), normalize(x2, K)
    g = torch.Generator().manual_seed(0)
    samples = torch.randint(0, len(x1), (1000, 5), generator=g)

    def ours() -> None:
        problem = EssentialProblem(x1, x2, K, K, 1.0, None)
        problem.scores(problem.solve(samples))

    def theirs() -> None:
        ransac = kornia.geometry.RANSAC(
            "essential",
            inl_th=1.0 / float(K[0, 0]),
            batch_size=1000,
            max_iter=1,
            confidence=1.0,
            max_lo_iters=0,
        )
        ransac(n1, n2)

    t = median_ms({"sfmkit": ours, "kornia": theirs}, runs)
    print("| 1000 five-point samples x 10,000 matches | ms | of kornia's |\n|---|--:|--:|")
    for name, ms in t.items():
        print(f"| {name} | {ms:.1f} | {ms / t['kornia']:.2f} |")
    print()


def estimators(p: MatchedPair, seed: int) -> dict[str, Callable[[], RobustModel]]:
    known = {"ratio": p.corr.ratio, "groups": p.corr.operator_id}
    given = (p.x1, p.x2, p.K, p.K)
    return {
        "sfmkit with ratios and operators": lambda: robust.estimate(*given, seed=seed, **known),
        "sfmkit": lambda: robust.estimate(*given, seed=seed),
        "PoseLib": lambda: peers.estimate_poselib(*given, seed=seed),
        "PoseLib, 100,000 samples": lambda: peers.estimate_poselib(
            *given, seed=seed, max_iterations=100_000
        ),
        "pycolmap": lambda: peers.estimate_pycolmap(*given, seed=seed),
        "pycolmap, 100,000 samples": lambda: peers.estimate_pycolmap(
            *given, seed=seed, max_iterations=100_000
        ),
        "cv2 USAC_MAGSAC": lambda: opencv.estimate(*given, seed=seed),
        "cv2 USAC_ACCURATE": lambda: opencv.estimate(*given, seed=seed, method="usac_accurate"),
    }


def estimates(pairs: list[MatchedPair], seeds: int) -> None:
    errors: dict[str, list[float]] = {}
    times: dict[str, list[float]] = {}
    for seed in range(seeds):
        for p in pairs:
            for name, estimate in estimators(p, seed).items():
                began = time.perf_counter()
                E = estimate().model
                times.setdefault(name, []).append(1e3 * (time.perf_counter() - began))
                errors.setdefault(name, []).append(pose_error(E, p))
    counts = [len(p.corr) for p in pairs]
    right = [
        float(
            (
                signed_sampson_distance(fundamental_from_pose(p.R, p.t, p.K, p.K), p.x1, p.x2).abs()
                < 1
            )
            .double()
            .mean()
        )
        for p in pairs
    ]
    print(
        f"{len(pairs)} pairs of {min(counts):,} to {max(counts):,} matches, of which "
        f"{100 * min(right):.0f} to {100 * max(right):.0f} % lie within 1 px of "
        f"the true epipolar line; {seeds} seeds\n"
    )
    head = " | ".join(f"AUC {d}°" for d in THRESHOLDS)
    print(f"| estimator | ms per pair | total, of PoseLib's | median error | over 2° | {head} |")
    print("|---|--:|--:|--:|--:|" + "--:|" * len(THRESHOLDS))
    for name, ms in times.items():
        e = torch.tensor(errors[name], dtype=torch.float64)
        auc = " | ".join(f"{float(a):.3f}" for a in pose_auc(e, THRESHOLDS))
        share = sum(ms) / sum(times["PoseLib"])
        print(
            f"| {name} | {statistics.median(ms):.0f} | {share:.2f} | {e.median():.3f}° "
            f"| {int((e > 2).sum())} | {auc} |"
        )
    print()


def pose_error(E: Tensor | None, p: MatchedPair) -> float:
    """Compute max(rotation, translation) error of the best of four poses; 180 without a model."""
    if E is None:
        return 180.0
    Rs, ts = decompose_essential(E)
    return float(torch.maximum(rotation_error(Rs, p.R), translation_error(ts, p.t)).min())


if __name__ == "__main__":
    main()
