"""Compare sfmkit, the paper's recipe and COLMAP on EPFL fountain-P11, images 0000 and 0001.

    SFMKIT_DATA=... python benchmarks/fountain.py [--runs 3] [--markdown]

Prints the statistics of every preset next to the paper's Table 6, the pose error and the precision
of the cloud's matches against the true cameras, and the times, all from one run:

* sfmkit, every preset, from reading to triangulating (without imports);
* the paper's recipe written with cv2: the same operators, ``BFMatcher(crossCheck=True)``,
  ``findFundamentalMat(RANSAC, 3 px)``, ``recoverPose``, ``triangulatePoints``. OpenCV's wheels do
  not contain SURF, so the faster one of sfmkit is used, which favours the recipe;
* pycolmap: SIFT extraction, matching and two-view geometry (its database path), with the same
  number of threads.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from sfmkit import reconstruct
from sfmkit.datasets.pair import Pair
from sfmkit.datasets.strecha import strecha
from sfmkit.evaluation.colmap_peer import two_view_inliers
from sfmkit.evaluation.fountain import right_matches, true_fundamental
from sfmkit.evaluation.paper import FOUNTAIN
from sfmkit.features import detect
from sfmkit.io.images import read_image
from sfmkit.options import PRESETS
from sfmkit.types import Camera


def recipe(path1: Path, path2: Path, K: np.ndarray) -> dict:
    """Time the paper's recipe with cv2."""
    began = time.perf_counter()
    images = [read_image(p) for p in (path1, path2)]
    x1, x2 = [], []
    for name in ("surf", "orb", "fast-brief"):
        f1, f2 = (detect(image, name, preset="paper") for image in images)
        norm = cv2.NORM_L2 if f1.norm == "l2" else cv2.NORM_HAMMING
        found = cv2.BFMatcher(norm, crossCheck=True).match(f1.descriptors, f2.descriptors)
        x1.append(f1.keypoints[[m.queryIdx for m in found]])
        x2.append(f2.keypoints[[m.trainIdx for m in found]])
    a, b = np.concatenate(x1).astype(np.float64), np.concatenate(x2).astype(np.float64)
    cv2.setRNGSeed(0)
    F, mask = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, 3.0, 0.99)
    inlier = mask.ravel().astype(bool)
    _, R, t, front = cv2.recoverPose(K.T @ F @ K, a[inlier], b[inlier], K)
    P2 = K @ np.hstack([R, t])
    X = cv2.triangulatePoints(K @ np.eye(3, 4), P2, a[inlier].T, b[inlier].T)
    return {
        "seconds": time.perf_counter() - began,
        "points": int((X[3] != 0).sum()),
        "matches": len(a),
    }


def colmap(path1: Path, path2: Path, camera: Camera) -> dict:
    """Time SIFT, matching and verification of pycolmap on the two images."""
    points, seconds = two_view_inliers(path1, path2, camera)
    return {"seconds": seconds, "points": points}


def print_account(label: str, result) -> None:
    print(f"\n{label}")
    print(
        f"  {'operator':<12}{'initial':>9}{'paper':>9}{'points':>9}{'paper':>9}"
        f"{'loss %':>8}{'paper':>8}"
    )
    for name, (initial, points, loss) in FOUNTAIN.items():
        a = result.account[name]
        print(
            f"  {name:<12}{a.initial:>9,}{initial:>9,}{a.points:>9,}{points:>9,}"
            f"{100 * a.loss:>8.2f}{loss:>8.2f}"
        )


def peak_memory(preset: str, pair: Pair) -> float:
    """Measure the peak memory (GiB) of a process that runs the command once."""
    K = pair.image1.parent / "K.txt"
    with tempfile.TemporaryDirectory() as out:
        command = [
            sys.executable,
            "-m",
            "sfmkit.cli",
            "reconstruct",
            str(pair.image1),
            str(pair.image2),
            "--intrinsics",
            str(K),
            "--preset",
            preset,
            "--out",
            out,
            "--overwrite",
            "--quiet",
        ]
        code = (
            "import resource,subprocess,sys; r=subprocess.run(sys.argv[1:]);"
            "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(r.returncode)"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, *command], capture_output=True, text=True, check=True
        )
        return int(done.stdout.split()[-1]) / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--no-peers", action="store_true")
    arguments = parser.parse_args()
    pair = next(strecha(sequences=["fountain-P11"]))
    path1, path2, camera, truth = pair.image1, pair.image2, pair.camera1, (pair.R, pair.t)
    F_true = true_fundamental(pair)

    jobs = {
        f"sfmkit, {name} preset": lambda options=options: reconstruct(
            path1, path2, camera, options=options, truth=truth
        )
        for name, options in PRESETS.items()
    }
    if not arguments.no_peers:
        jobs["pycolmap SIFT"] = lambda: colmap(path1, path2, camera)
        jobs["the recipe in cv2"] = lambda: recipe(path1, path2, camera.K)
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    points: dict[str, int] = {}
    results = {}
    for _ in range(arguments.runs):
        for name, job in jobs.items():
            outcome = job()
            if isinstance(outcome, dict):
                seconds[name].append(outcome["seconds"])
                points[name] = outcome["points"]
            else:
                seconds[name].append(outcome.timings_s["total"])
                points[name] = len(outcome.cloud)
                results[name] = outcome
    for name, result in results.items():
        print_account(name, result)
        corr, cloud = result.correspondences, result.cloud
        right = right_matches(F_true, corr)[cloud.match]
        print(
            f"  error: rotation {result.errors['rotation_deg']:.4f} deg, "
            f"translation {result.errors['translation_deg']:.4f} deg; within 1 px of the true "
            f"epipolar line: {float(right.double().mean()):.2%} of the cloud's matches"
        )
        print("  " + ", ".join(f"{k} {v:.2f} s" for k, v in result.timings_s.items()))
    print(f"\n{'job':<26}{'median s':>10}{'min':>8}{'max':>8}{'points':>9}{'x default':>11}")
    base = statistics.median(seconds["sfmkit, default preset"])
    for name, s in seconds.items():
        m = statistics.median(s)
        print(
            f"{name:<26}{m:>10.2f}{min(s):>8.2f}{max(s):>8.2f}{points[name]:>9,}{m / base:>11.2f}"
        )
    for preset in PRESETS:
        print(f"peak memory, whole command, {preset} preset: {peak_memory(preset, pair):.2f} GiB")
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"peak memory of this benchmark, all jobs together: {own:.2f} GiB; "
        f"threads {torch.get_num_threads()}"
    )


if __name__ == "__main__":
    main()
