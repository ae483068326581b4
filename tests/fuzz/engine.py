"""Run inputs one by one in a child process, and judge how each ends.

An input must be accepted, or refused with an SfmError that has a message. Findings are: any other
exception, more than 10 seconds of processor time (a minute of waiting), 2 GB more memory than at
the start, a crash of the process, and a file opened for writing outside the scratch folder.
"""

from __future__ import annotations

import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

LIMIT_S = 10.0  # of processor time, so that a busy machine makes no findings
WAIT_S = 60.0  # for an input that waits instead of computing
MEMORY = 2 << 30  # bytes
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class Kind:
    """One kind of input.

    Attributes:
        name: for the command line and in files.
        seeds: makes valid inputs; it may use the folder that it is given.
        mutate: makes an input from the seeds.
        run: reads an input; files belong into the folder that it is given.
    """

    name: str
    seeds: Callable[[Path], list[bytes]]
    mutate: Callable[[Random, list[bytes]], bytes]
    run: Callable[[bytes, Path], None]


@dataclass(frozen=True)
class Ending:
    """How one input ended: ``accepted``, ``refused``, or a finding with its details."""

    number: int
    outcome: str
    details: str = ""

    @property
    def is_finding(self) -> bool:
        return self.outcome not in ("accepted", "refused")


class _Hang(BaseException):
    pass


def write(path: Path, data: bytes) -> Path:
    """Write an input to a file."""
    path.write_bytes(data)
    return path


def make_input(kind: Kind, number: int, seeds: list[bytes]) -> bytes:
    """The input with this number; the first ones are the seeds themselves."""
    if number < len(seeds):
        return seeds[number]
    return kind.mutate(Random(f"{kind.name}-{number}"), seeds)


@cache
def seeds_of(kind: Kind) -> list[bytes]:
    """The valid inputs of a kind."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        return kind.seeds(Path(folder))


def endings(kind: Kind, numbers: range) -> Iterator[Ending]:
    """Run the inputs with these numbers; a child process that dies is replaced."""
    seeds = seeds_of(kind)
    scratch = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        todo = list(numbers)
        while todo:
            for ending in _in_child(kind, todo, seeds, scratch):
                todo = todo[todo.index(ending.number) + 1 :]
                yield ending
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _in_child(kind: Kind, todo: list[int], seeds: list[bytes], scratch: Path) -> Iterator[Ending]:
    theirs, ours = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(theirs)
            _serve(kind, todo, seeds, scratch, ours)
        finally:
            os._exit(0)
    os.close(ours)
    number = todo[0]
    with os.fdopen(theirs, "rb", buffering=0) as stream:
        text = b""
        while True:
            ready, _, _ = select.select([stream], [], [], WAIT_S + 20)
            block = os.read(stream.fileno(), 1 << 16) if ready else b""
            if not block:
                break
            text += block
            *lines, text = text.split(b"\n")
            for line in lines:
                ending = Ending(*json.loads(line))
                number = ending.number + 1
                yield ending
    if not ready:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if number <= todo[-1]:
        code = os.waitstatus_to_exitcode(status)
        yield Ending(number, "hang" if not ready else "crash", f"exit status {code}")


def _serve(kind: Kind, todo: list[int], seeds: list[bytes], scratch: Path, answers: int) -> None:
    """The child: run each input in a folder of its own, under the limits."""
    import faulthandler

    import torch

    faulthandler.disable()  # pytest enables it; a crash is reported by the parent
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)  # libraries complain about damaged files
    written: list[str] = []
    inside = str(scratch) + os.sep

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], (str, bytes)) and arguments[2] & _WRITES:
            path = os.path.abspath(os.fsdecode(arguments[0]))
            if not path.startswith(inside) and path != os.devnull:
                written.append(path)

    def hang(*_: Any) -> None:
        raise _Hang

    signal.signal(signal.SIGALRM, hang)
    signal.signal(signal.SIGPROF, hang)
    folder = scratch / "run"
    tempfile.tempdir = str(folder)
    sys.addaudithook(watch)
    for number in todo:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        os.chdir(folder)
        outcome, details = _judge(kind, make_input(kind, number, seeds), folder)
        if written:
            outcome, details = "wrote outside", ", ".join(written)
            written.clear()
        os.write(answers, json.dumps([number, outcome, details[-3000:]]).encode() + b"\n")


def _judge(kind: Kind, data: bytes, folder: Path) -> tuple[str, str]:
    from sfmkit.errors import SfmError

    _limit(LIMIT_S, WAIT_S)
    try:
        kind.run(data, folder)
    except SfmError as error:
        _limit(0, 0)
        return ("refused", "") if str(error).strip() else ("no message", repr(error))
    except _Hang:
        return "hang", traceback.format_exc()
    except MemoryError:
        return "memory", traceback.format_exc()
    except BaseException as error:
        _limit(0, 0)
        return type(error).__name__, traceback.format_exc()
    finally:
        _limit(0, 0)
    return "accepted", ""


def _limit(computing: float, waiting: float) -> None:
    signal.setitimer(signal.ITIMER_PROF, computing)
    signal.setitimer(signal.ITIMER_REAL, waiting)
