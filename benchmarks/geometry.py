"""Two-view geometry side by side: triangulation and cheirality against OpenCV and kornia, and the
cost from 1k to 1M points.

    python benchmarks/geometry.py [--threads 2] [--runs 15] [--largest 1000000]

Prints, as Markdown:

* 30,000 matches, float64: triangulation against ``cv2.triangulatePoints`` and
  ``kornia.geometry.triangulate_points``; the choice among four poses against ``cv2.recoverPose``;
* time per point and peak memory of triangulation, residuals and one step of bundle adjustment as N
  grows tenfold.

Times are medians, the competitors taking turns in one process: wall-clock time beside peers,
processor time (all threads) for the growth, which other work on the machine disturbs less. Memory
is the growth of the resident set of a fresh child process over its inputs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable

import cv2
import kornia
import numpy as np
import torch
from torch import Tensor

from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.lie import hat, so3_exp
from sfmkit.geometry.pose import choose_pose
from sfmkit.geometry.reprojection import project, reprojection_residuals
from sfmkit.geometry.triangulation import triangulate
from sfmkit.geometry.uncertainty import covariance

D = torch.float64
Call = Callable[[], object]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--largest", type=int, default=1_000_000)
    args = parser.parse_args()
    sizes = [n for n in (1_000, 10_000, 100_000, 1_000_000) if n <= args.largest]
    memory = {n: peak_memory(n) for n in sizes}  # first: a child must be made before any thread
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    against_peers(args.runs)
    growth(sizes, memory, args.runs)


def scene(n: int, noise: float = 0.5) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Pixels in both images, K, R, t and nothing hidden: points in a box before two cameras."""
    g = torch.Generator().manual_seed(0)
    X = torch.rand(n, 3, generator=g, dtype=D) * torch.tensor([4.0, 3.0, 4.0]) + torch.tensor(
        [-2.0, -1.5, 4.0]
    )
    R, t = (
        so3_exp(torch.tensor([0.05, -0.15, 0.03], dtype=D)),
        torch.tensor([1.0, 0.1, -0.2], dtype=D),
    )
    K = torch.tensor([[1000.0, 0, 640], [0, 1000, 480], [0, 0, 1]], dtype=D)
    x1, x2 = (
        x + noise * torch.randn(n, 2, generator=g, dtype=D)
        for x in (project(X, K), project(X, K, R, t))
    )
    return x1, x2, K, R, t / t.norm()


def against_peers(runs: int) -> None:
    x1, x2, K, R, t = scene(30_000)
    xn1, xn2 = normalize(x1, K), normalize(x2, K)
    P1, P2 = torch.eye(3, 4, dtype=D), torch.cat((R, t[:, None]), 1)
    a1, a2 = xn1.numpy().T.copy(), xn2.numpy().T.copy()
    b1, b2 = xn1.numpy().copy(), xn2.numpy().copy()
    E = hat(t) @ R
    one, two, direction = cv2.decomposeEssentialMat(E.numpy())
    R4 = torch.from_numpy(np.stack((one, one, two, two)))
    t4 = torch.from_numpy(np.stack((direction, -direction, direction, -direction))[..., 0])
    P1_, P2_ = P1.numpy(), P2.numpy()
    kornias = P1[None], P2[None], xn1[None], xn2[None]
    triangulation: dict[str, Call] = {
        "cv2.triangulatePoints": lambda: cv2.triangulatePoints(P1_, P2_, a1, a2),
        "kornia triangulate_points": lambda: kornia.geometry.epipolar.triangulate_points(*kornias),
        "optimal (default)": lambda: triangulate(xn1, xn2, R, t, "optimal"),
        "midpoint": lambda: triangulate(xn1, xn2, R, t, "midpoint"),
        "dlt": lambda: triangulate(xn1, xn2, R, t, "dlt"),
    }
    choice: dict[str, Call] = {
        "cv2.recoverPose": lambda: cv2.recoverPose(E.numpy(), b1, b2, np.eye(3)),
        "choose_pose": lambda: choose_pose(R4, t4, xn1, xn2),
    }
    print("\n30,000 matches, float64\n")
    table(("", "ms", "of cv2"), against_first(triangulation, runs) + against_first(choice, runs))


def against_first(calls: dict[str, Call], runs: int) -> list[tuple[str, ...]]:
    times = medians(calls, runs)
    first = next(iter(times.values()))
    return [(name, f"{1e3 * s:.2f}", f"{s / first:.2f}") for name, s in times.items()]


def workload(n: int) -> dict[str, Call]:
    x1, x2, K, R, t = scene(n)
    xn1, xn2 = normalize(x1, K), normalize(x2, K)
    X = triangulate(xn1, xn2, R, t)
    bundle = bundle_adjust(x1, x2, K, K, R, t, max_iterations=0)
    return {
        "triangulate": lambda: triangulate(xn1, xn2, R, t),
        "residuals": lambda: reprojection_residuals(X, x1, x2, K, K, R, t),
        "bundle step": lambda: bundle_adjust(x1, x2, K, K, R, t, max_iterations=1),
        "covariance": lambda: covariance(bundle),
    }


def growth(sizes: list[int], memory: dict[int, dict[str, float]], runs: int) -> None:
    print("\nprocessor time and peak memory as N grows\n")
    rows = []
    for n in sizes:
        times = medians(workload(n), 3 if n > 100_000 else runs, time.process_time)
        for name, s in times.items():
            megabytes = memory[n][name]
            rows.append(
                (
                    name,
                    f"{n:,}",
                    f"{1e3 * s:.2f}",
                    f"{1e9 * s / n:.0f}",
                    f"{megabytes:.1f}",
                    f"{1e6 * megabytes / n:.0f}",
                )
            )
    rows.sort(key=lambda r: r[0])
    table(("", "N", "ms", "ns a point", "MB", "bytes a point"), rows)


def peak_memory(n: int) -> dict[str, float]:
    """Megabytes that each call takes at its peak beyond what its inputs do."""
    return {
        name: in_child(n, name)
        for name in ("triangulate", "residuals", "bundle step", "covariance")
    }


def in_child(n: int, name: str) -> float:
    receive, send = multiprocessing.get_context("fork").Pipe(False)

    def measure() -> None:
        torch.set_num_threads(1)
        work = workload(1_000)
        work[name]()  # libraries and their pools are loaded
        work = workload(n)
        before = resident()
        work[name]()
        send.send(max(0.0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before))

    child = multiprocessing.get_context("fork").Process(target=measure)
    child.start()
    child.join()
    return receive.recv()


def resident() -> float:
    """Megabytes resident now."""
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * resource.getpagesize() / 2**20


def medians(
    calls: dict[str, Call], runs: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(runs):
        for name, call in calls.items():
            start = clock()
            call()
            times[name].append(clock() - start)
    return {name: statistics.median(t) for name, t in times.items()}


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    for row in (head, tuple("-" * w for w in widths), *rows):
        cells = [c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths))]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
