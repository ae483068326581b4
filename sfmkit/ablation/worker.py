"""Workers: run a task on one thread and return its outcome.

:func:`perform` runs in local processes and on a Dask cluster. :func:`main` is the program of a
local process: it reads tasks from its input and writes outcomes to its output until the input ends,
also because the parent process was killed.
"""

from __future__ import annotations

import os
import pickle
import platform
import struct
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any, BinaryIO, Literal

from .._utils.machine import processor
from ..errors import OutputError
from .cache import Cache
from .entry import Entry
from .plugins import PlugIn, load_plugins
from .stages import Store, estimate_combination
from .tasks import EstimateTask, Job, Task
from .version import engine_version, versions

_busy = (
    threading.Lock()
)  # OpenCV's random numbers and the peak of the memory are those of the process
_kept: OrderedDict[str, Entry] = OrderedDict()


@dataclass(frozen=True)
class Setup:
    """What a worker needs besides its task.

    Attributes:
        version: :func:`~.version.engine_version` of the planning process.
        cache: Folder or URL that all workers see; None if they share no files and results are
            returned as bytes.
        plugins: Plug-ins that every worker loads.
    """

    version: str
    cache: str | None
    plugins: tuple[PlugIn, ...] = ()


@dataclass(frozen=True)
class Parcel:
    """The bytes that are sent with a task if files are not shared.

    Attributes:
        images: Digest of an image -> the bytes of its file.
        inputs: Key of a result -> its bytes.
    """

    images: Mapping[str, bytes] = field(default_factory=dict)
    inputs: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task.

    Attributes:
        status: ``done``; ``failed`` for this task only; ``full`` if nothing can be written;
            ``refused`` by a worker of another version.
        reason: The reason of a failure.
        seconds: Wall time.
        estimates: Key of a job -> its result, or the reason of its failure as text.
        data: The bytes of the result, if files are not shared.
        notes: Warnings for the user.
        machine: The machine of the worker.
    """

    status: Literal["done", "failed", "full", "refused"]
    reason: str = ""
    seconds: float = 0.0
    estimates: Mapping[str, dict[str, Any] | str] = field(default_factory=dict)
    data: bytes | None = None
    notes: tuple[str, ...] = ()
    machine: str = ""


def perform(task: Task, setup: Setup, parcel: Parcel | None = None) -> Outcome:
    """Run a task; an exception becomes an outcome."""
    began = time.perf_counter()
    if setup.version != engine_version():
        return Outcome(
            "refused",
            f"the worker on {platform.node()} runs {engine_version()}, this sweep was planned by "
            f"{setup.version}; install the same version everywhere",
        )
    if problem := load_plugins(setup.plugins):
        return Outcome("refused", f"the worker on {platform.node()}: {problem}")
    parcel = parcel or Parcel()
    notes: list[str] = []
    with _busy:
        one_thread()
        store = Store(
            Cache(setup.cache) if setup.cache else None,
            parcel.inputs,
            parcel.images,
            notes.append,
            kept=_kept,
        )
        estimates: dict[str, dict[str, Any] | str] = {}
        data = None
        try:
            if isinstance(task, EstimateTask):
                estimates = _estimate(task, store)
            else:
                entry = store.result(task)
                data = None if setup.cache else entry.to_bytes()
        except OutputError as error:
            return Outcome("full", str(error))
        except Exception as error:
            return Outcome(
                "failed", reason_of(error), time.perf_counter() - began, machine=machine()
            )
    return Outcome(
        "done", "", time.perf_counter() - began, estimates, data, tuple(notes), machine()
    )


def _estimate(task: EstimateTask, store: Store) -> dict[str, dict[str, Any] | str]:
    """Run the jobs of a task and store each result in the cache at once."""
    found: dict[str, dict[str, Any] | str] = {}
    by_combination: dict[tuple[str, ...], list[Job]] = {}
    for job in task.jobs:
        entry = None if store.cache is None else store.cache.get("estimates", job.key, store.say)
        if entry is None:
            by_combination.setdefault(job.combination, []).append(job)
        else:
            found[job.key] = dict(entry.meta)
    for combination, jobs in by_combination.items():
        try:
            for entry in estimate_combination(task, combination, jobs, store):
                found[entry.key] = {**entry.meta, "machine": machine(), "versions": versions()}
                if store.cache is not None:
                    store.cache.put("estimates", Entry(entry.key, found[entry.key]))  # type: ignore[arg-type]
        except OutputError:
            raise
        except Exception as error:
            found |= {job.key: reason_of(error) for job in jobs if job.key not in found}
    return found


def reason_of(error: BaseException) -> str:
    """Describe an exception in one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def one_thread() -> None:
    """Let OpenCV and torch use one thread.

    This is called before every task, because torch's setting belongs to the calling thread.
    """
    import cv2
    import torch

    cv2.setNumThreads(1)
    torch.set_num_threads(1)


@cache
def machine() -> str:
    """Describe processor, cores, system and Python in one line."""
    return (
        f"{processor()}, {os.cpu_count()} cores, {platform.system()}, Python "
        f"{platform.python_version()}"
    )


_LENGTH = struct.Struct("!Q")


def send(stream: BinaryIO, message: Any) -> None:
    """Write a message."""
    data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def receive(stream: BinaryIO) -> Any:
    """Read the next message.

    Raises:
        EOFError: The stream has ended.
    """
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    (length,) = _LENGTH.unpack(head)
    data = stream.read(length)
    if len(data) < length:
        raise EOFError
    return pickle.loads(data)


def _end_with_parent(parent: int) -> None:
    """End this process, also during a task, when the parent has ended.

    Otherwise the task would compete with the next sweep for the processor.
    """
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def main() -> None:
    """Run tasks from the standard input until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # The output of libraries must not mix with the outcomes.
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    with suppress(EOFError, BrokenPipeError):
        while True:
            task, setup = receive(sys.stdin.buffer)
            send(answers, perform(task, setup))
