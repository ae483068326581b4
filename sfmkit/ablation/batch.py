"""Run a list of tasks; cached results are not computed again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from .cache import Cache
from .driving import drive
from .engines import Engine
from .plan import cost
from .scheduling import Agenda
from .tasks import EstimateTask, Task
from .worker import Outcome, Parcel

__all__ = ["BatchState", "run_batch"]


@dataclass(frozen=True)
class BatchState:
    """The progress of a batch.

    Attributes:
        done, total: Tasks of the list.
        what: The task that was done last.
        seconds_left: Estimate; None while nothing has been measured.
        notes: Messages for the user since the last state.
    """

    done: int
    total: int
    what: str = ""
    seconds_left: float | None = None
    notes: tuple[str, ...] = ()


@dataclass
class _Clock:
    """The time left, from rough costs and the measured seconds of the finished tasks."""

    left: float
    slots: int = 1
    spent: float = 0.0
    expected: float = 0.0
    counted: set[str] = field(default_factory=set)

    def passed(self, task: Task, seconds: float | None) -> None:
        """Count a task that took some seconds, or was in the cache (None)."""
        if task.key in self.counted:
            return
        self.counted.add(task.key)
        self.left = max(self.left - cost(task), 0.0)
        if seconds is None:
            for need in task.needs:
                self.passed(need, None)
        else:
            self.spent += seconds
            self.expected += cost(task)

    @property
    def seconds_left(self) -> float | None:
        if not self.expected:
            return None
        return self.left * self.spent / self.expected / self.slots


def run_batch(
    tasks: Iterator[Task],
    total: int,
    seconds: float,
    cache: Cache,
    start: Callable[[], Engine],
    watch: Callable[[BatchState], None],
) -> dict[str, str]:
    """Run tasks and what they need, each once.

    The results are in the cache. The tasks are drawn from the iterator when a worker is free, so a
    long list is never in memory.

    Args:
        tasks: Tasks without estimates of sweeps.
        total: Their number.
        seconds: Rough cost of all of them and of what they need, by
            :func:`sfmkit.ablation.plan.cost`.
        cache: That all workers see.
        start: Makes the engine; called when there is something to do.
        watch: Called with the progress.

    Returns:
        Key of a task that failed -> reason.

    Raises:
        InputError: A worker runs another version.
        OutputError: The disk is full. What was done is kept.
    """
    clock = _Clock(seconds)
    done = 0

    def is_there(task: Task) -> bool:
        found = cache.has(task.kind, task.key)
        if found:
            clock.passed(task, None)
        return found

    agenda = Agenda(is_there, _no_estimates)
    wanted: set[str] = set()  # keys of tasks of the list that are not finished

    def feed() -> bool:
        nonlocal done
        task = next(tasks, None)
        if task is None:
            return False
        if agenda.want(task, done + len(wanted)):
            done += 1
            watch(BatchState(done, total, str(task), clock.seconds_left))
        else:
            wanted.add(task.key)
        return True

    def take(task: Task, outcome: Outcome, slots: int) -> None:
        nonlocal done, wanted
        agenda.finished(task, outcome.reason)
        clock.slots = slots
        clock.passed(task, outcome.seconds)
        settled = {key for key in wanted if key in agenda.failed or key == task.key}
        wanted -= settled
        done += len(settled)
        watch(BatchState(done, total, str(task), clock.seconds_left, outcome.notes))

    drive(agenda, cache, start, feed, lambda engine, task: Parcel(), take)
    return agenda.failed


def _no_estimates(task: EstimateTask, reasons: dict[str, str]) -> None:
    raise AssertionError("a batch has no estimates of sweeps")
