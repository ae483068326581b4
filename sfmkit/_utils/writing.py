"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import OutputError


@contextmanager
def atomic_write(path: str | os.PathLike) -> Iterator[Path]:
    """Write a file under a temporary name beside `path`, and move it there once it is complete.

    A failure of any kind, Ctrl-C included, leaves what was at `path` before and no temporary file.

    Yields:
        The temporary path to write to; an empty file.

    Raises:
        OutputError: the folder does not exist or cannot be written, `path` is a folder, or the disk
            is full.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path} is a folder; name a file to write")
    temporary = _beside(path)
    try:
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
    """Fill a folder under a hidden temporary name beside `path`, and move it there once it is
    complete.

    A failure of any kind, Ctrl-C included, leaves no temporary folder, and the folder that was at
    `path` before as it was. Missing parents are made, and removed again on failure.

    Args:
        overwrite: replace the folder at `path`; without it an existing folder is refused before
            anything is written.

    Yields:
        The temporary folder to write into.

    Raises:
        OutputError: `path` exists and `overwrite` is not set, or is a file; it cannot be written;
            or the disk is full.
    """
    path = Path(os.path.abspath(path))  # not resolved: a link is replaced, not what it points to
    check_free(path, overwrite)
    made = [parent for parent in path.parents if not parent.exists()]  # innermost first
    staged = _beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
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
            with suppress(OSError):  # never made, or not ours alone any more
                parent.rmdir()


def check_free(path: Path, overwrite: bool) -> None:
    """Refuse a folder's `path` that is taken, as :func:`staged_folder` would: for commands, before
    they work for it.

    Raises:
        OutputError: `path` exists and `overwrite` is not set, is a file, or holds the working
            folder.
    """
    if path.is_dir():
        if not overwrite:
            raise OutputError(
                f"the folder {path} exists; choose another with --out, or replace it with --overwrite"
            )
        if Path(os.path.abspath(path)) in (Path.cwd(), *Path.cwd().parents):
            raise OutputError(
                f"{path} is the working folder or above it and is not replaced; choose a folder in it"
            )
    elif os.path.lexists(path):
        raise OutputError(f"{path} is a file; choose a folder to write to")


def _move_folder(staged: Path, path: Path, overwrite: bool) -> None:
    """Move `staged` to `path`; a folder that is there steps aside first, for no folder can be
    renamed onto another."""
    if not path.exists():
        staged.rename(path)
        return
    if not overwrite:
        raise OutputError(
            f"the folder {path} has appeared meanwhile; choose another, or use --overwrite"
        )
    old = _beside(path)
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


def _beside(path: Path) -> Path:
    """A hidden name in the same folder, and so on the same disk, that nobody else has."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}{path.suffix}")


def _sync(file: Path) -> None:
    """Have the disk hold the file's bytes; a full disk may tell only now."""
    with file.open("rb+") as stream:
        os.fsync(stream.fileno())


def _output_error(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"{path} cannot be written: {error.strerror or error}; nothing half-written is left"
    )
