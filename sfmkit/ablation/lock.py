"""The lock that keeps a sweep's folder to one process."""

from __future__ import annotations

import json
import os
import platform
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from .._utils.writing import atomic_write
from ..errors import InputError

LOCK, HOLDER = ".lock", ".lock.json"
HEARTBEAT_S = 10.0  # between two signs of life of a holder
STALE_S = 60.0  # without a sign of life: six missed heartbeats
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class Holder:
    """The process that holds a lock.

    Attributes:
        pid, host: For messages.
        boot: Identifies the running kernel, whose file locks are reliable among its processes.
    """

    pid: int
    host: str
    boot: str

    @classmethod
    def here(cls) -> Holder:
        """This process."""
        try:
            boot = _BOOT_ID.read_text().strip()
        except OSError:  # not Linux
            boot = platform.node()
        return cls(os.getpid(), platform.node(), boot)

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep `folder` to this process.

    The system releases a file lock when its holder ends, in whatever way, so on one machine a lock
    that can be acquired is free. File locks may not reach the other hosts of a shared file system:
    there the holder's file must be older than :data:`STALE_S`, which a running holder prevents by
    touching it every :data:`HEARTBEAT_S`.

    Raises:
        InputError: Another process holds the folder.
    """
    file = folder / HOLDER
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise InputError(_busy(folder, read_holder(file))) from None
    try:
        holder, me = read_holder(file), Holder.here()
        age = _age(file)
        if age is not None and age < STALE_S and (holder is None or holder.boot != me.boot):
            raise InputError(
                f"{_busy(folder, holder)} Its last sign of life is {age:.0f} s old; if it was "
                f"killed, the folder is free {STALE_S:.0f} s after it"
            )
        with atomic_write(file) as temporary:
            temporary.write_text(json.dumps(asdict(me)), encoding="utf-8")
        try:
            with _heartbeat(file):
                yield
        finally:
            with suppress(OSError):
                file.unlink()
    finally:
        lock.release()


def read_holder(file: Path) -> Holder | None:
    """Read who holds a lock; None where the file is missing or damaged."""
    try:
        found: Any = json.loads(file.read_text(encoding="utf-8"))
        return Holder(int(found["pid"]), str(found["host"]), str(found["boot"]))
    except (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None


def _age(file: Path) -> float | None:
    """Seconds since the file was touched, by the clock of its file system; None without a file."""
    probe = file.with_suffix(".now")
    try:
        touched = file.stat().st_mtime
        probe.touch()
        return max(probe.stat().st_mtime - touched, 0.0)
    except OSError:
        return None
    finally:
        with suppress(OSError):
            probe.unlink()


@contextmanager
def _heartbeat(file: Path) -> Iterator[None]:
    """Touch a file every :data:`HEARTBEAT_S`."""
    done = threading.Event()

    def beat() -> None:
        while not done.wait(HEARTBEAT_S):
            with suppress(OSError):
                os.utime(file)

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def _busy(folder: Path, holder: Holder | None) -> str:
    who = str(holder) if holder else "another process"
    return f"a sweep is running in {folder} ({who}); wait for it, or choose another --out."
