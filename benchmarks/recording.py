"""Measure the size of a recording of a pair, and the time to write it and read it.

    python benchmarks/recording.py [IMAGE1 IMAGE2 INTRINSICS]

Without arguments it uses the bundled pair. Times are medians of five runs.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from sfmkit import reconstruct
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.io.images import read_image
from sfmkit.io.intrinsics import parse_intrinsics
from sfmkit.recording.inspection import describe_point
from sfmkit.recording.log import save_recording


def median_s(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds)


def main() -> None:
    first, second, intrinsics = (str(a) for a in (sys.argv[1:] or demo_pair()))
    image = read_image(first)
    result = reconstruct(image, second, parse_intrinsics(intrinsics, image.size_wh))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        write = median_s(lambda: save_recording(path, result))
        size = path.stat().st_size / 1e6
        read = median_s(lambda: describe_point(path, 0))
    account = result.account["multi"]
    print("| keypoints | correspondences | points | size, MB | write, s | inspect a point, s |")
    print("|--:|--:|--:|--:|--:|--:|")
    print(
        f"| {sum(account.keypoints):,} | {account.initial:,} | {account.points:,} | {size:.1f} "
        f"| {write:.2f} | {read:.2f} |"
    )


if __name__ == "__main__":
    main()
