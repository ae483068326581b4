"""Engines: local processes or a Dask cluster behind one interface.

The local processes do not use an executor of concurrent.futures or loky. Such an executor fails as
a whole when one worker is killed: all running tasks are lost, and the task that caused the failure
is unknown. Here only the task of the dead worker is lost. The processes also start from a script or
a notebook without a guarded ``__main__``, and end when the parent is killed, because their input is
closed.
"""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from ..errors import InputError
from .tasks import Task
from .worker import Outcome, Parcel, Setup, reason_of, receive, send

ATTEMPTS = 3  # per task, if its workers die


class Engine(Protocol):
    """Runs tasks and returns their outcomes in any order.

    Attributes:
        shares_files: Whether workers see the files of this process.
    """

    shares_files: bool

    @property
    def slots(self) -> int:
        """The number of tasks that it should hold at a time."""
        ...

    def submit(self, task: Task, parcel: Parcel) -> None:
        """Add a task with what is sent with it."""
        ...

    def next(self) -> tuple[Task, Outcome]:
        """Wait for the next outcome."""
        ...

    def close(self) -> None:
        """Stop the workers; running tasks are lost."""
        ...


class LocalEngine:
    """Processes of this machine with one thread each, started for their first task.

    Args:
        workers: Number of processes.
        setup: What they need.

    Raises:
        InputError: `workers` is less than 1.
    """

    shares_files = True

    def __init__(self, workers: int, setup: Setup):
        if workers < 1:
            raise InputError(f"workers must be at least 1, not {workers}")
        self._setup = setup
        self._tasks: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[tuple[Task, Outcome]] = queue.SimpleQueue()
        self._processes: list[subprocess.Popen | None] = [None] * workers
        self._closing = False
        self._threads = [
            threading.Thread(target=self._serve, args=(k,), daemon=True) for k in range(workers)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def slots(self) -> int:
        return len(self._threads)

    @property
    def pids(self) -> list[int]:
        """The process ids of the running workers."""
        return [p.pid for p in self._processes if p is not None]

    def submit(self, task: Task, parcel: Parcel) -> None:
        self._tasks.put(task)

    def next(self) -> tuple[Task, Outcome]:
        return self._done.get()

    def close(self) -> None:
        self._closing = True
        for _ in self._threads:
            self._tasks.put(None)
        for process in self._processes:
            if process is not None:
                process.kill()
        for thread in self._threads:
            thread.join(timeout=10)

    def _serve(self, k: int) -> None:
        """Send tasks to worker k and collect its outcomes; replace the worker if it dies."""
        while (task := self._tasks.get()) is not None:
            outcome = None
            for _ in range(ATTEMPTS):
                process = self._processes[k] or self._start(k)
                assert process.stdin is not None
                assert process.stdout is not None
                try:
                    send(process.stdin, (task, self._setup))  # type: ignore[arg-type]
                    outcome = receive(process.stdout)  # type: ignore[arg-type]
                    break
                except (EOFError, OSError):
                    self._stop(k)
                    if self._closing:
                        return
                except Exception as error:  # task or outcome cannot be pickled
                    outcome = Outcome("failed", reason_of(error))
                    self._stop(k)
                    break
            self._done.put((task, outcome or died()))
        self._stop(k)

    def _start(self, k: int) -> subprocess.Popen:
        # The search path of this process, so that a worker finds the same plug-ins.
        root = Path(__file__).parent.parent.parent
        path = os.pathsep.join([str(root), *(os.path.abspath(folder) for folder in sys.path)])
        process = subprocess.Popen(
            [sys.executable, "-c", "from sfmkit.ablation.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C must reach the parent only
        )
        self._processes[k] = process
        return process

    def _stop(self, k: int) -> None:
        process, self._processes[k] = self._processes[k], None
        if process is None:
            return
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):
                stream and stream.close()
        process.kill()
        process.wait()


def died() -> Outcome:
    """The outcome of a task whose workers died."""
    return Outcome(
        "failed", f"the worker died {ATTEMPTS} times at this task (killed, or out of memory)"
    )
