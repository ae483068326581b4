"""Detect once per photograph, match and judge once per pair: ``match_folder(...)``."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa

from .._utils.progress import Progress
from ..ablation.batch import BatchState, run_batch
from ..ablation.cache import DEFAULT_LIMIT, Cache, default_cache
from ..ablation.engine_choice import WAIT_S, start_engine
from ..ablation.engines import Engine
from ..ablation.entry import Entry
from ..ablation.plan import cost
from ..ablation.run import SweepState, Watcher
from ..ablation.stages import Store, features_of
from ..ablation.tasks import Task
from ..ablation.version import engine_version
from ..ablation.worker import Setup
from ..errors import InputError
from ..options import DEFAULT, Options
from ..types import Features, Verdict
from .choice import AUTO, choose_pairs, default_choice, parse_choice
from .collection import Collection, read_collection
from .pair_table import FAILED, make_pair_row, pair_table_of
from .planning import FolderPlan, Recipe, make_recipe
from .retrieval import similarities
from .shared_cameras import choose_shared_cameras

__all__ = ["MatchedFolder", "Workshop", "match_folder", "plan_folder"]

OPERATORS = ("surf", "orb", "fast-brief")


@dataclass(frozen=True)
class Workshop:
    """Where results are stored and who computes them.

    Attributes:
        cache: Of detections and pairs.
        workers: Local processes; None for one per core.
        scheduler: ``tcp://host:port`` of a Dask cluster whose workers see the same files.
        wait: Seconds to wait for a worker of the cluster.
        watch: Called with the progress.
    """

    cache: Cache
    workers: int | None = None
    scheduler: str | None = None
    wait: float = WAIT_S
    watch: Watcher = lambda state: None

    @classmethod
    def of(
        cls,
        cache: str | os.PathLike | None = None,
        cache_limit: int = DEFAULT_LIMIT,
        workers: int | None = None,
        scheduler: str | None = None,
        wait: float = WAIT_S,
        progress: Watcher | None = None,
    ) -> Workshop:
        """The workshop of these settings; without `cache`, that of ablations."""
        store = Cache(default_cache() if cache is None else cache, cache_limit)
        return cls(store, workers, scheduler, wait, progress or (lambda state: None))

    def run(self, stage: str, tasks: Iterator[Task], total: int, cost_s: float, recipe: Recipe):
        """Carry out tasks; returns key -> reason of those that failed."""
        setup = Setup(engine_version(), self.cache.location, recipe.foreign_plugins)

        def start() -> Engine:
            return start_engine(
                setup, workers=self.workers, scheduler=self.scheduler, wait_s=self.wait
            )

        def watch(state: BatchState) -> None:
            self.watch(
                SweepState(
                    stage, state.done, state.total, state.what, state.seconds_left, state.notes
                )
            )

        return run_batch(tasks, total, cost_s, self.cache, start, watch)

    def say(self) -> Progress:
        """The progress of reading and planning."""

        def report(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
            self.watch(SweepState("plan", what=f"{stage} {detail}"))

        return report


@dataclass(frozen=True, eq=False)
class MatchedFolder:
    """A folder whose pairs have been matched and judged.

    Attributes:
        plan: Photographs, cameras, pairs and recipe.
        failures: Key of a task -> reason.
        cache: Where the results are.
    """

    plan: FolderPlan
    failures: Mapping[str, str]
    cache: Cache

    def __len__(self) -> int:
        return len(self.plan)

    def geometry(self, row: int) -> Entry | str:
        """The result of a pair, see :func:`sfmkit.ablation.geometries.make_geometry`; or the reason
        of its failure."""
        task = self.plan.task(row)
        if task.key in self.failures:
            return self.failures[task.key]
        return self._store.result(task)

    def features(self, photograph: int, operator: str) -> Features:
        """The features of an operator in a photograph."""
        return features_of(self._store.result(self.plan.detection(photograph, operator)))

    @property
    def _store(self) -> Store:
        """Results from the cache; one that has been dropped from there is computed again."""
        return Store(self.cache)

    @cached_property
    def table(self) -> pa.Table:
        """One row per pair, in the order of the plan."""
        names = self.plan.collection.names
        rows = []
        for row, (i, j) in enumerate(self.plan.pairs.tolist()):
            result = self.geometry(row)
            meta = result if isinstance(result, str) else result.meta
            rows.append(make_pair_row((names[i], names[j]), meta))
        return pair_table_of(rows, self.plan.recipe.operators)

    @cached_property
    def unreadable(self) -> dict[str, str]:
        """Name -> reason of the photographs that were skipped or could not be decoded."""
        found = dict(self.plan.collection.skipped)
        for photograph in self.plan.used.tolist():
            for operator in self.plan.recipe.operators:
                reason = self.failures.get(self.plan.detection(photograph, operator).key, "")
                if reason.startswith("ImageError"):
                    found[self.plan.collection.names[photograph]] = reason
        return found

    @property
    def verdicts(self) -> dict[str, int]:
        """Verdict -> number of pairs."""
        column = self.table["verdict"].to_pylist()
        order = [*(v.value for v in Verdict), FAILED]
        return {name: column.count(name) for name in order if name in column}


def plan_folder(
    collection: Collection,
    recipe: Recipe,
    workshop: Workshop,
    *,
    intrinsics: Mapping[str, str] | str | None = None,
    pairs: str = AUTO,
) -> FolderPlan:
    """Choose cameras and pairs of a collection.

    Args:
        intrinsics: As for :func:`sfmkit.mapping.shared_cameras.choose_shared_cameras`.
        pairs: As for :func:`match_folder`.

    Raises:
        InputError: Cameras or pairs that cannot be chosen in this way.
    """
    cameras = choose_shared_cameras(collection, intrinsics)
    rules = default_choice(collection) if pairs == AUTO else parse_choice(pairs)

    def similarity() -> np.ndarray:
        return _similarities(collection, recipe, workshop)

    chosen = choose_pairs(rules, collection, similarity)
    return FolderPlan(collection, cameras, recipe, "+".join(map(str, rules)), chosen)


def _similarities(collection: Collection, recipe: Recipe, workshop: Workshop) -> np.ndarray:
    """The similarities of all photographs; one that cannot be decoded is similar to none."""
    n = len(collection)

    def task(index: int):
        return recipe.overview(collection.ref(index))

    seconds = sum(cost(task(k)) for k in range(n))
    failures = workshop.run("compare", (task(k) for k in range(n)), n, seconds, recipe)
    store = Store(workshop.cache)

    def features(index: int) -> Features:
        found = task(index)
        if found.key in failures:
            return _nothing(recipe.descriptor, collection.photographs[index].size_wh)
        return features_of(store.result(found))

    return similarities(features, n)


def _nothing(operator: str, size_wh: tuple[int, int]) -> Features:
    """No features of an operator with real-valued descriptors."""
    empty = np.zeros(0, np.float32)
    return Features(
        np.zeros((0, 2), np.float32),
        empty,
        empty,
        empty,
        np.zeros((0, 1), np.float32),
        "l2",
        operator,
        size_wh,
    )


def match_folder(
    folder: str | os.PathLike,
    *,
    intrinsics: Mapping[str, str] | str | None = None,
    operators: Sequence[str] = OPERATORS,
    matchers: str | Mapping[str, str] | None = None,
    options: Options = DEFAULT,
    pairs: str = AUTO,
    descriptor: str = "sift",
    masks: str | os.PathLike | None = None,
    seed: int = 0,
    shard: tuple[int, int] | None = None,
    check: Callable[[FolderPlan], None] | None = None,
    workshop: Workshop | None = None,
) -> MatchedFolder:
    """Match the photographs of a folder and judge every pair.

    Every photograph is searched once per operator, every pair matched and judged once. Results are
    cached by content; the same call resumes after it was killed.

    >>> matched = match_folder("photographs", intrinsics="K.txt")
    >>> matched.table["verdict"]

    Args:
        folder: Photographs, also in subfolders; see :func:`sfmkit.mapping.read_collection`.
        intrinsics: Of all photographs, or subfolder -> intrinsics; None for EXIF.
        operators, matchers, options: As for :func:`sfmkit.reconstruct`.
        pairs: Rules such as ``all``, ``sequential:5``, ``gps:10``, ``similar:10``, joined by ``+``;
            ``auto`` chooses all pairs of up to 40 photographs.
        descriptor: The operator whose features decide how similar two photographs are.
        masks: Folder of masks, black where keypoints are not used.
        seed: The same seed gives the same result on the same machine.
        shard: (i, n) for part i of n of the pairs, i from 1.
        check: Called with the plan before the work; it may raise InputError.
        workshop: Cache, workers and progress; None for the defaults.

    Raises:
        InputError: What is asked for is impossible; before the work starts.
        OutputError: The disk is full, or the cache cannot be written.
    """
    workshop = workshop or Workshop.of()
    workshop.cache.check(local_workers=workshop.scheduler is None)
    recipe = make_recipe(
        operators, options=options, matchers=matchers, descriptor=descriptor, seed=seed
    )
    collection = read_collection(folder, masks=masks, say=workshop.say())
    plan = plan_folder(collection, recipe, workshop, intrinsics=intrinsics, pairs=pairs)
    plan = plan.part(shard)
    if check is not None:
        check(plan)
    tasks = (plan.task(row) for row in range(len(plan)))
    failures = workshop.run("pairs", tasks, len(plan), plan.seconds(), recipe)
    if len(failures) and all(plan.task(k).key in failures for k in range(len(plan))):
        raise InputError(f"no pair could be matched: {next(iter(failures.values()))}")
    return MatchedFolder(plan, failures, workshop.cache)
