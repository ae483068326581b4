"""Oxford benchmark: homographies of single operators and of their fusion.

They are estimated with the methods of sfmkit and of the paper. Features are detected once per image
and matched once per operator and pair; all seeds and both methods use the same matches. The rows of
a pair are appended to ``rows.jsonl`` when the pair is finished, so an interrupted run can be
resumed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch

from .._utils.parallel import process_pool
from .._utils.progress import Progress
from .._utils.sharding import Shard, part_of
from .._utils.writing import check_folder
from .._version import __version__
from ..ablation.plugins import MATCHER, OPERATOR, REGISTRIES, PlugIn, find_plugin, load_plugins
from ..datasets.oxford import oxford
from ..datasets.pair import Pair
from ..errors import InputError
from ..features import choose_operators, detect
from ..geometry.homography import squared_homography_sampson_distance
from ..geometry.homography_refinement import refine_homography
from ..io.images import read_image
from ..matching import canonical_matchers, matcher_of, run_matcher
from ..metrics import (
    corner_error,
    homography_rmse,
    match_errors,
    matching_score,
    mean_matching_accuracy,
    repeatability,
)
from ..options import DEFAULT, PAPER, MatchOptions, Options
from ..pipeline.account import ALL
from ..pipeline.registration import register_matches
from ..pipeline.stages import OPERATORS_OF_THE_PAPER, FeaturePairs, choose_options, fuse_all
from ..types import Correspondences, Features, Matches
from .rows import Row, RowStore, finite
from .settings import plugin_settings

FLOOR = "floor"
OURS, PAPERS = "ours", "paper"
FLOOR_PX = 3.0


def bench_oxford(
    out: str | os.PathLike,
    *,
    data: str | os.PathLike | None = None,
    sequences: Iterable[str] | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    matchers: str | Mapping[str, str] | None = None,
    seeds: int = 5,
    workers: int | None = None,
    shard: Shard | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Run the missing parts of the benchmark and return all of its rows.

    Args:
        out: Folder for ``rows.jsonl``.
        data: Folder of the data sets, see :func:`sfmkit.datasets.oxford.oxford`.
        sequences: Names of sequences; None for all that are present.
        operators: At least one; each runs alone, and all together as ``multi``.
        matchers: Matcher of all operators, or a mapping operator -> matcher; None for ``nearest``.
        seeds: Every estimate is repeated with seeds 0 ... seeds - 1.
        workers: Number of processes; None for one per core.
        shard: (i, n) for part i of n of the pairs; the same call without it collects all parts.
        progress: Called with (stage, detail) and the fraction of pairs that are done.

    Returns:
        Rows of three kinds: ``estimate`` (sequence, pair, operator or ``multi``, recipe, seed ->
        rmse, corner_error_px, matches, inliers, seconds; rmse and corner_error_px are None if
        the verdict is too little evidence), ``floor`` (the same for a fit to the fused matches
        that agree with the truth within 3 px) and ``features`` (per operator: keypoints,
        matches, repeatability, matching_score, mma, seconds).

    Raises:
        InputError: The data are missing, an operator or matcher is unknown or, with several
            workers, cannot be imported by them, `seeds` is less than 1, or the rows in `out` come
            from other settings.
    """
    check_folder(out)
    operators = choose_operators(operators)
    matchers = canonical_matchers(matchers)
    options = choose_options(DEFAULT, operators, matchers=matchers)
    if seeds < 1:
        raise InputError(f"seeds must be at least 1, not {seeds}")
    pairs = part_of(list(oxford(data, sequences)), shard)
    settings = {
        "version": __version__,
        **plugin_settings(operators, options, matchers=matchers),
        "seeds": seeds,
    }
    plugins = () if workers == 1 else _foreign_plugins(operators, options.match)
    store = RowStore(Path(out) / "rows.jsonl", settings, shard)
    rows = store.read()
    have = {(row["sequence"], row["pair"]) for row in rows}
    missing = [pair for pair in pairs if (pair.sequence, pair.name) not in have]
    done = len(pairs) - len(missing)
    if progress is not None:
        progress("oxford", fraction=done / len(pairs))
    workers = min(workers or os.cpu_count() or 1, max(len(missing), 1))
    evaluate = partial(
        evaluate_pair, operators=operators, seeds=seeds, match=options.match, plugins=plugins
    )
    if workers == 1:
        for pair in missing:
            done += 1
            _keep(store, rows, evaluate(pair), progress, done, len(pairs), pair)
    else:
        with process_pool(workers) as pool:
            jobs = {pool.submit(evaluate, pair): pair for pair in missing}
            for job in as_completed(jobs):
                done += 1
                _keep(store, rows, job.result(), progress, done, len(pairs), jobs[job])
    wanted = {(pair.sequence, pair.name) for pair in pairs}
    return [row for row in rows if (row["sequence"], row["pair"]) in wanted]


def _keep(
    store: RowStore,
    rows: list[Row],
    new: list[Row],
    progress: Progress | None,
    done: int,
    total: int,
    pair: Pair,
) -> None:
    store.append(new)
    rows += new
    if progress is not None:
        progress("oxford", f"{pair.sequence} {pair.name}", fraction=done / total)


