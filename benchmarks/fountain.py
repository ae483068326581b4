"""The main job on EPFL fountain-P11, images 0000 and 0001 at full size: ours, the paper's recipe, and COLMAP.

    SFMKIT_DATA=... python benchmarks/fountain.py [--runs 3] [--markdown]

Prints the account of both presets beside the paper's Table 6, the pose error and the precision of the cloud's matches
against the true cameras, and the times, side by side in one run:

* sfmkit, default and paper preset, reading to triangulating (imports aside);
* the paper's recipe written straight with cv2: the same operators, ``BFMatcher(crossCheck=True)``,
  ``findFundamentalMat(RANSAC, 3 px)``, ``recoverPose``, ``triangulatePoints``. OpenCV's wheels have no SURF, so ours
  stands in, which is faster than theirs and so favours the recipe;
* pycolmap: SIFT extraction, matching and two-view geometry (its database path), with the same number of threads.
"""

from __future__ import annotations

import argparse
import os
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
from sfmkit.cameras import parse_intrinsics, read_truth
from sfmkit.features import detect
from sfmkit.geometry.fundamental import sampson_distance
from sfmkit.images import read_image
from sfmkit.options import DEFAULT, PAPER

PAPER_TABLE_6 = {  # operator: initial, points, loss in per cent
    "surf": (18_763, 14_093, 24.89),
    "orb": (12_980, 10_266, 20.91),
    "fast-brief": (3_284, 2_366, 27.95),
    "multi": (35_027, 27_673, 21.0),
}


def fountain(data: Path) -> tuple[Path, Path, Path, tuple[np.ndarray, np.ndarray]]:
    folder = data / "strecha" / "fountain-P11"
    paths = [folder / "images" / f"{i:04d}.jpg" for i in (0, 1)]
    return *paths, folder / "images" / "K.txt", read_truth(folder / "gt_dense_cameras", *paths)


def true_fundamental(K: np.ndarray, R: np.ndarray, t: np.ndarray) -> torch.Tensor:
    tx = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    Ki = np.linalg.inv(K)
    return torch.from_numpy(Ki.T @ tx @ R @ Ki)


def recipe(path1: Path, path2: Path, K: np.ndarray) -> dict:
    """The paper's recipe with cv2, timed."""
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
    return {"seconds": time.perf_counter() - began, "points": int((X[3] != 0).sum()), "matches": len(a)}


def colmap(path1: Path, path2: Path, K: np.ndarray) -> dict:
    """pycolmap's SIFT, matching and verification on the two images, timed."""
    import pycolmap

    pycolmap.logging.minloglevel = 2
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "database.db"
        began = time.perf_counter()
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "PINHOLE"
        reader.camera_params = f"{K[0, 0]},{K[1, 1]},{K[0, 2] + 0.5},{K[1, 2] + 0.5}"
        pycolmap.extract_features(
            database, path1.parent, image_names=[path1.name, path2.name], camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader, device=pycolmap.Device.cpu,
        )  # fmt: skip
        verification = pycolmap.TwoViewGeometryOptions()
        verification.compute_relative_pose = True
        pycolmap.match_exhaustive(database, verification_options=verification, device=pycolmap.Device.cpu)
        seconds = time.perf_counter() - began
        with pycolmap.Database.open(database) as db:
            _, geometries = db.read_two_view_geometries()
    return {"seconds": seconds, "points": len(geometries[0].inlier_matches)}


def print_account(label: str, result) -> None:
    print(f"\n{label}")
    print(f"  {'operator':<12}{'initial':>9}{'paper':>9}{'points':>9}{'paper':>9}{'loss %':>8}{'paper':>8}")
    for name, (initial, points, loss) in PAPER_TABLE_6.items():
        a = result.account[name]
        print(f"  {name:<12}{a.initial:>9,}{initial:>9,}{a.points:>9,}{points:>9,}{100 * a.loss:>8.2f}{loss:>8.2f}")


def peak_memory(preset: str, data: Path) -> float:
    """GiB of a whole process that runs the command once."""
    path1, path2, K, _ = fountain(data)
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "sfmkit.cli", "reconstruct", str(path1), str(path2), "--intrinsics", str(K),
                   "--preset", preset, "--out", out, "--overwrite", "--quiet"]  # fmt: skip
        code = (
            "import resource,subprocess,sys; r=subprocess.run(sys.argv[1:]);"
            "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(r.returncode)"
        )
        done = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, check=True)
        return int(done.stdout.split()[-1]) / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--no-peers", action="store_true")
    arguments = parser.parse_args()
    data = Path(os.environ["SFMKIT_DATA"])
    path1, path2, k_file, (R, t) = fountain(data)
    camera = parse_intrinsics(str(k_file), read_image(path1).size_wh)
    F_true = true_fundamental(camera.K, R, t)

    jobs = {
        "sfmkit, default preset": lambda: reconstruct(path1, path2, camera, options=DEFAULT, truth=(R, t)),
        "sfmkit, paper preset": lambda: reconstruct(path1, path2, camera, options=PAPER, truth=(R, t)),
    }
    if not arguments.no_peers:
        jobs["pycolmap SIFT"] = lambda: colmap(path1, path2, camera.K)
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
        d = sampson_distance(F_true, corr.x1[cloud.match], corr.x2[cloud.match]).abs()
        print(
            f"  error: rotation {result.errors['rotation_deg']:.4f} deg, translation {result.errors['translation_deg']:.4f} deg;"
            f" within 1 px of the true epipolar line: {float((d < 1).double().mean()):.2%} of the cloud's matches"
        )
        print("  " + ", ".join(f"{k} {v:.2f} s" for k, v in result.timings_s.items()))
    print(f"\n{'job':<26}{'median s':>10}{'min':>8}{'max':>8}{'points':>9}{'x default':>11}")
    base = statistics.median(seconds["sfmkit, default preset"])
    for name, s in seconds.items():
        m = statistics.median(s)
        print(f"{name:<26}{m:>10.2f}{min(s):>8.2f}{max(s):>8.2f}{points[name]:>9,}{m / base:>11.2f}")
    for preset in ("default", "paper"):
        print(f"peak memory, whole command, {preset} preset: {peak_memory(preset, data):.2f} GiB")
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory of this benchmark, all jobs together: {own:.2f} GiB; threads {torch.get_num_threads()}")


if __name__ == "__main__":
    main()
