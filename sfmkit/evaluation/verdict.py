"""Benchmark of verdicts: which poses are accepted, and whether they are correct.

The pairs, with and without a solution, come from photographs and rendered scenes. The robust
estimators of other libraries use the same matches and the common rule that a pose is accepted if it
has at least 15 or 30 inliers.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import torch

from .._utils.notices import collected
from .._utils.parallel import process_pool
from .._utils.progress import Progress
from .._utils.sharding import Shard, part_of
from .._utils.writing import check_folder
from .._version import __version__
from ..errors import InputError
from ..estimation import run_estimator, undistorted_pixels, within_the_field
from ..estimation.two_view import pose_from_fit
from ..features import choose_operators, detect
from ..geometry.pose import rotation_error, translation_error
from ..options import DEFAULT, EstimateOptions
from ..pipeline.stages import OPERATORS_OF_THE_PAPER, estimate_geometry, fuse_all, match_all
from ..types import Correspondences, Features, TwoView
from .rows import Row, RowStore, finite
from .verdict_pairs import BenchPair, bench_pairs_of_verdicts
from .verdict_views import BenchView

__all__ = ["OURS", "PEERS", "bench_verdict", "matched"]

OURS = "sfmkit"
PEERS = {"pycolmap": "pycolmap", "poselib": "PoseLib", "opencv": "OpenCV MAGSAC++"}
BUDGET = 2_000  # keypoints per operator and photograph
_ROUND = 24  # pairs per task of a process; consecutive pairs share photographs


def bench_verdict(
    out: str | os.PathLike,
    *,
    data: str | os.PathLike | None = None,
    groups: Sequence[str] | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    workers: int | None = None,
    shard: Shard | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Run the missing parts of the benchmark and return all of its rows.

    Args:
        out: Folder for ``rows.jsonl`` and the rendered photographs.
        data: Folder of the data sets, see :func:`sfmkit.datasets.pair.data_root`.
        groups: Run only groups of pairs whose names start with one of these; None for all.
        operators: Operators whose fused matches all estimators use.
        workers: Number of processes; None for one per core.
        shard: (i, n) for part i of n of the pairs; the same call without it collects all parts.
        progress: Called with (stage, detail) and the fraction of the pairs that is done.

    Returns:
        One row per pair and method: group, pair, solvable, has_truth, method, verdict (of sfmkit),
        inliers, score (larger is more certain), rotation_deg and translation_deg (None without
        ground truth or pose), seconds; ``pose`` is whether the method returned a pose.

    Raises:
        InputError: Data or an operator is missing, one of the other libraries is not installed, no
            group has such a name, or the rows in `out` come from other settings.
    """
    check_folder(out)
    operators = choose_operators(operators)
    settings = {"version": __version__, "operators": list(operators)}
    store = RowStore(Path(out) / "rows.jsonl", settings, shard)
    rows = store.read()
    if progress is not None:
        progress("verdict", "photographs", fraction=0.0)
    pairs = bench_pairs_of_verdicts(data, Path(out) / "views")
    if groups is not None:
        pairs = [pair for pair in pairs if pair.group.startswith(tuple(groups))]
    if not pairs:
        raise InputError(f"no group of pairs begins with {', '.join(groups or ())}")
    pairs = list(part_of(pairs, shard))
    have = {row["pair"] for row in rows}
    missing = [pair for pair in pairs if pair.name not in have]
    for done, new in _evaluated(missing, operators, workers or os.cpu_count() or 1):
        store.append(new)
        rows += new
        if progress is not None:
            part = 1 - (len(missing) - done) / len(pairs)
            progress("verdict", new[-1]["group"], fraction=part)
    wanted = {pair.name for pair in pairs}
    return [row for row in rows if row["pair"] in wanted]


def _evaluated(
    pairs: list[BenchPair], operators: tuple[str, ...], workers: int
) -> Iterable[tuple[int, list[Row]]]:
    """Yield rows in the order in which they are finished, and the number of finished pairs."""
    parts = [pairs[k : k + _ROUND] for k in range(0, len(pairs), _ROUND)]
    done = 0
    if workers == 1:
        for part in parts:
            done += len(part)
            yield done, _evaluate_part(part, operators)
        return
    with process_pool(workers) as pool:
        jobs = {pool.submit(_evaluate_part, part, operators): len(part) for part in parts}
        for job in as_completed(jobs):
            done += jobs[job]
            yield done, job.result()


