"""Compare feature operators on a real pair: number and precision of the matches, and time.

    SFMKIT_DATA=... python benchmarks/operators.py [--operators orb,sift,fast+freak] [--pair 0]
    [--runs 3]

Matches are mutual nearest neighbours without further tests; a match is true when both of its points
lie within 1 (or 0.5) pixel of the true epipolar lines. Three tables: the operators; sub-pixel
refinement off and on; a budget of 8,000 keypoints, the strongest or spread evenly.
"""

from __future__ import annotations

import argparse
import statistics
import time

import cv2
import numpy as np

from sfmkit.datasets.strecha import strecha
from sfmkit.features import OPERATORS, detect
from sfmkit.io.images import read_image
from sfmkit.matching.nearest import match
from sfmkit.types import Features

SLOW = ("kaze",)
BUDGET = 8000


def fundamental(pair) -> np.ndarray:
    t = pair.t
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    return np.linalg.inv(pair.camera2.K).T @ cross @ pair.R @ np.linalg.inv(pair.camera1.K)


def line_distance(F_mat: np.ndarray, x1: np.ndarray, x2: np.ndarray) -> np.ndarray:
    """Compute the larger of the two distances to the true lines, pixels."""
    x1, x2 = (np.c_[x.astype(np.float64), np.ones(len(x))] for x in (x1, x2))
    line2, line1 = x1 @ F_mat.T, x2 @ F_mat
    return np.abs((line2 * x2).sum(axis=1)) / np.minimum(
        *(np.hypot(*line[:, :2].T) for line in (line1, line2))
    )


def quality(F_mat: np.ndarray, f1: Features, f2: Features) -> tuple[int, float, float, float]:
    """Count matches, and compute shares.

    Returns:
        Matches, shares within 1 and 0.5 px, share of 64-pixel cells of image 1 with a true match.
    """
    m = match(f1, f2)
    x1 = f1.keypoints[m.index1]
    error = line_distance(F_mat, x1, f2.keypoints[m.index2])
    cells = len(np.unique(x1[error < 1] // 64, axis=0)) / (
        -(-f1.size_wh[0] // 64) * -(-f1.size_wh[1] // 64)
    )
    return len(m), float(np.mean(error < 1)), float(np.mean(error < 0.5)), cells


def strongest(f: Features, n: int) -> Features:
    return f.take(np.argsort(-f.scores, kind="stable")[:n])


def opencv_alone(name: str):
    """Return the same operator with cv2 alone, if it exists."""
    options = {
        k: v for k, v in OPERATORS[name].options.items() if k not in ("subpixel", "oriented")
    }
    if name in ("sift", "orb", "akaze", "kaze", "brisk"):
        create = getattr(cv2, f"{name.upper()}_create", None) or getattr(
            cv2.xfeatures2d, f"{name.upper()}_create"
        )
        return lambda grey: create(**options).detectAndCompute(grey, None)
    brief = cv2.xfeatures2d.BriefDescriptorExtractor_create
    detector = {
        "fast-brief": cv2.FastFeatureDetector_create,
        "gftt-brief": cv2.GFTTDetector_create,
    }.get(name)
    if detector is None:
        return None
    own = {k: v for k, v in options.items() if k not in ("bytes", "use_orientation")}
    return lambda grey: brief().compute(grey, detector(**own).detect(grey))


def seconds(function, argument) -> float:
    start = time.perf_counter()
    function(argument)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--operators", default=",".join(n for n in OPERATORS if n not in SLOW))
    parser.add_argument("--pair", type=int, default=0, help="which of the pairs of fountain-P11")
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args()
    pair = list(strecha(sequences=["fountain-P11"]))[args.pair]
    images = [read_image(pair.image1), read_image(pair.image2)]
    F_mat = fundamental(pair)
    names = args.operators.split(",")
    print(f"{pair}, {images[0].size_wh[0]} x {images[0].size_wh[1]}\n")

    print(
        "| operator | keypoints | matches | < 1 px | < 0.5 px | true | s per image | x cv2 alone |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name in names:
        features = [detect(image, name) for image in images]
        ours, alone = [], []
        counterpart = opencv_alone(name) if name in OPERATORS else None
        for _ in range(args.runs):
            ours.append(seconds(lambda image, name=name: detect(image, name), images[0]))
            if counterpart:
                alone.append(seconds(counterpart, images[0].grey))
        n, one, half, _ = quality(F_mat, *features)
        ratio = f"{statistics.median(a / b for a, b in zip(ours, alone)):.2f}" if alone else ""
        counts = f"{len(features[0]):,}, {len(features[1]):,}"
        print(
            f"| {name} | {counts} | {n:,} | {one:.1%} | {half:.1%} | {round(n * one):,} | "
            f"{statistics.median(ours):.2f} | {ratio} |",
            flush=True,
        )

    print(
        "\n| sub-pixel | off: < 1 px | < 0.5 px | on: < 1 px | < 0.5 px |\n"
        "|---|---:|---:|---:|---:|"
    )
    for name in ("orb", "fast-brief", "agast+brief", "gftt-brief", "harris-brief"):
        off, on = (
            quality(F_mat, *(detect(image, name, subpixel=subpixel) for image in images))
            for subpixel in (False, True)
        )
        print(f"| {name} | {off[1]:.1%} | {off[2]:.1%} | {on[1]:.1%} | {on[2]:.1%} |", flush=True)

    print(
        f"\n| budget {BUDGET:,} | strongest: true | cells covered | evenly: true | cells covered |"
    )
    print("|---|---:|---:|---:|---:|")
    for name in ("orb", "surf", "sift"):
        every = [detect(image, name) for image in images]
        top = quality(F_mat, *(strongest(f, BUDGET) for f in every))
        even = quality(F_mat, *(detect(image, name, budget=BUDGET) for image in images))
        cells = [f"{round(n * one):,} | {covered:.1%}" for n, one, _, covered in (top, even)]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