def _foreign_plugins(operators: Sequence[str], match: MatchOptions) -> tuple[PlugIn, ...]:
    """Find the operators and matchers that are not part of sfmkit, for worker processes."""
    names = [(OPERATOR, name) for name in operators]
    names += [(MATCHER, matcher_of(name, match)) for name in operators]
    return tuple(
        find_plugin(kind, name)
        for kind, name in dict.fromkeys(names)
        if not REGISTRIES[kind].is_built_in(name)
    )


@lru_cache(maxsize=8)
def _first_image(path: Path, operator: str) -> Features:
    """Detect features in the first image of a sequence, which all of its pairs share."""
    return detect(read_image(path), operator)


def evaluate_pair(
    pair: Pair,
    operators: Sequence[str],
    seeds: int,
    match: MatchOptions,
    plugins: Sequence[PlugIn] = (),
) -> list[Row]:
    """Compute all rows of a pair.

    Args:
        pair: A pair with a true homography.
        operators: Canonical names.
        seeds: Number of seeds.
        match: Options of the matching, which contain the matchers.
        plugins: Plug-ins that a worker process has to load first.

    Raises:
        InputError: A plug-in cannot be loaded, or fails.
    """
    if reason := load_plugins(plugins):
        raise InputError(reason)
    assert pair.H is not None
    where = {"sequence": pair.sequence, "pair": pair.name}
    features: dict[str, tuple[Features, Features]] = {}
    matches: dict[str, Matches] = {}
    rows: list[Row] = []
    second = read_image(pair.image2)  # type: ignore[arg-type]
    for name in operators:
        began = time.perf_counter()
        f1, f2 = features[name] = (_first_image(pair.image1, name), detect(second, name))  # type: ignore[arg-type]
        detected = time.perf_counter()
        m = matches[name] = run_matcher(f1, f2, match, operator=name)
        matched = time.perf_counter()
        repeated, _ = repeatability(f1, f2, pair.H)
        rows.append(
            {
                "kind": "features",
                **where,
                "operator": name,
                "keypoints": [len(f1), len(f2)],
                "matches": len(m),
                "repeatability": repeated,
                "matching_score": matching_score(f1, f2, m, pair.H),
                "mma": mean_matching_accuracy(match_errors(f1, f2, m, pair.H)),
                "seconds": matched - began,
                "match_seconds": matched - detected,
            }
        )
    corr = fuse_all(features, matches, DEFAULT.fuse)
    rows.append(
        {
            "kind": FLOOR,
            **where,
            **_floor(corr.x1, corr.x2, pair.H, next(iter(features.values()))[0].size_wh),
        }
    )

    single = [(name, {name: features[name]}, {name: matches[name]}) for name in operators]
    both = [*single, (ALL, features, matches)] if len(operators) > 1 else single
    for name, mine, theirs in both:
        for recipe, options in ((OURS, DEFAULT), (PAPERS, PAPER)):
            fused = fuse_all(mine, theirs, options.fuse)
            for seed in range(seeds):
                rows.append(
                    {
                        "kind": "estimate",
                        **where,
                        "operator": name,
                        "recipe": recipe,
                        "seed": seed,
                        **_estimate(mine, theirs, fused, pair.H, options, seed),
                    }
                )
    return rows


def _estimate(
    features: FeaturePairs,
    matches: dict[str, Matches],
    fused: Correspondences,
    H_true: np.ndarray,
    options: Options,
    seed: int,
) -> Row:
    began = time.perf_counter()
    result = register_matches(features, matches, options=options, seed=seed, fused=fused)
    seconds = time.perf_counter() - began
    size_wh = next(iter(features.values()))[0].size_wh
    H = None if result.H is None else result.H.numpy()
    corner = None if H is None else corner_error(H, H_true, size_wh)
    return {
        "matches": len(result.correspondences),
        "inliers": int(result.inliers.sum()),
        "guided": 0 if result.guided is None else len(result.guided),
        "rmse": None if H is None else homography_rmse(H, H_true),
        "corner_error_px": finite(corner),
        "log10_false_alarms": finite(result.evidence.get("log10_false_alarms")),
        "seconds": seconds,
    }


def _floor(x1: torch.Tensor, x2: torch.Tensor, H_true: np.ndarray, size_wh: tuple[int, int]) -> Row:
    """Measure a fit to the matches that agree with the true homography.

    Its error bounds what can be reached with these matches: it contains the error of the ground
    truth and the errors of the keypoints.
    """
    T = torch.from_numpy(H_true.copy())
    right = squared_homography_sampson_distance(T, x1, x2) < FLOOR_PX**2
    H = refine_homography(T, x1[right], x2[right], threshold_px=FLOOR_PX).numpy()
    return {
        "matches": int(right.sum()),
        "rmse": homography_rmse(H, H_true),
        "corner_error_px": corner_error(H, H_true, size_wh),
    }
