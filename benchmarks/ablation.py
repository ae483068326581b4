"""Measure the time of a sweep: one worker against two, without cache against cached.

    python benchmarks/ablation.py [--data oxford:graf] [--operators surf,orb,fast-brief,sift,akaze]
    [--seeds 3] [--runs 3]

Runs alternate between one and two workers, each in a new folder with a new cache; the speed-up is
the ratio of the medians. Starting the workers (importing torch and OpenCV) is included. The rows of
all runs are compared.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from sfmkit.ablation import AblationTable, ablate
from sfmkit.ablation.cache import Cache


def timed(
    out: Path, cache: Path, workers: int, args: argparse.Namespace
) -> tuple[float, AblationTable]:
    began = time.perf_counter()
    table = ablate(
        args.data,
        args.operators.split(","),
        combos=args.combos,
        seeds=args.seeds,
        out=out,
        cache=cache,
        workers=workers,
    )
    return time.perf_counter() - began, table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="planes:viewpoint")
    parser.add_argument("--operators", default="surf,orb,fast-brief,sift,akaze")
    parser.add_argument("--combos", default="all")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args()
    seconds: dict[str, list[float]] = {
        "1 worker": [],
        "2 workers": [],
        "cached, new folder": [],
        "same folder": [],
    }
    rows = None
    for run in range(args.runs):
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as folder:
                root = Path(folder)
                spent, table = timed(root / "a", root / "cache", workers, args)
                seconds[f"{workers} worker{'s' * (workers > 1)}"].append(spent)
                seconds["cached, new folder"].append(
                    timed(root / "b", root / "cache", workers, args)[0]
                )
                seconds["same folder"].append(timed(root / "b", root / "cache", workers, args)[0])
                size = Cache(root / "cache").stats().nbytes / 1e6
            rows = table.results() if rows is None else rows
            assert rows == table.results(), "the rows differ between runs"
        print(
            f"run {run + 1}: "
            + ", ".join(f"{name} {times[-1]:.1f} s" for name, times in seconds.items()),
            flush=True,
        )
    print(
        f"\n{len(table):,} rows; cache {size:,.0f} MB; "
        f"peak memory {max(table['peak_memory_mb']):,.0f} MB per worker\n"
    )
    print("| | median | fastest |\n|---|---:|---:|")
    for name, times in seconds.items():
        print(f"| {name} | {statistics.median(times):.1f} s | {min(times):.1f} s |")
    one, two = (statistics.median(seconds[name]) for name in ("1 worker", "2 workers"))
    print(f"\ntwo workers are {one / two:.2f} x as fast as one")


if __name__ == "__main__":
    main()
