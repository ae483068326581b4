"""The order of the tasks: each once, after its inputs, pair by pair as in the plan."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

from .tasks import DetectTask, EstimateTask, MatchTask, Task


def all_needs(task: Task) -> dict[str, Task]:
    """Return what a worker reads for a task, by key.

    For an estimate these are the matches and the features that they index.
    """
    needs: dict[str, Task] = {t.key: t for t in task.needs}
    if isinstance(task, EstimateTask):
        needs |= {t.key: t for match in task.needs for t in match.needs}
    return needs


@dataclass
class Agenda:
    """Tasks that wait for their inputs, and tasks that are ready.

    If a task fails, only the tasks that need it fail: an estimate continues with the remaining
    combinations.

    Args:
        is_there: Returns whether the result of a task exists.
        give_up: Called with an estimate task and operator -> reason, if some of its jobs cannot be
            run.
    """

    is_there: Callable[[Task], bool]
    give_up: Callable[[EstimateTask, dict[str, str]], None]
    failed: dict[str, str] = field(default_factory=dict)
    _there: set[str] = field(default_factory=set)
    _waiting: dict[str, tuple[Task, int, set[str]]] = field(default_factory=dict)
    _dependents: dict[str, list[str]] = field(default_factory=dict)
    _under_way: set[str] = field(default_factory=set)
    _ready: list[tuple[int, int, int, Task]] = field(default_factory=list)
    _number: itertools.count = field(default_factory=itertools.count)

    def __len__(self) -> int:
        """The number of ready tasks."""
        return len(self._ready)

    def want(self, task: Task, priority: int) -> bool:
        """Add a task unless its result exists; return whether it exists or cannot be computed.

        A task that was added before is not added again.
        """
        if task.key in self._there or task.key in self.failed:
            return True
        if task.key in self._waiting or task.key in self._under_way:
            return False
        if not isinstance(task, EstimateTask) and self.is_there(task):
            self._there.add(task.key)
            return True
        missing = {key for key, need in all_needs(task).items() if not self.want(need, priority)}
        self._waiting[task.key] = (task, priority, missing)
        for key in missing:
            self._dependents.setdefault(key, []).append(task.key)
        if not missing:
            self._release(task.key)
        return task.key in self.failed

    def pop(self) -> Task:
        """Remove and return the first ready task."""
        *_, task = heapq.heappop(self._ready)
        return task

    def again(self, task: Task, priority: int, lost: list[Task]) -> None:
        """Add a task again because inputs of it have been removed from the cache."""
        self._under_way.discard(task.key)
        for need in lost:
            self._there.discard(need.key)
        self.want(task, priority)

    def finished(self, task: Task, failure: str = "") -> None:
        """Record that a task is finished, or failed for a reason."""
        self._under_way.discard(task.key)
        self._settle(task.key, failure)

    def _settle(self, key: str, failure: str) -> None:
        if failure:
            self.failed[key] = failure
        else:
            self._there.add(key)
        for name in self._dependents.pop(key, []):
            missing = self._waiting[name][2]
            missing.discard(key)
            if not missing:
                self._release(name)

    def _release(self, key: str) -> None:
        """Make a task ready whose inputs all exist or have failed."""
        task, priority, _ = self._waiting.pop(key)
        if isinstance(task, EstimateTask):
            reasons = {
                o: self.failed[m.key] for o, m in task.matches.items() if m.key in self.failed
            }
            if reasons:
                self.give_up(task, reasons)
                jobs = tuple(job for job in task.jobs if not reasons.keys() & set(job.combination))
                if not jobs:
                    return
                task = task.only(jobs)
        elif reason := next((self.failed[t.key] for t in task.needs if t.key in self.failed), ""):
            self._settle(key, reason)
            return
        rank = 0 if isinstance(task, DetectTask) else 1 if isinstance(task, MatchTask) else 2
        self._under_way.add(task.key)
        heapq.heappush(self._ready, (priority, rank, next(self._number), task))
