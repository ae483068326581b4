"""Names of temporary files and folders, and removal of stale ones."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import shutil
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

__all__ = ["remove_stale", "staged_name"]

# The parts are a digest of the place of the process, its id, a random part, and the suffix, from
# which some writers choose the format.
_NAME = re.compile(r"\.sfmkit-([0-9a-f]{8})-([0-9]{1,10})-[0-9a-f]{8}(\.[^.]*)?")
_DAY = 24 * 3600.0  # seconds after which the files of another boot or machine are abandoned


def staged_name(path: Path) -> Path:
    """Return a new hidden name with the folder and suffix of `path`.

    The same folder ensures that the file is on the same disk.
    """
    suffix = path.suffix if len(os.fsencode(path.suffix)) <= 32 else ""
    return path.with_name(f".sfmkit-{_place()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}")


def remove_stale(folder: Path) -> None:
    """Remove the temporary files that killed processes of sfmkit have left in `folder`.

    This happens once per process and folder. Entries with a name of :func:`staged_name` are removed
    if their process has ended. Process ids are valid only within one boot and one container;
    entries from elsewhere are removed if they have not changed for a day.
    """
    _remove_stale_once(os.path.abspath(folder), os.getpid())


@cache
def _remove_stale_once(folder: str, _process: int) -> None:
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if _abandoned(entry):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    with suppress(OSError):
                        os.unlink(entry.path)


def _abandoned(entry: os.DirEntry) -> bool:
    parts = _NAME.fullmatch(entry.name)
    if parts is None or entry.is_symlink():
        return False
    if parts[1] == _place():
        return not _runs(int(parts[2]))
    try:
        return time.time() - entry.stat(follow_symlinks=False).st_mtime > _DAY
    except OSError:
        return False


def _runs(process: int) -> bool:
    if os.name != "posix":
        return True  # signal 0 would end the process on Windows
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


@cache
def _place() -> str:
    """Return a digest of the scope of process ids: the machine, the boot and the container."""
    parts = [os.uname().nodename if hasattr(os, "uname") else os.environ.get("COMPUTERNAME", "")]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text())
    with suppress(OSError):
        parts.append(os.readlink("/proc/self/ns/pid"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:8]
