"""Robust estimation side by side: five-point hypotheses against kornia, whole estimates against PoseLib, pycolmap and OpenCV.

    SFMKIT_DATA=... python benchmarks/estimation.py [--threads 2] [--runs 5] [--step 4] [--size half]

Prints, as Markdown:

* 1000 five-point samples, all real solutions, scored against 10,000 matches: ours, and ``kornia.geometry.RANSAC`` for as many
  hypotheses (its own stopping switched off);
* on the fused matches of pairs of EPFL fountain-P11 at most `step` views apart: time, score and pose error of every
  estimator on the very same matches, and the AUC of max(rotation, translation) error.

Times are medians of wall-clock time, the estimators taking turns in one process.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import kornia
import numpy as np
import torch

from sfmkit.cameras import read_truth
from sfmkit.estimation import opencv, peers, robust
from sfmkit.estimation._problems import EssentialProblem
from sfmkit.features import detect
from sfmkit.fusion import fuse
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.essential import decompose_essential
from sfmkit.geometry.pose import pose_auc, rotation_error, translation_error
from sfmkit.images import read_image
from sfmkit.matching import match
from sfmkit.types import Correspondences

OPERATORS = ("surf", "orb", "fast-brief")
THRESHOLDS = (0.25, 0.5, 1.0, 2.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--step", type=int, default=4)
    parser.add_argument("--size", choices=("half", "full"), default="half")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    folder = Path(os.environ["SFMKIT_DATA"]) / "strecha" / "fountain-P11"
    K, pairs = fused_pairs(folder, args.step, 0.5 if args.size == "half" else 1.0)
    hypotheses(*pairs["0-1"][0], K, args.runs)
    estimates(pairs, K, args.runs)


def fused_pairs(folder: Path, step: int, scale: float) -> tuple[torch.Tensor, dict]:
    """K and, for each pair, ((x1, x2), correspondences, (R, t))."""
    K = np.loadtxt(folder / "images" / "K.txt")[:3, :3]
    K[:2, :2] *= scale
    K[:2, 2] = (K[:2, 2] + 0.5) * scale - 0.5
    paths = sorted((folder / "images").glob("*.jpg"))
    features = []
    for path in paths:
        rgb = read_image(path).rgb
        small = cv2.resize(rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else rgb
        features.append({o: detect(small, o) for o in OPERATORS})
    pairs = {}
    for i, path1 in enumerate(paths):
        for j in range(i + 1, min(i + step + 1, len(paths))):
            a, b = features[i], features[j]
            corr = fuse({o: (a[o], b[o], match(a[o], b[o])) for o in OPERATORS})
            R, t = (torch.from_numpy(v) for v in read_truth(folder / "gt_dense_cameras", path1, paths[j]))
            pairs[f"{i}-{j}"] = (corr.x1, corr.x2), corr, (R, t / t.norm())
    return torch.from_numpy(K), pairs


def median_ms(functions: dict[str, Callable[[], object]], runs: int) -> dict[str, float]:
    times: dict[str, list[float]] = {name: [] for name in functions}
    for run in range(runs + 1):
        for name, function in functions.items():
            began = time.perf_counter()
            function()
            if run:
                times[name].append(1e3 * (time.perf_counter() - began))
    return {name: statistics.median(t) for name, t in times.items()}


def hypotheses(x1: torch.Tensor, x2: torch.Tensor, K: torch.Tensor, runs: int) -> None:
    x1, x2 = x1[:10_000], x2[:10_000]
    n1, n2 = normalize(x1, K), normalize(x2, K)
    g = torch.Generator().manual_seed(0)
    samples = torch.randint(0, len(x1), (1000, 5), generator=g)

    def ours() -> None:
        problem = EssentialProblem(x1, x2, K, K, 1.0, None)
        problem.scores(problem.solve(samples))

    def theirs() -> None:
        ransac = kornia.geometry.RANSAC(
            "essential", inl_th=1.0 / float(K[0, 0]), batch_size=1000, max_iter=1, confidence=1.0, max_lo_iters=0
        )
        ransac(n1, n2)

    t = median_ms({"sfmkit": ours, "kornia": theirs}, runs)
    print("| 1000 five-point samples x 10,000 matches | ms | of kornia's |\n|---|---|---|")
    for name, ms in t.items():
        print(f"| {name} | {ms:.1f} | {ms / t['kornia']:.2f} |")
    print()


def estimates(pairs: dict, K: torch.Tensor, runs: int) -> None:
    poselib, pycolmap = peers.backend("poselib"), peers.backend("pycolmap")

    def estimators(x1: torch.Tensor, x2: torch.Tensor, corr: Correspondences) -> dict[str, Callable]:
        known = {"ratio": corr.ratio, "groups": corr.operator_id}
        return {
            "sfmkit torch": lambda: robust.estimate_essential(x1, x2, K, K, **known),
            "sfmkit torch, matches only": lambda: robust.estimate_essential(x1, x2, K, K),
            "cv2 USAC_MAGSAC": lambda: opencv.estimate_essential(x1, x2, K, K),
            "cv2 USAC_ACCURATE": lambda: opencv.estimate_essential(x1, x2, K, K, method="usac_accurate"),
            "poselib": lambda: poselib.estimate_essential(x1, x2, K, K),
            "pycolmap": lambda: pycolmap.estimate_essential(x1, x2, K, K),
        }

    (x1, x2), corr, _ = pairs["0-1"]
    t = median_ms(estimators(x1, x2, corr), runs)
    errors: dict[str, list[float]] = {name: [] for name in t}
    for (x1, x2), corr, (R, direction) in pairs.values():
        for name, estimate in estimators(x1, x2, corr).items():
            E = estimate().model
            if E is None:
                errors[name].append(180.0)
                continue
            Rs, ts = decompose_essential(E)
            errors[name].append(float(torch.maximum(rotation_error(Rs, R), translation_error(ts, direction)).min()))
    print(f"{len(corr)} to {len(pairs['0-1'][1])} matches a pair, {len(pairs)} pairs; time on pair 0-1")
    head = " | ".join(f"AUC {d}°" for d in THRESHOLDS)
    print(
        f"| estimator | ms | of poselib's | median error | worst | {head} |\n|---|---|---|---|---|"
        + "---|" * len(THRESHOLDS)
    )
    for name, ms in t.items():
        e = torch.tensor(errors[name], dtype=torch.float64)
        auc = " | ".join(f"{float(a):.3f}" for a in pose_auc(e, THRESHOLDS))
        print(f"| {name} | {ms:.0f} | {ms / t['poselib']:.2f} | {e.median():.3f}° | {e.max():.2f}° | {auc} |")


if __name__ == "__main__":
    main()
