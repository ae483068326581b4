"""Compare SURF in torch with OpenCV: agreement, quality of the matches, and speed against SIFT.

    SFMKIT_DATA=... python benchmarks/surf.py [--runs 7]

OpenCV's wheels do not contain SURF, so the output is compared with stored results of a build that
does, for four photographs and two thresholds. Times are multiples of
``cv2.SIFT_create().detectAndCompute`` on the same image, alternating in one process; SURF of that
build took 3.9 to 4.0 times as long as SIFT.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree

from sfmkit.datasets.strecha import strecha
from sfmkit.features.surf import surf
from sfmkit.features.surf_detector import fast_hessian
from sfmkit.matching.nearest import match

REFERENCES = {
    "boat_img1": "oxford/boat/img1.png",
    "fountain_0000_half": "strecha/fountain-P11/images/0000.jpg",
    "graf_img1": "oxford/graf/img1.png",
    "leuven_img1": "oxford/leuven/img1.png",
}
THRESHOLD = 30.0


def half(image: np.ndarray) -> np.ndarray:
    return cv2.resize(
        image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA
    )


def partners(
    xy: np.ndarray, size: np.ndarray, others: np.ndarray, other_sizes: np.ndarray
) -> np.ndarray:
    """Find the nearest other keypoint within 1 px and 10 % of size, or -1."""
    distance, index = cKDTree(others).query(xy, k=8, distance_upper_bound=1.0)
    sizes = np.append(other_sizes, np.inf)[index]
    fits = np.isfinite(distance) & (np.abs(sizes - size[:, None]) <= 0.1 * size[:, None])
    first = fits.argmax(1)
    return np.where(fits.any(1), index[np.arange(len(xy)), first], -1)


def agreement(data: Path) -> None:
    print(
        "agreement with OpenCV's SURF (found: within 1 px and 10 % of size; angle and cosine over "
        "those pairs)\n"
    )
    print(
        f"| {'image':<19} | {'h':>3} | {'OpenCV':>6} | {'ours':>6} | {'found %':>7} "
        f"| {'back %':>6} | {'angle deg':>9} | {'cosine':>6} | {'worst 10 %':>10} | {'sign %':>6} |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for name, path in REFERENCES.items():
        image = cv2.imread(str(data / path), cv2.IMREAD_GRAYSCALE)
        image = half(image) if name.endswith("half") else image
        for threshold in (30, 400):
            with np.load(data / "surf_reference" / f"{name}_h{threshold}.npz") as file:
                reference = dict(file)
            ours = surf(image, hessian_threshold=threshold)
            there = partners(reference["keypoints"], reference["size"], ours.keypoints, ours.scales)
            back = partners(ours.keypoints, ours.scales, reference["keypoints"], reference["size"])
            pair, there = there >= 0, there[there >= 0]
            turn = np.degrees(ours.angles[there]) - reference["angle_deg"][pair]
            cosine = (
                ours.descriptors[there] * reference["descriptors"][pair].astype(np.float32)
            ).sum(1)
            sign = ours.laplacian[there] == reference["laplacian_sign"][pair]
            print(
                f"| {name:<19} | {threshold:>3} | {len(pair):>6} | {len(ours):>6} "
                f"| {100 * pair.mean():>7.2f} | {100 * (back >= 0).mean():>6.2f} "
                f"| {np.median(np.abs((turn + 180) % 360 - 180)):>9.3f} "
                f"| {np.median(cosine):>6.4f} | {np.quantile(cosine, 0.1):>10.4f} "
                f"| {100 * sign.mean():>6.2f} |"
            )


def matches(data: Path) -> None:
    print(
        "\nmutual nearest neighbours of fountain-P11 0000 and 0001 within 1 px of the true "
        "epipolar line\n"
    )
    print(
        "| image       | keypoints       | matches | within 1 px % "
        "| without the sign of the Laplacian % |"
    )
    print("|---|--:|--:|--:|--:|")
    pair = next(p for p in strecha(data, ["fountain-P11"]))
    for size_wh in (tuple(s // 2 for s in pair.camera1.size_wh), pair.camera1.size_wh):
        images = [
            cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (pair.image1, pair.image2)
        ]
        if size_wh != pair.camera1.size_wh:
            images = [half(image) for image in images]
        one, two = (surf(image, hessian_threshold=THRESHOLD) for image in images)
        K1, K2 = (camera.scaled(size_wh).K for camera in (pair.camera1, pair.camera2))
        F = np.linalg.inv(K2).T @ np.cross(np.eye(3), pair.t) @ pair.R @ np.linalg.inv(K1)

        def share(f1, f2, F=F) -> tuple[int, float]:
            found = match(f1, f2)
            x1, x2 = f1.keypoints[found.index1], f2.keypoints[found.index2]
            line = np.c_[x1, np.ones(len(x1))] @ F.T
            distance = np.abs((line * np.c_[x2, np.ones(len(x2))]).sum(1)) / np.hypot(
                line[:, 0], line[:, 1]
            )
            return len(found), float((distance < 1).mean())

        count, gated = share(one, two)
        unsigned = share(replace(one, laplacian=None), replace(two, laplacian=None))[1]
        print(
            f"| {size_wh[0]} x {size_wh[1]} | {len(one):>6} {len(two):>6} | {count:>7} "
            f"| {100 * gated:>13.1f} | {100 * unsigned:>35.1f} |"
        )


def speed(data: Path, runs: int) -> None:
    print(
        f"\nspeed, {torch.get_num_threads()} threads, median (minimum) of {runs} alternating runs, "
        f"threshold {THRESHOLD:g};"
    )
    print("processor seconds are the sum over the cores and vary less on a busy machine\n")
    print(
        "| image       | keypoints | SIFT s        | SURF s        | of it detecting | SURF / SIFT "
        "| in processor seconds |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|")
    full = cv2.imread(str(data / REFERENCES["fountain_0000_half"]), cv2.IMREAD_GRAYSCALE)
    sift = cv2.SIFT_create()
    for image in (half(full), full):
        jobs = {
            "sift": lambda image=image: sift.detectAndCompute(image, None),
            "surf": lambda image=image: surf(image, hessian_threshold=THRESHOLD),
            "detect": lambda image=image: fast_hessian(
                torch.from_numpy(cv2.integral(image)), THRESHOLD, 4, 3
            ),
        }
        clock: dict[str, list[float]] = {name: [] for name in jobs}
        processor: dict[str, list[float]] = {name: [] for name in jobs}
        found = len(jobs["surf"]())
        for _ in range(runs):
            for name, job in jobs.items():
                wall, cpu = time.perf_counter(), time.process_time()
                job()
                clock[name].append(time.perf_counter() - wall)
                processor[name].append(time.process_time() - cpu)
        middle = {name: statistics.median(times) for name, times in clock.items()}
        cpu = {name: statistics.median(times) for name, times in processor.items()}
        print(
            f"| {image.shape[1]} x {image.shape[0]} | {found:>9} "
            + "".join(
                f"| {middle[n]:.3f} ({min(clock[n]):.3f}) " for n in ("sift", "surf", "detect")
            )
            + f"  | {middle['surf'] / middle['sift']:>11.2f} | {cpu['surf'] / cpu['sift']:>20.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=7)
    arguments = parser.parse_args()
    data = Path(os.environ["SFMKIT_DATA"])
    agreement(data)
    matches(data)
    speed(data, arguments.runs)


if __name__ == "__main__":
    main()
