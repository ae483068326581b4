"""Compare pose errors of robust estimators on synthetic scenes, with one factor varied at a time.

    python benchmarks/sweep.py [--trials 20] [--workers 2] [--out docs/images/sweep.png]

Around a base case (500 matches, noise 0.5 px, 30 % of them wrong, baseline 0.2 of the mean depth,
sideways, no plane, 60 degrees wide), one factor at a time is swept. The error is the larger of
rotation and translation error; above 5 degrees, or without a model, a trial has failed. The input
of all estimators is the same: matches, threshold (1 px), confidence (0.9999) and largest number of
samples (10,000). The distance ratios and operators that sfmkit can use are not given. Writes the
plot and prints Markdown.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import torch
from torch import Tensor

from sfmkit.estimation import RobustModel, estimate_two_view, opencv, peers, robust
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.essential import decompose_essential
from sfmkit.geometry.lie import so3_exp
from sfmkit.geometry.pose import choose_pose, rotation_error, translation_error
from sfmkit.types import Camera, Correspondences, OperatorCounts

matplotlib.use("Agg")
import matplotlib.pyplot as plt

WIDTH, HEIGHT = 1200, 900
FAILED_DEG = 5.0


@dataclass(frozen=True)
class Case:
    """A kind of scene; mean depth 1, depths from 0.5 to 1.5."""

    matches: int = 500
    noise_px: float = 0.5
    outliers: float = 0.3
    baseline: float = 0.2
    planar: float = 0.0
    off_axis_deg: float = 90.0
    fov_deg: float = 60.0


@dataclass(frozen=True)
class Factor:
    field: str
    label: str
    values: tuple[float, ...]
    percent: bool = False
    log: bool = False


FACTORS = (
    Factor("noise_px", "noise (px)", (0.1, 0.25, 0.5, 1.0, 2.0, 3.0), log=True),
    Factor("outliers", "wrong matches (%)", (0.0, 0.3, 0.5, 0.6, 0.7, 0.8), percent=True),
    Factor("baseline", "baseline / mean depth", (0.01, 0.03, 0.1, 0.2, 0.5, 1.0), log=True),
    Factor("planar", "matches on a plane (%)", (0.0, 0.5, 0.8, 0.9, 0.95, 1.0), percent=True),
    Factor("off_axis_deg", "motion off the optical axis (°)", (0.0, 10.0, 30.0, 60.0, 90.0)),
    Factor("fov_deg", "field of view (°)", (20.0, 40.0, 60.0, 80.0, 100.0)),
)
# Colours of Okabe & Ito, each with a different marker and dash, so that estimators can be
# distinguished without colour.
STYLES = {
    "sfmkit": ("#D55E00", "o", "-"),
    "cv2 USAC_MAGSAC": ("#0072B2", "s", "--"),
    "poselib": ("#009E73", "^", "-."),
    "pycolmap": ("#CC79A7", "D", ":"),
}


@dataclass(frozen=True)
class Matches:
    x1: Tensor
    x2: Tensor
    K: Tensor
    R: Tensor
    t: Tensor


def make_matches(case: Case, seed: int) -> Matches:
    """Simulate matches of two cameras directed at about the same place at depth 1."""
    rng = np.random.default_rng(seed)
    f = WIDTH / 2 / math.tan(math.radians(case.fov_deg) / 2)
    K = np.array([[f, 0, (WIDTH - 1) / 2], [0, f, (HEIGHT - 1) / 2], [0, 0, 1]])
    around, off = rng.uniform(0, 2 * math.pi), math.radians(case.off_axis_deg)
    centre = case.baseline * np.array(
        [math.cos(around) * math.sin(off), math.sin(around) * math.sin(off), math.cos(off)]
    )
    R = _shaken(rng, case.fov_deg / 20) @ _looking_along(np.array([0, 0, 1.0]) - centre)
    right = case.matches - round(case.outliers * case.matches)
    on_plane = round(case.planar * right)
    x1, x2 = (
        np.concatenate(x)
        for x in zip(
            *(
                _seen(rng, K, R, centre, n, p)
                for n, p in ((on_plane, True), (right - on_plane, False))
            )
        )
    )
    noisy = [x + rng.normal(0, case.noise_px, x.shape) for x in (x1, x2)]
    wrong = (rng.uniform(0, (WIDTH, HEIGHT), (case.matches - right, 2)) for _ in range(2))
    all1, all2 = (torch.from_numpy(np.concatenate(x)) for x in zip(noisy, wrong))
    t = torch.from_numpy(-R @ centre)
    return Matches(all1, all2, torch.from_numpy(K), torch.from_numpy(R), t / t.norm())


def _looking_along(axis: np.ndarray) -> np.ndarray:
    """Compute the smallest rotation of `axis` to the optical axis."""
    axis = axis / np.linalg.norm(axis)
    turn = np.cross(axis, [0, 0, 1.0])
    sine = np.linalg.norm(turn)
    angle = math.atan2(sine, axis[2])
    return so3_exp(torch.from_numpy(turn / max(sine, 1e-12) * angle)).numpy()


def _shaken(rng: np.random.Generator, sigma_deg: float) -> np.ndarray:
    return so3_exp(torch.from_numpy(np.radians(rng.normal(0, sigma_deg, 3)))).numpy()


def _seen(
    rng: np.random.Generator, K: np.ndarray, R: np.ndarray, centre: np.ndarray, n: int, planar: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Draw points in front of both cameras: (n, 2) pixels in both images, uniform in image 1."""
    normal = np.array([0.3, -0.2, 1.0])
    x1, x2 = np.zeros((0, 2)), np.zeros((0, 2))
    while len(x1) < n:
        pixels = rng.uniform(0, (WIDTH, HEIGHT), (4 * n, 2))
        rays = np.c_[pixels, np.ones(len(pixels))] @ np.linalg.inv(K).T
        depth = normal[2] / (rays @ normal) if planar else rng.uniform(0.5, 1.5, len(pixels))
        Y = (rays * depth[:, None] - centre) @ R.T
        y = Y @ K.T
        with np.errstate(divide="ignore", invalid="ignore"):
            y = y[:, :2] / y[:, 2:]
        both = (depth > 0) & (Y[:, 2] > 0.05) & (y >= 0).all(1) & (y < (WIDTH, HEIGHT)).all(1)
        x1, x2 = np.concatenate((x1, pixels[both])), np.concatenate((x2, y[both]))
    return x1[:n], x2[:n]


