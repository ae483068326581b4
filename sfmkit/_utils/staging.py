"""Names of temporary files and folders, and the removal of those that killed processes left."""

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

# place of the process (a digest), its id, a random part, and the suffix, by which some writers
# choose the format
_NAME = re.compile(r"\.sfmkit-([0-9a-f]{8})-([0-9]{1,10})-[0-9a-f]{8}(\.[^.]*)?")
_DAY = 24 * 3600.0  # seconds after which what another boot or machine left counts as abandoned


def staged_name(path: Path) -> Path:
    """A new hidden name in the folder of `path`, and so on the same disk, with its suffix."""
    suffix = path.suffix if len(os.fsencode(path.suffix)) <= 32 else ""
    return path.with_name(f".sfmkit-{_place()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}")


def remove_stale(folder: Path) -> None:
    """Remove what killed processes of sfmkit have left in `folder`; once per process and folder.

    Removed are entries with a name of :func:`staged_name` whose process is gone. Process ids mean
    something only within one boot and one container: entries of other places are removed when they
    have not been changed for a day.
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
    """Digest of what process ids are valid in: the boot, and the container where there is one."""
    parts = [os.uname().nodename if hasattr(os, "uname") else os.environ.get("COMPUTERNAME", "")]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text())
    with suppress(OSError):
        parts.append(os.readlink("/proc/self/ns/pid"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:8]