def _evaluate_part(pairs: list[BenchPair], operators: tuple[str, ...]) -> list[Row]:
    with collected():
        return [row for pair in pairs for row in evaluate_pair(pair, operators)]


class _Key:
    """A photograph as the key of a cache; photographs with equal names have equal pixels."""

    def __init__(self, view: BenchView) -> None:
        self.view, self.name = view, (view.scene, view.name)

    def __hash__(self) -> int:
        return hash(self.name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.name == other.name


@lru_cache(maxsize=1024)
def _features(key: _Key, operator: str) -> Features:
    return detect(key.view.image, operator, budget=BUDGET)


def matched(
    pair: BenchPair, operators: Sequence[str]
) -> tuple[Correspondences, dict[str, tuple[Features, Features]]]:
    """Return the fused matches of a pair, and the features from which they were computed."""
    one, two = _Key(pair.view1), _Key(pair.view2)
    features = {name: (_features(one, name), _features(two, name)) for name in operators}
    corr = fuse_all(features, match_all(features, DEFAULT.match), DEFAULT.fuse)
    return within_the_field(corr, pair.view1.camera, pair.view2.camera), features


def evaluate_pair(pair: BenchPair, operators: Sequence[str]) -> list[Row]:
    """Compute the rows of all methods from the same matches."""
    corr, _ = matched(pair, operators)
    cameras = pair.view1.camera, pair.view2.camera
    where = {
        "group": pair.group,
        "pair": pair.name,
        "solvable": pair.solvable,
        "has_truth": pair.truth is not None,
        "matches": len(corr),
    }
    began = time.perf_counter()
    options = replace(DEFAULT.estimate, focal="fixed")  # all methods have the same cameras
    view, _ = estimate_geometry(corr, cameras, options)
    rows = [
        where
        | {
            "method": OURS,
            "verdict": view.verdict.value,
            "pose": view.R is not None,
            "inliers": int(view.inliers.sum()),
            "score": certainty(view),
            **_errors(pair, view.R, view.t),
            "evidence": {name: finite(float(v)) for name, v in view.evidence.items()},
            "seconds": time.perf_counter() - began,
        }
    ]
    x1, x2 = undistorted_pixels(corr, *cameras)
    (K1, _), (K2, _) = (camera.tensors() for camera in cameras)
    options = EstimateOptions(refine=False)
    for backend, name in PEERS.items():
        began = time.perf_counter()
        fit = run_estimator(
            backend,
            x1,
            x2,
            K1,
            K2,
            model="essential",
            method=None,
            threshold_px=options.threshold_px,
            confidence=options.confidence,
            max_iterations=options.max_iterations,
            seed=0,
        )
        inliers = int(fit.inliers.sum())
        pose = pose_from_fit(fit, x1, x2, K1, K2, options) if fit.model is not None else None
        rows.append(
            where
            | {
                "method": name,
                "verdict": None,
                "pose": pose is not None,
                "inliers": inliers,
                "score": float(inliers),
                **(_errors(pair, pose.R, pose.t) if pose else _errors(pair, None, None)),
                "seconds": time.perf_counter() - began,
            }
        )
    return rows


def certainty(view: TwoView) -> float:
    """Return minus the logarithm of the expected number of false alarms, base 10."""
    nfa = view.evidence.get("log10_false_alarms", 0.0)
    return -float(nfa) if finite(float(nfa)) is not None else 0.0


def _errors(
    pair: BenchPair, R: torch.Tensor | None, t: torch.Tensor | None
) -> dict[str, float | None]:
    errors: dict[str, float | None] = {"rotation_deg": None, "translation_deg": None}
    if pair.truth is None or R is None:
        return errors
    R_true, t_true = (torch.tensor(a, dtype=torch.float64) for a in pair.truth)
    errors["rotation_deg"] = finite(float(rotation_error(R, R_true)))
    if t is not None and float(t_true.norm()) > 1e-9:
        errors["translation_deg"] = finite(float(translation_error(t, t_true)))
    return errors
