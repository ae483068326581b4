"""Atomic writing of files and folders."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import OutputError
from .staging import remove_stale, staged_name

__all__ = ["atomic_write", "check_file", "check_folder", "check_free", "staged_folder"]

_LEAST_SPACE = 8 << 20  # bytes; the pictures and the recording of a small pair take 2 to 5 MB


@contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[Path]:
    """Write a file under a temporary name next to `path`, and rename it when it is complete.

    After any failure, including Ctrl-C, the previous file at `path` is unchanged and there is no
    temporary file.

    Yields:
        The temporary path to write to; an empty file.

    Raises:
        OutputError: The folder does not exist or cannot be written, `path` is a folder, or the disk
            is full.
    """
    path = Path(path)
    _check_name(path)
    if os.path.isdir(path):
        raise OutputError(f"{path} is a folder; name a file to write")
    temporary = staged_name(path)
    try:
        remove_stale(path.parent)
        temporary.open("xb").close()
        yield temporary
        _sync(temporary)
        temporary.replace(path)
    except OSError as error:
        raise _output_error(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def staged_folder(path: str | os.PathLike, overwrite: bool = False) -> Iterator[Path]:
    """Fill a folder under a hidden name next to `path`, and rename it when it is complete.

    After any failure, including Ctrl-C, the previous folder at `path` is unchanged and there is no
    temporary folder. Missing parents are created, and removed again after a failure.

    Args:
        path: The final folder.
        overwrite: Whether to replace the folder at `path`; otherwise, an existing folder is
            rejected before anything is written.

    Yields:
        The temporary folder to write into.

    Raises:
        OutputError: `path` exists and `overwrite` is not set, or is a file; it cannot be written;
            or the disk is full.
    """
    path = Path(os.path.abspath(path))  # not resolved: a link is replaced, not what it points to
    _check_name(path)
    _check_taken(path, overwrite)
    made = [parent for parent in path.parents if not os.path.lexists(parent)]  # innermost first
    staged = staged_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale(path.parent)
        staged.mkdir()
        yield staged
        for file in staged.rglob("*"):
            if file.is_file():
                _sync(file)
        _move_folder(staged, path, overwrite)
        made = []
    except OSError as error:
        raise _output_error(path, error) from error
    finally:
        shutil.rmtree(staged, ignore_errors=True)
        for parent in made:
            with suppress(OSError):  # it was not created, or is not empty any more
                parent.rmdir()


def check_free(path: Path, overwrite: bool) -> None:
    """Check before the work that a folder can be written to `path` by :func:`staged_folder`.

    The nearest existing parent folder must be writable and have 8 MiB of free space. This is tested
    by creating and removing a hidden folder there.

    Raises:
        OutputError: `path` exists and `overwrite` is not set, is a file, or contains the working
            folder; it cannot be written; its name is too long; or the disk is full.
    """
    path = Path(os.path.abspath(path))
    _check_name(path)
    _check_taken(path, overwrite)
    _check_room(path, next(p for p in path.parents if os.path.lexists(p)))


def check_folder(path: str | os.PathLike) -> None:
    """Check before the work that files can be added to a folder, which need not exist yet.

    Raises:
        OutputError: `path` is a file; it cannot be written; its name is too long; or the disk is
            full. See :func:`check_free`.
    """
    path = Path(os.path.abspath(path))
    _check_name(path)
    if os.path.lexists(path) and not path.is_dir():
        raise OutputError(f"{path} is a file; choose a folder to write to")
    _check_room(path, next(p for p in (path, *path.parents) if os.path.lexists(p)))


def check_file(path: str | os.PathLike) -> None:
    """Check before the work that :func:`atomic_write` can write a file.

    Raises:
        OutputError: Its folder does not exist or cannot be written, `path` is a folder, its name is
            too long, or the disk is full.
    """
    path = Path(os.path.abspath(path))
    _check_name(path)
    if path.is_dir():
        raise OutputError(f"{path} is a folder; name a file to write")
    if not os.path.lexists(path.parent):
        raise OutputError(f"{path} cannot be written: there is no folder {path.parent}")
    _check_room(path, path.parent)


def _check_room(path: Path, parent: Path) -> None:
    """Check that a file or folder can be created in `parent`, an existing parent of `path`."""
    if not parent.is_dir():
        raise OutputError(f"{path} cannot be written: {parent} is not a folder")
    trial = staged_name(parent / "trial")
    try:
        remove_stale(parent)
        trial.mkdir()
        trial.rmdir()
        left = shutil.disk_usage(parent).free
    except OSError as error:
        raise _output_error(path, error) from error
    if left < _LEAST_SPACE:
        raise OutputError(
            f"{path} cannot be written: {left / 2**20:.1f} MiB are left on the disk, "
            f"at least {_LEAST_SPACE >> 20} are needed"
        )


def _check_taken(path: Path, overwrite: bool) -> None:
    if os.path.isdir(path):
        if not overwrite:
            raise OutputError(
                f"the folder {path} exists; choose another with --out, or replace it with "
                "--overwrite"
            )
        if path in (Path.cwd(), *Path.cwd().parents):
            raise OutputError(
                f"{path} contains the working folder and cannot be replaced; choose a folder below "
                "it"
            )
    elif os.path.lexists(path):
        raise OutputError(f"{path} is a file; choose a folder to write to")


def _check_name(path: Path) -> None:
    """Raise OutputError for names that no file system supports and that cannot be looked up."""
    try:
        encoded = [os.fsencode(part) for part in path.parts]
    except UnicodeEncodeError as error:
        raise OutputError(f"{str(path)!r} cannot be written: {error.reason}") from error
    if any(b"\0" in part for part in encoded):
        raise OutputError(f"{str(path)!r} cannot be written: a name must not hold a zero byte")
    longest = max(encoded, key=len, default=b"")
    if len(os.fsencode(path)) > 4000:  # PATH_MAX is 4096, and files are written below it
        raise OutputError(f"the path {str(path)[:40]}... cannot be written: it is too long")
    if len(longest) > 255:  # NAME_MAX of the file systems in use
        name = os.fsdecode(longest[:40])
        raise OutputError(
            f"the name {name}... cannot be written: it has {len(longest)} bytes, at most 255 fit"
        )


def _move_folder(staged: Path, path: Path, overwrite: bool) -> None:
    """Move `staged` to `path`.

    An existing folder is renamed first, because a folder cannot be renamed to an existing one.
    """
    if not path.exists():
        staged.rename(path)
        return
    if not overwrite:
        raise OutputError(
            f"another program has created the folder {path} in the meantime; choose another, or "
            "use --overwrite"
        )
    old = staged_name(path)
    try:
        path.rename(old)
        staged.rename(path)
    except BaseException:
        if old.exists() and not path.exists():
            old.rename(path)
        raise
    if old.is_symlink():
        old.unlink()
    shutil.rmtree(old, ignore_errors=True)


def _sync(file: Path) -> None:
    """Wait until the file is on the disk; some file systems report a full disk only then."""
    with file.open("rb+") as stream:
        os.fsync(stream.fileno())


def _output_error(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"{path} cannot be written: {error.strerror or error}; no incomplete output is left"
    )
