"""Compare the time of exact matching: sfmkit, cv2.BFMatcher(crossCheck=True) and faiss.

    SFMKIT_DATA=... python benchmarks/matching.py [--rounds 5] [PHOTO1 PHOTO2]

The descriptors are those of two photographs (EPFL fountain-P11, 0000 and 0001) with the paper's
settings, thinned evenly to the sizes shown. The methods alternate in one process with all cores;
the medians are shown. Processor time depends less on the load of the machine. Memory is the peak
above that before the call (Linux). faiss, if installed, searches once in each direction, and the
mutual pairs are kept.
"""

from __future__ import annotations

import argparse
import ctypes
import dataclasses
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from sfmkit.features import detect
from sfmkit.io.images import read_image
from sfmkit.matching.nearest import match
from sfmkit.types import Features

try:
    import faiss
except ImportError:
    faiss = None

Pairs = tuple[np.ndarray, np.ndarray]

CASES = [  # operator, features in each image, whether only equal signs of the Laplacian match
    ("surf", 19_000, False),
    ("surf", 19_000, True),
    ("orb", 13_000, False),
    ("sift", 19_000, False),
    ("akaze", 13_000, False),
]


def ours(a: Features, b: Features) -> Pairs:
    m = match(a, b)
    return m.index1, m.index2


def opencv(a: Features, b: Features) -> Pairs:
    norm = cv2.NORM_L2 if a.norm == "l2" else cv2.NORM_HAMMING
    found = cv2.BFMatcher(norm, crossCheck=True).match(a.descriptors, b.descriptors)
    return np.array([m.queryIdx for m in found]), np.array([m.trainIdx for m in found])


def faiss_both_ways(a: Features, b: Features) -> Pairs:
    def nearest(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        d = x.shape[1]
        index = faiss.IndexFlatL2(d) if a.norm == "l2" else faiss.IndexBinaryFlat(8 * d)
        index.add(y)
        return index.search(x, 1)[1][:, 0]

    to_b, to_a = nearest(a.descriptors, b.descriptors), nearest(b.descriptors, a.descriptors)
    i = np.flatnonzero(to_a[to_b] == np.arange(len(to_b)))
    return i, to_b[i]


def extra_mib(call: Callable[[Features, Features], object], a: Features, b: Features) -> float:
    """Measure the peak memory of a call above that before; NaN without /proc."""
    status, reset = Path("/proc/self/status"), Path("/proc/self/clear_refs")
    if not status.exists():
        return float("nan")

    def peak() -> float:
        return int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024

    ctypes.CDLL(None).malloc_trim(0)  # so that memory freed by earlier calls counts again
    reset.write_text("5")  # the peak starts again from here
    before = peak()
    call(a, b)
    return peak() - before


def thinned(f: Features, n: int) -> Features:
    return f.take(np.arange(min(n, len(f))) * len(f) // min(n, len(f)))


def compare(name: str, a: Features, b: Features, rounds: int) -> None:
    ways: dict[str, Callable[[Features, Features], Pairs]] = {
        "cv2.BFMatcher": opencv,
        "sfmkit": ours,
    }
    if faiss:
        ways["faiss"] = faiss_both_ways
    pairs = {way: set(zip(*(x.tolist() for x in call(a, b)))) for way, call in ways.items()}
    memory = {way: extra_mib(call, a, b) for way, call in ways.items()}
    wall: dict[str, list[float]] = {way: [] for way in ways}
    processor: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(rounds):
        for way, call in ways.items():
            began, used = time.perf_counter(), time.process_time()
            call(a, b)
            wall[way].append(time.perf_counter() - began)
            processor[way].append(time.process_time() - used)
    width = (
        f"{a.descriptors.shape[1]} floats"
        if a.norm == "l2"
        else f"{8 * a.descriptors.shape[1]} bits"
    )
    reference = "cv2.BFMatcher"
    for way in ways:
        t, c = median(wall[way]), median(processor[way])
        print(
            f"| {name:<18} | {len(a):,} x {len(b):,} x {width:<10} | {way:<13} "
            f"| {len(pairs[way]):>7,} | {len(pairs[way] & pairs[reference]):>7,} "
            f"| {t:>6.2f} | {median(wall[reference]) / t:>7.1f} "
            f"| {c:>6.2f} | {median(processor[reference]) / c:>7.1f} | {memory[way]:>6.0f} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photos", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    photos = args.photos
    if not photos:
        if "SFMKIT_DATA" not in os.environ:
            sys.exit("name two photographs, or set SFMKIT_DATA")
        folder = Path(os.environ["SFMKIT_DATA"]) / "strecha" / "fountain-P11" / "images"
        photos = [folder / "0000.jpg", folder / "0001.jpg"]
    images = [read_image(path) for path in photos]
    print(f"{photos[0].name}, {photos[1].name}; {os.cpu_count()} cores; median of {args.rounds}")
    print(
        f"| {'descriptors':<18} | {'size':<28} | {'method':<13} | matches | as cv2  | wall s "
        "| x cv2   | CPU s  | x cv2   | MiB    |"
    )
    print(
        f"|{'-' * 20}|{'-' * 30}|{'-' * 15}|--------:|--------:|-------:|--------:|-------:"
        "|--------:|-------:|"
    )
    found: dict[str, list[Features]] = {}
    for operator, n, gated in CASES:
        if operator not in found:
            found[operator] = [detect(image, operator, preset="paper") for image in images]
        a, b = (thinned(f, n) for f in found[operator])
        if not gated:
            a, b = (dataclasses.replace(f, laplacian=None) for f in (a, b))
        compare(f"{operator}, by sign" if gated else operator, a, b, args.rounds)


if __name__ == "__main__":
    main()
