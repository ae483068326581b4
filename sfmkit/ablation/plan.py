"""The plan of a sweep: all detections, matchings and estimates, each once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from .._utils.progress import Progress, silent
from .._utils.sharding import part_of
from ..datasets import Pair
from ..errors import InputError
from ..features import choose_operators
from ..matching.plugins import OTHER_OPERATORS, canonical_matchers, matcher_of
from .cache import Cache
from .plugins import ESTIMATOR, MATCHER, OPERATOR, REGISTRIES, PlugIn, find_plugin
from .sources import ImageShelf, PlannedPair, find_pairs, plan_pair
from .tasks import DetectTask, EstimateTask, Job, MatchTask, PairTask, Task, estimate_key
from .variants import MATCHER as MATCHER_SETTING
from .variants import Combination, Variant, choose_combinations, choose_variants
from .version import digest, engine_version

PlugIns = Mapping[tuple[str, str], PlugIn]

_ESTIMATES = 24  # per task at most: about ten seconds of work, and one file

# Rough costs on one thread, for the estimate of the time only: seconds per megapixel, per product
# of keypoints, and per estimate.
_DETECT_S = {"surf": 0.4, "orb": 0.15, "fast-brief": 0.1, "sift": 1.0, "akaze": 0.3}
_DETECT_OTHER_S = 1.0
_MATCH_S = 2.5e-9
_ESTIMATE_S = {True: 0.3, False: 0.5}  # homography, two-view
_KEYPOINTS = (3_000, 15_000)  # per image, and per megapixel in addition


@dataclass(frozen=True)
class Counts:
    """The number of results of each stage, and how many are in the cache.

    Attributes:
        detections, matchings, estimates: Distinct results.
        cached: Kind -> number of cached results.
        rows: Rows of the table.
        seconds: Rough time of the rest on one worker.
    """

    detections: int
    matchings: int
    estimates: int
    cached: Mapping[str, int]
    rows: int
    seconds: float


@dataclass(frozen=True, eq=False)
class Plan:
    """A sweep.

    Attributes:
        pairs: The pairs of the data.
        operators, combinations, variants, seeds: The settings.
        units: All estimates, in the order of the rows of the table.
        plugins: Plug-ins that are not part of sfmkit.
        shard: (i, n) if the pairs are part i of n of those of a sweep.
    """

    pairs: tuple[PlannedPair, ...]
    operators: tuple[str, ...]
    combinations: tuple[Combination, ...]
    variants: tuple[Variant, ...]
    seeds: int
    units: tuple[EstimateTask, ...]
    plugins: tuple[PlugIn, ...] = ()
    shard: tuple[int, int] | None = None

    @cached_property
    def matchings(self) -> dict[str, MatchTask]:
        return {m.key: m for unit in self.units for m in unit.needs}

    @cached_property
    def detections(self) -> dict[str, DetectTask]:
        return {d.key: d for m in self.matchings.values() for d in m.needs}

    @cached_property
    def identity(self) -> str:
        """Digest of everything on which the rows depend."""
        pairs = [[str(p), p.has_truth, p.failure] for p in self.pairs]
        return digest(engine_version(), pairs, [unit.key for unit in self.units])

    def count(self, cache: Cache | None) -> Counts:
        jobs = {
            job.key for unit in self.units for job in unit.jobs if not self.pairs[unit.pair].failure
        }
        groups: dict[str, Iterable[str]] = {
            "features": self.detections,
            "matches": self.matchings,
            "estimates": jobs,
        }
        have = {
            kind: {k for k in keys if cache is not None and cache.has(kind, k)}
            for kind, keys in groups.items()
        }
        waiting = [
            unit
            for unit in self.units
            if not self.pairs[unit.pair].failure
            and any(j.key not in have["estimates"] for j in unit.jobs)
        ]
        matchings = {
            m.key: m for unit in waiting for m in unit.needs if m.key not in have["matches"]
        }
        detections = {
            d.key: d for m in matchings.values() for d in m.needs if d.key not in have["features"]
        }
        stages: list[Task] = [*detections.values(), *matchings.values()]
        seconds = sum(cost(task) for task in stages)
        for unit in waiting:
            seconds += (
                cost(unit) * sum(j.key not in have["estimates"] for j in unit.jobs) / len(unit.jobs)
            )
        return Counts(
            len(self.detections),
            len(self.matchings),
            len(jobs),
            {kind: len(keys) for kind, keys in have.items()},
            sum(len(unit.jobs) for unit in self.units),
            seconds,
        )

    def as_json(self) -> dict[str, Any]:
        """Describe the sweep, for the file in its folder."""
        return {
            "identity": self.identity,
            "engine": engine_version(),
            "operators": list(self.operators),
            "combinations": [list(c) for c in self.combinations],
            "variants": [{"preset": v.preset, "vary": dict(v.changes)} for v in self.variants],
            "seeds": self.seeds,
            "plugins": [asdict(plugin) for plugin in self.plugins],
            "shard": None if self.shard is None else list(self.shard),
            "pairs": [p.as_json() for p in self.pairs],
        }


def cost(task: Task) -> float:
    """Estimate the seconds of a task on one worker."""
    if isinstance(task, DetectTask):
        return _DETECT_S.get(task.setting.operator, _DETECT_OTHER_S) * task.image.megapixels
    if isinstance(task, MatchTask):
        n1, n2 = (_keypoints(d) for d in task.needs)
        return _MATCH_S * n1 * n2
    if isinstance(task, PairTask):
        return _ESTIMATE_S[False] + sum(cost(match) for match in task.matches.values())
    return _ESTIMATE_S[task.homography] * len(task.jobs)


def _keypoints(task: DetectTask) -> float:
    guess = _KEYPOINTS[0] + _KEYPOINTS[1] * task.image.megapixels
    return min(guess, task.setting.budget or 60_000)


def make_plan(
    data: str | Iterable[str | Pair],
    operators: Sequence[str],
    *,
    combos: str | Sequence[str | Sequence[str]] = "all",
    seeds: int = 1,
    presets: Sequence[str] = ("default",),
    vary: Mapping[str, Sequence[Any]] | None = None,
    matchers: str | Mapping[str, str] | None = None,
    backend: str | None = None,
    root: str | os.PathLike | None = None,
    cache: Cache | None = None,
    images: Path | None = None,
    shard: tuple[int, int] | None = None,
    say: Progress = silent,
) -> Plan:
    """Plan a sweep; arguments as for :func:`sfmkit.ablation.ablate`.

    Args:
        cache: Cache of rendered pairs.
        images: Folder for images that are not files.
        shard: (i, n): only part i of n of the pairs; the images of other parts are not read.

    Raises:
        InputError: Operators, combinations, presets, settings or data sets are unknown, or there
            are fewer pairs than shards.
    """
    names = choose_operators(operators)
    if isinstance(seeds, bool) or not isinstance(seeds, int) or seeds < 1:
        raise InputError(f"seeds must be a whole number of at least 1, not {seeds!r}")
    combinations = choose_combinations(names, combos)
    variants = choose_variants(presets, chosen_plugins(matchers, backend) | dict(vary or {}), names)
    plugins = _plugins(names, variants)
    shelf = ImageShelf(images)
    found = []
    for pair in part_of(find_pairs(data, root, cache, say), shard):
        say("images", str(pair))
        found.append(plan_pair(pair, shelf))
    units = [
        unit
        for index, pair in enumerate(found)
        for unit in _units(index, pair, combinations, variants, seeds, plugins)
    ]
    own = tuple(p for p in plugins.values() if not REGISTRIES[p.kind].is_built_in(p.name))
    return Plan(
        tuple(found), names, tuple(combinations), tuple(variants), seeds, tuple(units), own, shard
    )


def chosen_plugins(
    matchers: str | Mapping[str, str] | None, backend: str | None
) -> dict[str, Sequence[Any]]:
    """Matchers and estimator as settings with one value each, for :func:`choose_variants`."""
    chosen: dict[str, Sequence[Any]] = {}
    matchers = canonical_matchers(matchers)
    if isinstance(matchers, str):
        chosen[MATCHER_SETTING] = [matchers]
    elif matchers is not None:
        for name, matcher in matchers.items():
            owner = "" if name == OTHER_OPERATORS else f"{name}."
            chosen[owner + MATCHER_SETTING] = [matcher]
    return chosen if backend is None else chosen | {"backend": [backend]}


def _plugins(
    operators: Sequence[str], variants: Sequence[Variant]
) -> dict[tuple[str, str], PlugIn]:
    """All operators, matchers and estimators of a sweep, by kind and name.

    Raises:
        InputError: One is unknown, cannot be loaded, or cannot be imported by workers.
    """
    names = [(OPERATOR, name) for name in operators]
    for variant in variants:
        options = variant.options  # raises where a value is out of range
        names += [(MATCHER, matcher_of(name, options.match)) for name in operators]
        names.append((ESTIMATOR, options.estimate.backend))
    return {(kind, name): find_plugin(kind, name) for kind, name in dict.fromkeys(names)}


def _units(
    index: int,
    pair: PlannedPair,
    combinations: Sequence[Combination],
    variants: Sequence[Variant],
    seeds: int,
    plugins: PlugIns,
) -> Iterable[EstimateTask]:
    """The estimates of one pair; changes without effect on a combination are left out."""
    chosen: dict[Variant, list[Combination]] = {}
    for variant in variants:
        for combination in combinations:
            mine = chosen.setdefault(variant.of(combination, pair.homography), [])
            if combination not in mine:
                mine.append(combination)
    size = max(1, _ESTIMATES // seeds)
    for variant, mine in chosen.items():
        for start in range(0, len(mine), size):
            part = mine[start : start + size]
            matches = _matchings(pair, variant, part, plugins)
            jobs = tuple(
                Job(c, seed, _job_key(index, pair, variant, matches, c, seed, plugins))
                for c in part
                for seed in range(seeds)
            )
            key = digest("unit", index, variant.preset, variant.vary, [job.key for job in jobs])
            yield EstimateTask(key, index, pair.homography, pair.cameras, variant, jobs, matches)


def _matchings(
    pair: PlannedPair,
    variant: Variant,
    combinations: Sequence[Combination],
    plugins: PlugIns,
) -> dict[str, MatchTask]:
    if pair.images is None or pair.failure:
        return {}
    first, second = pair.images
    options = variant.options.match
    found = {}
    for name in dict.fromkeys(o for c in combinations for o in c):
        setting, code = variant.setting(name), plugins[OPERATOR, name].code
        matcher = plugins[MATCHER, matcher_of(name, options)].code
        found[name] = MatchTask(
            DetectTask(first, setting, code), DetectTask(second, setting, code), options, matcher
        )
    return found


def _job_key(
    index: int,
    pair: PlannedPair,
    variant: Variant,
    matches: dict[str, MatchTask],
    combination: Combination,
    seed: int,
    plugins: PlugIns,
) -> str:
    if not matches:
        return digest("failed", index, str(pair), variant.preset, variant.vary, combination, seed)
    backend = variant.options.estimate.backend
    code = "" if pair.homography else plugins[ESTIMATOR, backend].code
    return estimate_key(pair.homography, pair.cameras, variant, matches, combination, seed, code)
