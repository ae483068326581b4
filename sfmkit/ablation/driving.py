"""The loop that gives ready tasks to an engine and takes their outcomes."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import InputError, OutputError
from .cache import Cache
from .engines import Engine
from .scheduling import Agenda
from .tasks import Task
from .worker import Outcome, Parcel

__all__ = ["drive"]

_TIDY_EVERY = 500  # outcomes


def drive(
    agenda: Agenda,
    cache: Cache,
    start: Callable[[], Engine],
    feed: Callable[[], bool],
    pack: Callable[[Engine, Task], Parcel | None],
    take: Callable[[Task, Outcome, int], None],
) -> None:
    """Run tasks until there are no more.

    Tasks are added when a worker is free, so a long list is never in memory. The engine is started
    for the first task, and closed in any case.

    Args:
        agenda: The tasks that wait for others, or are ready.
        cache: Its size is kept within the limit.
        start: Starts the engine.
        feed: Adds the next task to the agenda; returns False if there is none.
        pack: Returns what is sent with a task; None if a part of it has to be computed again first.
        take: Called with a task, its outcome and the number of slots of the engine.

    Raises:
        InputError: A worker runs another version.
        OutputError: The disk is full. The finished results are kept.
    """
    engine: Engine | None = None
    running = outcomes = 0
    try:
        while True:
            while running < (slots := 1 if engine is None else engine.slots):
                while len(agenda) < slots and feed():
                    pass
                if not len(agenda):
                    break
                if engine is None:
                    engine = start()
                task = agenda.pop()
                parcel = pack(engine, task)
                if parcel is not None:
                    engine.submit(task, parcel)
                    running += 1
            if engine is None or not running:
                break
            task, outcome = engine.next()
            running -= 1
            outcomes += 1
            if outcome.status == "full":
                raise OutputError(outcome.reason)
            if outcome.status == "refused":
                raise InputError(outcome.reason)
            take(task, outcome, engine.slots)
            if outcomes % _TIDY_EVERY == 0:
                cache.tidy()
    finally:
        if engine is not None:
            engine.close()
    cache.tidy()
