"""Compare two-view geometry with kornia and OpenCV, and measure the cost of 1k to 1M points.

    python benchmarks/geometry.py [--threads 2] [--runs 15] [--largest 1000000]
    python benchmarks/geometry.py --peers

Prints, as Markdown:

* functions compared with kornia and OpenCV: time relative to sfmkit, as in docs/kornia.md;
* accuracy of the solvers on exact matches, compared with kornia;
* 30,000 matches, float64: triangulation and the choice among four poses;
* time per point and peak memory of triangulation, residuals and one step of bundle adjustment as N
  grows tenfold.

``--peers`` prints the first two. Times are medians of processor time (all threads), the competitors
alternating in one process; compare ratios within one run only. Memory is the growth of the resident
set of a fresh child process over its inputs.
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
from kornia.geometry import conversions, epipolar, homography
from torch import Tensor

import sfmkit.geometry as sg
from sfmkit.geometry import (
    bundle_adjust,
    choose_pose,
    covariance,
    hat,
    normalize,
    project,
    reprojection_residuals,
    so3_exp,
    triangulate,
)

D = torch.float64
Call = Callable[[], object]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--largest", type=int, default=1_000_000)
    parser.add_argument(
        "--peers", action="store_true", help="only time and accuracy compared with peers"
    )
    args = parser.parse_args()
    if args.peers:
        torch.set_num_threads(args.threads)
        cv2.setNumThreads(args.threads)
        function_times(args.runs)
        solver_accuracy()
        return
    sizes = [n for n in (1_000, 10_000, 100_000, 1_000_000) if n <= args.largest]
    memory = {
        n: peak_memory(n) for n in sizes
    }  # first, because children must be forked before threads start
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(args.threads)
    function_times(args.runs)
    solver_accuracy()
    against_peers(args.runs)
    growth(sizes, memory, args.runs)


def scene(n: int, noise: float = 0.5) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Simulate points in a box in front of two cameras: pixels in both images, K, R and t."""
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


def function_times(runs: int) -> None:
    """Print the processor time of kornia and OpenCV over that of sfmkit, per function."""
    x1, x2, K, R, t = scene(20_000)
    xn1, xn2 = normalize(x1, K), normalize(x2, K)
    E, F = sg.essential_from_pose(R, t), sg.fundamental_from_pose(R, t, K, K)
    H, M = sg.homography_dlt(x1, x2), E.expand(1000, 3, 3).contiguous()
    five = [x[:5000].reshape(1000, 5, 2) for x in (xn1, xn2)]
    seven = [x[:7000].reshape(1000, 7, 2) for x in (x1, x2)]
    four = [x[:4000].reshape(1000, 4, 2) for x in (x1, x2)]
    a1, a2, b1, b2 = x1[None], x2[None], x1.numpy(), x2.numpy()
    w, rotations = torch.randn(1000, 3, dtype=D), so3_exp(torch.randn(1000, 3, dtype=D))
    K1 = K[None]
    kornias: dict[str, tuple[Call, Call, Call | None]] = {
        "essential_5point, 1000": (
            lambda: sg.essential_5point(*five),
            lambda: epipolar.find_essential(*five),
            None,
        ),
        "fundamental_7point, 1000": (
            lambda: sg.fundamental_7point(*seven),
            lambda: epipolar.find_fundamental(*seven, method="7POINT"),
            None,
        ),
        "fundamental_8point, 20,000 matches": (
            lambda: sg.fundamental_8point(x1, x2),
            lambda: epipolar.find_fundamental(a1, a2),
            lambda: cv2.findFundamentalMat(b1, b2, cv2.FM_8POINT),
        ),
        "homography_dlt, 20,000 matches": (
            lambda: sg.homography_dlt(x1, x2),
            lambda: homography.find_homography_dlt(a1, a2),
            lambda: cv2.findHomography(b1, b2, 0),
        ),
        "homography_4point, 1000": (
            lambda: sg.homography_4point(*four),
            lambda: kornia.geometry.get_perspective_transform(*four),
            None,
        ),
        "epipolar_lines, 20,000": (
            lambda: sg.epipolar_lines(F, x1),
            lambda: epipolar.compute_correspond_epilines(x1, F),
            lambda: cv2.computeCorrespondEpilines(b1[:, None], 1, F.numpy()),
        ),
        "signed_sampson_distance, 20,000": (
            lambda: sg.signed_sampson_distance(F, x1, x2),
            lambda: epipolar.sampson_epipolar_distance(x1, x2, F),
            None,
        ),
        "squared_transfer_error, 20,000": (
            lambda: sg.squared_transfer_error(H, x1, x2),
            lambda: homography.oneway_transfer_error(a1, a2, H[None]),
            None,
        ),
        "decompose_essential, 1000": (
            lambda: sg.decompose_essential(M),
            lambda: epipolar.motion_from_essential(M),
            None,
        ),
        "decompose and choose, 20,000": (
            lambda: choose_pose(*sg.decompose_essential(E), xn1, xn2),
            lambda: epipolar.motion_from_essential_choose_solution(E[None], K1, K1, a1, a2),
            lambda: cv2.recoverPose(E.numpy(), b1, b2, K.numpy()),
        ),
        "so3_exp, 1000": (
            lambda: so3_exp(w),
            lambda: conversions.axis_angle_to_rotation_matrix(w),
            None,
        ),
        "so3_log, 1000": (
            lambda: sg.so3_log(rotations),
            lambda: conversions.rotation_matrix_to_axis_angle(rotations),
            None,
        ),
    }
    rows = []
    for name, calls in kornias.items():
        named = {k: c for k, c in zip(("sfmkit", "kornia", "cv2"), calls) if c is not None}
        times = medians(named, runs, time.process_time)
        ratios = [
            f"{times[k] / times['sfmkit']:.2f}" if k in times else "" for k in ("kornia", "cv2")
        ]
        rows.append((name, f"{1e3 * times['sfmkit']:.2f}", *ratios))
    print("\nprocessor time compared with kornia and OpenCV\n")
    table(("", "sfmkit, ms", "kornia / sfmkit", "cv2 / sfmkit"), rows)


