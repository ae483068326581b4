"""Where the work is done: processes of this machine, or a Dask cluster, behind one small interface.

Local processes are our own few lines and not an executor of concurrent.futures or loky. Those break
as a whole when one
worker is killed: every task under way is lost, and none of them can be told from the one that
brought it about. Here a worker that dies takes only its own task with it. They also start from a
plain script or a notebook without a guarded ``__main__``, and end by themselves when the parent is
killed, because their input does.
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

ATTEMPTS = 3  # at a task, when workers die of it


class Engine(Protocol):
    """Takes tasks and gives outcomes back, in any order."""

    shares_files: bool

    @property
    def slots(self) -> int:
        """How many tasks it wants to hold at once."""
        ...

    def submit(self, task: Task, parcel: Parcel) -> None: ...

    def next(self) -> tuple[Task, Outcome]:
        """The next outcome; waits for it."""
        ...

    def close(self) -> None: ...


class LocalEngine:
    """Processes of this machine, one thread each. They start when there is something to do."""

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
        """The workers that run."""
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
        """One worker's side of the conversation; a dead one is replaced, and its task tried
        again."""
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
                except (
                    Exception
                ) as error:  # neither task nor outcome could be told; nobody must wait for it
                    outcome = Outcome("failed", reason_of(error))
                    self._stop(k)
                    break
            self._done.put((task, outcome or died()))
        self._stop(k)

    def _start(self, k: int) -> subprocess.Popen:
        # this process's own search path, so that a worker finds the same plug-ins
        root = Path(__file__).parent.parent.parent
        path = os.pathsep.join([str(root), *(os.path.abspath(folder) for folder in sys.path)])
        process = subprocess.Popen(
            [sys.executable, "-c", "from sfmkit.ablation.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C is for the parent
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
    return Outcome(
        "failed", f"the worker died {ATTEMPTS} times at this task (killed, or out of memory)"
    )
