"""A sweep from plan to table: ``ablate(...)``.

One process plans, distributes the tasks, and is the only one that writes to the folder of the
sweep; workers write to the cache. If a process is killed, both keep their content, and the same
call resumes the sweep.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from .._utils.progress import Progress
from ..datasets import Pair
from ..errors import InputError
from .cache import DEFAULT_LIMIT, Cache, default_cache
from .driving import drive
from .engine_choice import WAIT_S, start_engine
from .engines import Engine
from .entry import DamagedEntry, Entry
from .folder import SweepFolder
from .plan import Plan, cost, make_plan
from .scheduling import Agenda, all_needs
from .table import AblationTable, make_row
from .tasks import DetectTask, EstimateTask, Task
from .version import engine_version
from .worker import Outcome, Parcel, Setup


@dataclass(frozen=True)
class SweepState:
    """The progress of a sweep.

    Attributes:
        stage: ``plan``, ``run`` or ``merge``.
        done, total: Rows.
        what: The last task.
        seconds_left: Estimate; None before the first measurement.
        notes: Warnings for the user since the last state.
    """

    stage: str
    done: int = 0
    total: int = 0
    what: str = ""
    seconds_left: float | None = None
    notes: tuple[str, ...] = ()


Watcher = Callable[[SweepState], None]


def _planning(watch: Watcher) -> Progress:
    """Convert the progress of the plan to states of the sweep."""

    def report(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
        watch(SweepState("plan", what=f"{stage} {detail}"))

    return report


def ablate(
    data: str | Iterable[str | Pair],
    operators: Sequence[str] = ("surf", "orb", "fast-brief"),
    *,
    combos: str | Sequence[str | Sequence[str]] = "all",
    seeds: int = 1,
    preset: str | Sequence[str] = "default",
    vary: Mapping[str, Sequence[Any]] | None = None,
    matchers: str | Mapping[str, str] | None = None,
    backend: str | None = None,
    out: str | os.PathLike | None = None,
    root: str | os.PathLike | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    ship: Literal["path", "bytes"] = "path",
    wait: float = WAIT_S,
    cache: str | os.PathLike | None = None,
    cache_limit: int = DEFAULT_LIMIT,
    shard: tuple[int, int] | None = None,
    progress: Watcher | None = None,
) -> AblationTable:
    """Run every combination of operators on every pair and return one table.

    >>> table = ablate("planes:viewpoint", ["surf", "orb", "sift"], seeds=3, out="out/ablation")

    Features are detected once per image, operator and setting, and matched once per pair; all
    combinations and seeds share them. Results are cached by content, so other sweeps use them as
    well. A failed run becomes a row with its reason.

    Args:
        data: Data sets, ``"oxford,strecha:fountain-P11"`` (sequences after a colon, joined by +),
            or pairs.
        operators: Names, in the order in which combinations are named.
        combos: ``all``, ``pairs``, ``leave-one-out``, or a list
            (:func:`~.variants.choose_combinations`).
        seeds: Number of seeds: each estimate is repeated with the seeds 0 to seeds - 1.
        preset: ``default``, ``dense``, ``paper``, or several.
        vary: Setting -> values; all combinations of them (:func:`~.variants.choose_variants`).
        matchers: Name or import path of the matcher; or operator -> matcher, for some of them.
        backend: Name or import path of the robust estimator; None: the preset's.
        wait: Seconds to wait for the first worker of a Dask cluster, or for another one when all
            are lost; long enough for the queue of a batch system.
        out: Folder of the ablation, which is resumed if it exists; None keeps the table in memory.
        root: Folder of the data sets; None for ``SFMKIT_DATA`` or the folder of fetched data.
        workers: Local processes; None for one per core.
        scheduler: ``tcp://host:port`` of a Dask cluster, used in place of local processes.
        ship: ``path`` if the workers of the cluster see the files of this process (images and
            cache); ``bytes`` to send images to them and receive arrays.
        cache: Folder, or a URL that fsspec opens; None: :func:`~.cache.default_cache`.
        cache_limit: Largest size of the cache, bytes.
        shard: (i, n): only part i of n of the pairs; :func:`sfmkit.ablation.merge.merge_shards`
            merges the folders of all parts.
        progress: Called with a :class:`SweepState`.

    Raises:
        InputError: An argument is invalid, the folder holds another sweep or a running one, no
            scheduler answers, or workers run another version.
        OutputError: The disk is full, or a folder cannot be written. Finished results are kept.
    """
    if not 0 <= wait < math.inf:
        raise InputError(f"wait must be seconds, not {wait}")
    if ship not in ("path", "bytes"):
        raise InputError(f"ship must be 'path' or 'bytes', not {ship!r}")
    if out is None:
        with tempfile.TemporaryDirectory(prefix="sfmkit-ablation-") as made:
            table = ablate(
                data,
                operators,
                combos=combos,
                seeds=seeds,
                preset=preset,
                vary=vary,
                matchers=matchers,
                backend=backend,
                out=made,
                root=root,
                workers=workers,
                scheduler=scheduler,
                ship=ship,
                wait=wait,
                cache=cache,
                cache_limit=cache_limit,
                shard=shard,
                progress=progress,
            )
        return AblationTable(table.data)
    watch: Watcher = progress or (lambda _: None)
    watch(SweepState("plan", what="loading"))
    store = Cache(default_cache() if cache is None else cache, cache_limit)
    store.check(local_workers=scheduler is None)
    folder = SweepFolder(out)
    with folder.locked():
        plan = make_plan(
            data,
            operators,
            combos=combos,
            seeds=seeds,
            presets=(preset,) if isinstance(preset, str) else preset,
            vary=vary,
            matchers=matchers,
            backend=backend,
            root=root,
            cache=store,
            images=folder.images,
            shard=shard,
            say=_planning(watch),
        )
        folder.open(plan)
        store.tidy()
        setup = Setup(
            engine_version(),
            None if ship == "bytes" else store.location,
            plan.plugins,
        )

        def engine() -> Engine:
            return start_engine(setup, workers=workers, scheduler=scheduler, wait_s=wait)

        if ship == "bytes" and scheduler is None:
            raise InputError(
                "ship='bytes' is for a cluster (scheduler=...); local processes see the same files"
            )
        Sweep(plan, folder, store, watch).run(engine)
        rows = sum(len(unit.jobs) for unit in plan.units)
        watch(SweepState("merge", rows, rows, str(folder.path), 0.0))
        return folder.merge(plan)


@dataclass
class Sweep:
    """A running sweep."""

    plan: Plan
    folder: SweepFolder
    cache: Cache
    watch: Watcher
    _results: dict[str, dict[str, Mapping[str, Any] | str]] = field(
        default_factory=dict
    )  # unit -> job -> result
    _numbers: dict[str, int] = field(
        default_factory=dict
    )  # key of an estimate task -> its unit's place in the plan
    _rows_done: int = 0
    _notes: list[str] = field(default_factory=list)
    _spent: float = 0.0  # seconds of workers, and the cost that was expected for the same work
    _expected: float = 0.0
    _left: float = 0.0  # cost of what is still to be done

    def run(self, start: Callable[[], Engine]) -> None:
        """Run the missing tasks; the engine starts only if there are some."""
        total = sum(len(unit.jobs) for unit in self.plan.units)
        self._say("finished before", total)
        missing = []
        for number, unit in enumerate(self.plan.units):
            if self.folder.has(unit):
                self._rows_done += len(unit.jobs)
            elif self._from_cache(unit):
                self._say("from the cache", total)
            else:
                missing.append((number, unit))
        if not missing:
            return
        self._left = self.plan.count(self.cache).seconds
        agenda = Agenda(lambda t: self.cache.has(t.kind, t.key), self._give_up)
        order = iter(missing)

        def feed() -> bool:
            item = next(order, None)
            if item is None:
                return False
            number, unit = item
            self._numbers[unit.key] = number
            known = self._results[unit.key]
            jobs = tuple(job for job in unit.jobs if job.key not in known)
            agenda.want(unit.only(jobs), number)
            return True

        def pack(engine: Engine, task: Task) -> Parcel | None:
            return self._parcel(engine, agenda, task)

        def take(task: Task, outcome: Outcome, slots: int) -> None:
            self._take(agenda, task, outcome)
            self._progress(task, outcome, slots, total)

        drive(agenda, self.cache, start, feed, pack, take)

    def _from_cache(self, unit: EstimateTask) -> bool:
        """Collect the cached results of a unit; return whether its rows could be written."""
        pair = self.plan.pairs[unit.pair]
        known = self._results.setdefault(unit.key, {})
        for job in unit.jobs:
            if pair.failure:
                known[job.key] = pair.failure
            elif (entry := self.cache.get("estimates", job.key, self._notes.append)) is not None:
                known[job.key] = entry.meta
        return self._finish(unit)

    def _finish(self, unit: EstimateTask) -> bool:
        """Write the unit's shard if all of its jobs have a result."""
        known = self._results[unit.key]
        if any(job.key not in known for job in unit.jobs):
            return False
        pair = self.plan.pairs[unit.pair]
        self.folder.write(unit, [make_row(pair, unit, job, known[job.key]) for job in unit.jobs])
        del self._results[unit.key]
        self._rows_done += len(unit.jobs)
        return True

    def _unit(self, task: EstimateTask) -> EstimateTask:
        """The unit that the task is a part of."""
        return self.plan.units[self._numbers[task.key]]

    def _give_up(self, task: EstimateTask, reasons: dict[str, str]) -> None:
        """Record the failure of all combinations that contain a failed operator."""
        unit = self._unit(task)
        for job in task.jobs:
            operator = next((o for o in job.combination if o in reasons), None)
            if operator is not None:
                self._results[unit.key][job.key] = f"{operator}: {reasons[operator]}"
        self._finish(unit)

    def _parcel(self, engine: Engine, agenda: Agenda, task: Task) -> Parcel | None:
        """What is sent with the task; None if a part of it has to be computed again first."""
        if engine.shares_files:
            return Parcel()
        try:
            if isinstance(task, DetectTask):
                return Parcel(images={task.image.digest: Path(task.image.path).read_bytes()})
        except OSError:
            return Parcel()  # the worker reports what is wrong with the image
        inputs, lost = {}, []
        for key, need in all_needs(task).items():
            data = self.cache.get_bytes(need.kind, key)
            try:
                if data is None:
                    raise DamagedEntry("gone")
                Entry.from_bytes(data, key)
                inputs[key] = data
            except DamagedEntry as error:
                self._notes.append(
                    f"cache entry {need.kind}/{key[:12]} is {error}; it is computed again"
                )
                self.cache.drop(need.kind, key)
                lost.append(need)
        if lost:
            agenda.again(task, 0, lost)
            return None
        return Parcel(inputs=inputs)

    def _take(self, agenda: Agenda, task: Task, outcome: Outcome) -> None:
        self._notes += outcome.notes
        if not isinstance(task, EstimateTask):
            if outcome.data is not None:
                self.cache.put_bytes(task.kind, task.key, outcome.data)
            agenda.finished(task, outcome.reason)
            return
        unit = self._unit(task)
        if outcome.status == "failed" and len(task.jobs) > 1:
            # One of the jobs is the cause: run each as a task of its own.
            for k, job in enumerate(task.jobs):
                part = task.only((job,), f"{task.key}.{k}")
                self._numbers[part.key] = self._numbers[task.key]
                agenda.want(part, self._numbers[task.key])
            return
        known = self._results[unit.key]
        for job in task.jobs:
            result = outcome.estimates.get(job.key, outcome.reason)
            known[job.key] = result
            if isinstance(result, dict) and not self.cache.has("estimates", job.key):
                self.cache.put("estimates", Entry(job.key, result))
        agenda.finished(task, outcome.reason)
        self._finish(unit)

    def _progress(self, task: Task, outcome: Outcome, slots: int, total: int) -> None:
        self._spent += outcome.seconds
        self._expected += cost(task)
        self._left = max(self._left - cost(task), 0.0)
        where = f"{self.plan.pairs[task.pair]}: " if isinstance(task, EstimateTask) else ""
        self._say(
            f"{where}{task}", total, self._left * self._spent / max(self._expected, 1e-9) / slots
        )

    def _say(self, what: str, total: int, seconds_left: float | None = None) -> None:
        self.watch(
            SweepState("run", self._rows_done, total, what, seconds_left, tuple(self._notes))
        )
        self._notes.clear()