def estimators() -> dict[str, Callable[..., RobustModel]]:
    return {
        "sfmkit": robust.estimate,
        "cv2 USAC_MAGSAC": opencv.estimate,
        "poselib": peers.estimate_poselib,
        "pycolmap": peers.estimate_pycolmap,
    }


def pose_error(fit: RobustModel, m: Matches) -> float:
    """Compute the pose error in degrees; 180 without a model.

    For all estimators, the pose with the most inliers in front of the cameras is chosen.
    """
    if fit.model is None or not bool(fit.inliers.any()):
        return 180.0
    xn1, xn2 = normalize(m.x1[fit.inliers], m.K), normalize(m.x2[fit.inliers], m.K)
    R, t, _ = choose_pose(*decompose_essential(fit.model), xn1, xn2)
    return float(torch.maximum(rotation_error(R, m.R), translation_error(t, m.t)))


def errors_of(case: Case, trials: int) -> dict[str, np.ndarray]:
    """Compute the errors of every estimator in degrees, one per trial."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    errors: dict[str, list[float]] = {name: [] for name in STYLES}
    for seed in range(trials):
        m = make_matches(case, seed)
        for name, estimate in estimators().items():
            errors[name].append(pose_error(estimate(m.x1, m.x2, m.K, m.K, seed=seed), m))
    return {name: np.array(e) for name, e in errors.items()}


def cases_of(factor: Factor) -> list[Case]:
    return [replace(Case(), **{factor.field: value}) for value in factor.values]  # type: ignore[arg-type]


def sweep(trials: int, workers: int) -> dict[Case, dict[str, np.ndarray]]:
    cases = list(dict.fromkeys(case for factor in FACTORS for case in cases_of(factor)))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return dict(zip(cases, pool.map(errors_of, cases, [trials] * len(cases))))


def whole_errors(case: Case, trials: int) -> np.ndarray:
    """Compute the errors of the whole estimation, with refinement and the test for a plane."""
    torch.set_num_threads(1)
    errors = []
    for seed in range(trials):
        m = make_matches(case, seed)
        n = len(m.x1)
        row, unknown = torch.arange(n), torch.full((n,), torch.nan, dtype=torch.float64)
        counts = {"made up": OperatorCounts((n, n), n)}
        corr = Correspondences(
            m.x1, m.x2, unknown, unknown, 0 * row, 0 * row + 1, row, row, ("made up",), counts
        )
        camera = Camera(m.K.numpy(), (WIDTH, HEIGHT))
        view = estimate_two_view(corr, camera, camera, seed=seed)
        if view.R is None or view.t is None:
            errors.append(180.0)
        else:
            errors.append(
                float(torch.maximum(rotation_error(view.R, m.R), translation_error(view.t, m.t)))
            )
    return np.array(errors)


def failure_rate(errors: np.ndarray) -> float:
    return 100 * float((errors > FAILED_DEG).mean())


def plot(results: dict[Case, dict[str, np.ndarray]], path: Path) -> None:
    figure, axes = plt.subplots(
        2, len(FACTORS), figsize=(16, 6), sharey="row", layout="constrained"
    )
    for column, factor in zip(axes.T, FACTORS):
        cases = cases_of(factor)
        x = np.array(factor.values) * (100 if factor.percent else 1)
        for name, (colour, marker, dash) in STYLES.items():
            style: dict[str, Any] = {
                "color": colour,
                "marker": marker,
                "linestyle": dash,
                "markersize": 4.5,
                "label": name,
            }
            column[0].plot(x, [np.median(results[c][name]) for c in cases], **style)
            column[1].plot(x, [failure_rate(results[c][name]) for c in cases], **style)
        for axis in column:
            axis.axvline(
                getattr(Case(), factor.field) * (100 if factor.percent else 1),
                color="0.85",
                linewidth=5,
                zorder=0,
            )
            axis.grid(alpha=0.25)
            if factor.log:
                axis.set_xscale("log")
                axis.set_xticks(x, [f"{v:g}" for v in x])
                axis.minorticks_off()
        column[0].set_yscale("log")
        column[1].set_xlabel(factor.label)
        column[1].set_ylim(-4, 104)
    axes[0, 0].set_ylabel("median pose error (°)")
    axes[1, 0].set_ylabel(f"failures, error > {FAILED_DEG:g}° (%)")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=len(STYLES),
        frameon=False,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def table(results: dict[Case, dict[str, np.ndarray]]) -> str:
    lines = [
        "| factor | value | " + " | ".join(STYLES) + " |",
        "|---|---:|" + "---:|" * len(STYLES),
    ]
    for factor in FACTORS:
        for value, case in zip(factor.values, cases_of(factor)):
            cells = [
                f"{np.median(e):.3f}° / {failure_rate(e):.0f} %" for e in results[case].values()
            ]
            shown = 100 * value if factor.percent else value
            lines.append(f"| {factor.label} | {shown:g} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2, help="processes; each uses one thread")
    parser.add_argument("--out", type=Path, default=Path("docs/images/sweep.png"))
    args = parser.parse_args()
    results = sweep(args.trials, args.workers)
    plot(results, args.out)
    print(table(results))
    hard = {
        "a plane alone": {"planar": 1.0},
        "forward": {"off_axis_deg": 0.0},
        "baseline 0.01": {"baseline": 0.01},
    }
    hard |= {"80 % wrong": {"outliers": 0.8}}
    with ProcessPoolExecutor(args.workers, multiprocessing.get_context("spawn")) as pool:
        found = pool.map(
            whole_errors, [replace(Case(), **h) for h in hard.values()], [args.trials] * len(hard)
        )  # type: ignore[arg-type]
    print("\nThe whole default, estimate_two_view:")
    for name, errors in zip(hard, found):
        print(f"* {name}: {np.median(errors):.3f}° / {failure_rate(errors):.0f} %")


if __name__ == "__main__":
    main()
