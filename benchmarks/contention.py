"""Time the main job while other processes are busy, together with COLMAP and a recipe in cv2.

    SFMKIT_DATA=... python benchmarks/contention.py [--busy 0,1,2,4,8] [--runs 3] [--max-size PX]
        [--jobs main,sift,estimate,pycolmap,cv2] [--plot FILE]

Every job runs in its own process, which reports the duration of its work without imports. A busy
process repeats a loop in Python and never sleeps. The jobs alternate within a round, so that the
load of the machine is the same for all of them. Medians and the factors with respect to the idle
machine are printed.

* main: `reconstruct` with the default preset on EPFL fountain-P11, images 0000 and 0001;
* sift: the same with SIFT alone;
* estimate: `estimate_two_view` on the correspondences of the main job;
* pycolmap: SIFT, matching and two-view geometry with its defaults;
* cv2: SURF, ORB and FAST/BRIEF of sfmkit, then BFMatcher, findFundamentalMat, recoverPose and
  triangulatePoints of OpenCV.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

JOBS = ("main", "sift", "estimate", "pycolmap", "cv2")
BUSY = "while True:\n    pass"


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Run busy processes during the block."""
    running = [subprocess.Popen([sys.executable, "-S", "-c", BUSY]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def prepare(job: str, max_size: int | None) -> Callable[[], object]:
    """Import what a job needs and return its work."""
    from fountain import colmap, recipe

    from sfmkit import reconstruct
    from sfmkit.datasets.strecha import strecha
    from sfmkit.estimation import estimate_two_view
    from sfmkit.io.images import read_image
    from sfmkit.options import DEFAULT

    pair = next(strecha(sequences=["fountain-P11"]))
    paths = pair.image1, pair.image2
    options = replace(DEFAULT, detect=replace(DEFAULT.detect, max_size=max_size))
    if job == "main":
        return lambda: reconstruct(*paths, pair.camera1, options=options)
    if job == "sift":
        return lambda: reconstruct(*paths, pair.camera1, ["sift"], options=options)
    if job == "estimate":
        found = reconstruct(*paths, pair.camera1, options=options)
        cameras = found.two_view.camera1, found.two_view.camera2
        return lambda: estimate_two_view(found.correspondences, *cameras, options.estimate)
    if max_size is not None:
        paths, camera = reduced(paths, pair.camera1, max_size)
    else:
        camera = pair.camera1
    for path in paths:  # load both into the file cache, as for the other jobs
        read_image(path)
    if job == "pycolmap":
        return lambda: colmap(*paths, camera)
    return lambda: recipe(*paths, camera.K)


def reduced(paths, camera, max_size: int):
    """Write copies of the photographs with this longest side, and return them with the camera."""
    import PIL.Image

    folder = Path(tempfile.mkdtemp(prefix="contention-"))
    size = None
    for path in paths:
        with PIL.Image.open(path) as image:
            image.thumbnail((max_size, max_size), PIL.Image.Resampling.LANCZOS)
            image.save(folder / path.name, quality=95)
            size = image.size
    return [folder / path.name for path in paths], camera.scaled(size)


def seconds_of(job: str, max_size: int | None) -> float:
    """Run a job in a new process."""
    command = [sys.executable, __file__, "--run", job]
    if max_size is not None:
        command += ["--max-size", str(max_size)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def plot(path: Path, busy_counts: list[int], medians: dict[str, list[float]]) -> None:
    """Draw the factors with respect to the idle machine."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for job, values in medians.items():
        axes.plot(busy_counts, [v / values[0] for v in values], marker="o", label=job)
    axes.set_xlabel("busy processes")
    axes.set_ylabel(f"time, relative to {busy_counts[0]} busy processes")
    axes.set_xticks(busy_counts)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--busy", default="0,1,2,4,8")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--max-size", type=int)
    parser.add_argument("--jobs", default=",".join(JOBS))
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--run", choices=JOBS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.run:
        work = prepare(arguments.run, arguments.max_size)
        began = time.perf_counter()
        work()
        print(time.perf_counter() - began)
        return
    jobs = arguments.jobs.split(",")
    counts = [int(n) for n in arguments.busy.split(",")]
    medians: dict[str, list[float]] = {job: [] for job in jobs}
    for count in counts:
        taken: dict[str, list[float]] = {job: [] for job in jobs}
        with busy(count):
            for _ in range(arguments.runs):
                for job in jobs:
                    taken[job].append(seconds_of(job, arguments.max_size))
        for job in jobs:
            medians[job].append(statistics.median(taken[job]))
    print(f"{os.cpu_count()} cores, {arguments.runs} runs, medians in seconds\n")
    print("| busy processes | " + " | ".join(jobs) + " |")
    print("|--:|" + "--:|" * len(jobs))
    for k, count in enumerate(counts):
        print(f"| {count} | " + " | ".join(f"{medians[job][k]:.2f}" for job in jobs) + " |")
    for k, count in enumerate(counts[1:], start=1):
        factors = " | ".join(f"{medians[job][k] / medians[job][0]:.1f} x" for job in jobs)
        print(f"| {count} over {counts[0]} | {factors} |")
    if arguments.plot:
        plot(arguments.plot, counts, medians)


if __name__ == "__main__":
    main()