def solver_accuracy(n: int = 20_000) -> None:
    """Print how often, and by how much, solvers miss the truth on exact matches."""
    rows = []
    for motion in ("sideways", "forward"):
        x1, x2, E = exact_samples(n, 7, forward=motion == "forward")
        five = zip(x1[:, :5].split(2000), x2[:, :5].split(2000))
        parts = [(sg.essential_5point(a, b)[0], epipolar.find_essential(a, b)) for a, b in five]
        solved = [torch.cat(p) for p in zip(*parts)]
        seven = sg.fundamental_7point(x1, x2)[0], epipolar.find_fundamental(x1, x2, method="7POINT")
        for name, (ours, theirs) in (("5 points", solved), ("7 points", seven)):
            missed = (float((distances(C, E) > 1e-6).double().mean()) for C in (ours, theirs))
            rows.append(
                (f"{name}, {motion}: missed by > 1e-6", *(f"{100 * m:.3f} %" for m in missed))
            )
    for flat in (1.0, 1e-2, 1e-4):
        x1, x2, E = exact_samples(500, 20, flat=flat)
        fits = sg.fundamental_8point(x1, x2), epipolar.find_fundamental(x1, x2)
        errors = (float(distances(F[:, None], E).median()) for F in fits)
        rows.append((f"8 points, depth x {flat:g}: median error", *(f"{e:.1e}" for e in errors)))
    print("\naccuracy on exact matches\n")
    table(("", "sfmkit", "kornia"), rows)


def exact_samples(
    n: int, size: int, forward: bool = False, flat: float = 1.0
) -> tuple[Tensor, Tensor, Tensor]:
    """Draw normalised matches (n, size, 2) of a box with depth times `flat`, and their unit E."""
    g = torch.Generator().manual_seed(0)
    X = torch.rand(n, size, 3, generator=g, dtype=D) * torch.tensor([4.0, 3.0, 4.0 * flat])
    X = X + torch.tensor([-2.0, -1.5, 4.0])
    R = so3_exp(0.2 * torch.randn(n, 3, generator=g, dtype=D))
    t = 0.1 * torch.randn(n, 3, generator=g, dtype=D)
    t[:, 2 if forward else 0] += 1
    Y = X @ R.mT + t[:, None]
    E = sg.essential_from_pose(R, t)
    E = E / E.flatten(1).norm(dim=1)[:, None, None]
    return X[..., :2] / X[..., 2:], Y[..., :2] / Y[..., 2:], E


def distances(candidates: Tensor, truth: Tensor) -> Tensor:
    """Compute (n,) distances of the nearest candidates (n, C, 3, 3) to the truth, unit norm."""
    C = candidates.nan_to_num()
    C = C / C.flatten(-2).norm(dim=-1)[..., None, None].clamp(min=1e-300)
    apart = ((C - s * truth[:, None]).flatten(-2).norm(dim=-1) for s in (1, -1))
    return torch.minimum(*apart).amin(-1)


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
    """Measure the peak memory of each call beyond its inputs, megabytes."""
    return {
        name: in_child(n, name)
        for name in ("triangulate", "residuals", "bundle step", "covariance")
    }


def in_child(n: int, name: str) -> float:
    receive, send = multiprocessing.get_context("fork").Pipe(False)

    def measure() -> None:
        torch.set_num_threads(1)
        work = workload(1_000)
        work[name]()  # loads libraries and starts their pools
        work = workload(n)
        before = resident()
        work[name]()
        send.send(max(0.0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before))

    child = multiprocessing.get_context("fork").Process(target=measure)
    child.start()
    child.join()
    return receive.recv()


def resident() -> float:
    """Return the resident memory, megabytes."""
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
