"""The files of a cache: a local folder, or an object store through fsspec."""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit
from urllib.request import url2pathname

from .._utils.writing import check_folder
from ..errors import InputError

__all__ = ["FolderObjects", "Found", "Objects", "RemoteObjects", "open_objects"]

_LEFTOVER_S = 3600.0  # a writer does not need longer for one file
_TIMES = ("LastModified", "mtime", "last_modified", "created")  # names differ between stores


@dataclass(frozen=True)
class Found:
    """One stored object.

    Attributes:
        name: Relative to the store, with ``/``.
        nbytes: Size.
        used: Seconds since 1970 of the last use; of writing, where a store does not record use.
    """

    name: str
    nbytes: int
    used: float


class Objects(Protocol):
    """Named objects that appear whole or not at all.

    All methods raise OSError where the store cannot be reached or denies access.

    Attributes:
        location: Absolute folder or URL, which opens the same objects in another process.
        shared: Whether other processes see them.
    """

    location: str
    shared: bool

    def check(self) -> None:
        """Check before the work that objects can be written.

        Raises:
            InputError, OutputError: They cannot.
        """

    def has(self, name: str) -> bool:
        """Return whether an object exists."""

    def read(self, name: str) -> bytes | None:
        """Return the content of an object and count that as use; None if it does not exist."""

    def write(self, name: str, data: bytes) -> None:
        """Create or replace an object."""

    def remove(self, name: str) -> None:
        """Remove an object, which need not exist."""

    def find(self, kind: str) -> Iterator[Found]:
        """List the objects whose names start with `kind` and a slash."""

    def sweep(self) -> None:
        """Remove what interrupted writers left."""


def open_objects(location: str | os.PathLike) -> Objects:
    """Open a folder, or a URL such as ``s3://bucket/cache`` or ``memory://cache``.

    Nothing is read or written.

    Raises:
        InputError: The URL is malformed, its scheme unknown, or a package for it is missing.
    """
    text = os.fspath(location)
    if "://" not in text:
        return FolderObjects(Path(text))
    if text.startswith("file://"):
        parts = urlsplit(text)
        if parts.netloc not in ("", "localhost") or not parts.path:
            raise InputError(f"the cache {text} is not a file URL: write file:///absolute/folder")
        return FolderObjects(Path(url2pathname(parts.path)))
    return RemoteObjects(text)


class FolderObjects:
    """Objects as files below a folder, which is made when something is first written."""

    shared = True

    def __init__(self, folder: Path):
        self.folder = folder
        self.location = str(folder.resolve())

    def check(self) -> None:
        check_folder(self.folder)

    def has(self, name: str) -> bool:
        return (self.folder / name).is_file()

    def read(self, name: str) -> bytes | None:
        path = self.folder / name
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        with suppress(OSError):
            os.utime(path)
        return data

    def write(self, name: str, data: bytes) -> None:
        # Not synchronised to the disk: what a power failure damages has another digest.
        path = self.folder / name
        temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(data)
            temporary.replace(path)
        except OSError:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise

    def remove(self, name: str) -> None:
        (self.folder / name).unlink(missing_ok=True)

    def find(self, kind: str) -> Iterator[Found]:
        for file in (self.folder / kind).glob("*/*.npz"):
            with suppress(OSError):  # another process has just removed it
                stat = file.stat()
                yield Found(file.relative_to(self.folder).as_posix(), stat.st_size, stat.st_mtime)

    def sweep(self) -> None:
        for file in self.folder.glob("*/*/.*.tmp"):
            with suppress(OSError):
                if time.time() - file.stat().st_mtime > _LEFTOVER_S:
                    file.unlink()


class RemoteObjects:
    """Objects of a store that fsspec reaches; credentials and end points are fsspec's.

    An object store replaces an object as a whole. Use is not recorded: `Found.used` is the time of
    writing.
    """

    def __init__(self, url: str):
        try:
            from fsspec.core import url_to_fs
        except ImportError:
            raise InputError(
                f"the cache {url} needs fsspec: pip install 'sfmkit[remote]'"
            ) from None
        try:
            # other processes write, so a listing must not be remembered
            self._fs, root = url_to_fs(url, use_listings_cache=False)
        except ImportError as error:
            raise InputError(f"the cache {url} needs another package: {error}") from None
        except Exception as error:  # of the scheme's package, or an unknown scheme
            raise InputError(f"the cache {url} cannot be opened: {_text(error)}") from None
        self.location, self._root = url, root.rstrip("/")
        protocols = self._fs.protocol
        self.shared = "memory" not in ((protocols,) if isinstance(protocols, str) else protocols)

    def check(self) -> None:
        name = f"trial-{secrets.token_hex(8)}"
        try:
            self.write(name, b"trial")
            found = self.read(name)
            self.remove(name)
        except OSError as error:
            raise InputError(
                f"objects cannot be written, read and removed in the cache {self.location}: {error}"
            ) from error
        if found != b"trial":
            raise InputError(f"the cache {self.location} does not return what is written to it")

    def has(self, name: str) -> bool:
        return bool(self._do(self._fs.exists, name))

    def read(self, name: str) -> bytes | None:
        try:
            return self._do(self._fs.cat_file, name)
        except FileNotFoundError:
            return None

    def write(self, name: str, data: bytes) -> None:
        self._do(self._fs.pipe_file, name, data)

    def remove(self, name: str) -> None:
        with suppress(FileNotFoundError):
            self._do(self._fs.rm_file, name)

    def find(self, kind: str) -> Iterator[Found]:
        try:
            found = self._do(self._fs.find, kind, detail=True)
        except FileNotFoundError:
            return
        for path, info in found.items():
            if path.endswith(".npz"):
                when = next((info[key] for key in _TIMES if key in info), 0.0)
                used = when.timestamp() if hasattr(when, "timestamp") else float(when)
                yield Found(path[path.rindex(f"/{kind}/") + 1 :], int(info["size"]), used)

    def sweep(self) -> None:
        """Do nothing: object stores keep neither half-written objects nor folders."""

    def _do(self, call: Any, name: str, *args: Any, **options: Any) -> Any:
        """Call fsspec; the errors of a scheme's package become OSError."""
        try:
            return call(f"{self._root}/{name}", *args, **options)
        except OSError:
            raise
        except Exception as error:
            raise OSError(_text(error)) from error


def _text(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
