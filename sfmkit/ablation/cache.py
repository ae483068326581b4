"""Results of stages on disk, addressed by the content of everything that they depend on.

A key is the digest of everything that a result depends on (the image's bytes, the operator, its
options, the version of the code), so an entry is never out of date, and two processes that write
the same key write the same thing. Files appear whole by renaming; a reader needs no lock. The
folder is bounded: what was used longest ago goes first.
"""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError, OutputError
from .entry import DamagedEntry, Entry

VARIABLE = "SFMKIT_CACHE"
DEFAULT_LIMIT = 8 << 30  # bytes
KINDS = ("features", "matches", "estimates", "geometries", "pairs")
_LEFTOVER_S = 3600.0  # temporary files older than this belong to nobody who lives
_ROOM = 0.9  # of the limit is left after tidying, so that it is not done for every file


def cache_folder() -> Path:
    """``SFMKIT_CACHE``, or ``stages`` in the user's cache folder of sfmkit."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    from ..datasets.pair import download_folder

    return download_folder() / "stages"


@dataclass(frozen=True)
class Stats:
    """What a cache holds: kind -> (entries, bytes)."""

    kinds: dict[str, tuple[int, int]]

    @property
    def entries(self) -> int:
        return sum(n for n, _ in self.kinds.values())

    @property
    def nbytes(self) -> int:
        return sum(size for _, size in self.kinds.values())


class Cache:
    """Entries below a folder, ``KIND/ab/abcdef....npz``.

    Args:
        folder: made when something is first put in.
        limit: bytes; beyond them :meth:`tidy` drops what was used longest ago.
    """

    def __init__(self, folder: str | os.PathLike, limit: int = DEFAULT_LIMIT):
        if limit <= 0:
            raise InputError(f"the cache's limit must be positive bytes, not {limit}")
        self.folder, self.limit = Path(folder), limit

    def path(self, kind: str, key: str) -> Path:
        return self.folder / kind / key[:2] / f"{key}.npz"

    def has(self, kind: str, key: str) -> bool:
        return self.path(kind, key).is_file()

    def get_bytes(self, kind: str, key: str) -> bytes | None:
        """What is stored, unread, or None. Counts as use."""
        path = self.path(kind, key)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise OutputError(
                f"the cache file {path} cannot be read: {error.strerror or error}"
            ) from error
        with suppress(OSError):
            os.utime(path)
        return data

    def get(self, kind: str, key: str, warn: Callable[[str], None] | None = None) -> Entry | None:
        """The entry, or None where there is none. A damaged one is removed, said to `warn`, and
        counts as none."""
        data = self.get_bytes(kind, key)
        if data is None:
            return None
        try:
            return Entry.from_bytes(data, key)
        except DamagedEntry as error:
            if warn is not None:
                warn(f"cache entry {kind}/{key[:12]} is {error}; it is made again")
            self.drop(kind, key)
            return None

    def put(self, kind: str, entry: Entry) -> None:
        self.put_bytes(kind, entry.key, entry.to_bytes())

    def put_bytes(self, kind: str, key: str, data: bytes) -> None:
        """Store an entry, in one piece or not at all.

        Not synchronised to the disk: what a power failure damages is found out and made again.

        Raises:
            OutputError: the folder cannot be written or the disk is full.
        """
        path = self.path(kind, key)
        temporary = path.with_name(f".{key}.{secrets.token_hex(4)}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(data)
            temporary.replace(path)
        except OSError as error:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise OutputError(
                f"the cache {self.folder} cannot be written: {error.strerror or error}; make "
                "room or choose another "
                f"with --cache or {VARIABLE}, and start again: nothing that was done is lost"
            ) from error

    def drop(self, kind: str, key: str) -> None:
        with suppress(OSError):
            self.path(kind, key).unlink(missing_ok=True)

    def _files(self) -> Iterator[tuple[str, Path, os.stat_result]]:
        for kind in KINDS:
            for file in (self.folder / kind).glob("*/*.npz"):
                with suppress(OSError):  # another process has just removed it
                    yield kind, file, file.stat()

    def stats(self) -> Stats:
        kinds = dict.fromkeys(KINDS, (0, 0))
        for kind, _, stat in self._files():
            n, size = kinds[kind]
            kinds[kind] = (n + 1, size + stat.st_size)
        return Stats(kinds)

    def verify(self, progress: Callable[[int], None] | None = None) -> tuple[int, list[str]]:
        """Read every entry and drop the damaged ones.

        Returns:
            how many were read, and a line for each that was damaged.
        """
        n, damaged = 0, []
        for kind, file, _ in list(self._files()):
            key = file.stem
            try:
                Entry.from_bytes(file.read_bytes(), key)
            except FileNotFoundError:
                continue
            except (DamagedEntry, OSError) as error:
                damaged.append(f"{kind}/{key[:12]}: {error}")
                self.drop(kind, key)
            n += 1
            if progress is not None:
                progress(n)
        return n, damaged

    def tidy(self) -> int:
        """Drop what was used longest ago until the rest fits, and what crashed writers left.
        Returns bytes freed."""
        for file in self.folder.glob("*/*/.*.tmp"):
            with suppress(OSError):
                if time.time() - file.stat().st_mtime > _LEFTOVER_S:
                    file.unlink()
        files = list(self._files())
        size, freed = sum(stat.st_size for *_, stat in files), 0
        if size <= self.limit:
            return 0
        for _, file, stat in sorted(files, key=lambda f: f[2].st_mtime):
            if size - freed <= _ROOM * self.limit:
                break
            with suppress(OSError):
                file.unlink()
                freed += stat.st_size
        return freed

    def clear(self) -> Stats:
        """Drop everything; returns what there was."""
        before = self.stats()
        for kind in KINDS:
            for file in (self.folder / kind).glob("*/*"):
                with suppress(OSError):
                    file.unlink()
            for folder in [*(self.folder / kind).glob("*"), self.folder / kind]:
                with suppress(OSError):
                    folder.rmdir()
        return before
