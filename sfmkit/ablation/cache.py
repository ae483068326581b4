"""Results of stages on disk, addressed by the content of everything that they depend on.

A key is the digest of everything that a result depends on (the image's bytes, the operator, its
options, the version of the code), so an entry is never out of date, and two processes that write
the same key write the same thing. Objects appear whole (:mod:`~.objects`); a reader needs no lock.
The size is bounded: what was used longest ago is removed first.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import PurePosixPath

from ..errors import InputError, OutputError
from .entry import DamagedEntry, Entry
from .objects import Found, open_objects

VARIABLE = "SFMKIT_CACHE"
DEFAULT_LIMIT = 8 << 30  # bytes
KINDS = ("features", "matches", "estimates", "geometries", "pairs")
_ROOM = 0.9  # share of the limit after tidying, so that tidying is rare


def default_cache() -> str:
    """``SFMKIT_CACHE``, or ``stages`` in the user's cache folder of sfmkit."""
    if os.environ.get(VARIABLE):
        return os.environ[VARIABLE]
    from ..datasets.pair import download_folder

    return str(download_folder() / "stages")


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
    """Entries in a folder or an object store, ``KIND/ab/abcdef....npz``.

    Args:
        location: Folder, made when something is first put in; or a URL that fsspec opens.
        limit: bytes; beyond them :meth:`tidy` drops what was used longest ago.

    Raises:
        InputError: The limit is not positive, or the URL cannot be opened.
    """

    def __init__(self, location: str | os.PathLike, limit: int = DEFAULT_LIMIT):
        if limit <= 0:
            raise InputError(f"the cache's limit must be positive bytes, not {limit}")
        self._objects, self.limit = open_objects(location), limit

    @property
    def location(self) -> str:
        """The absolute folder or the URL."""
        return self._objects.location

    def check(self, local_workers: bool) -> None:
        """Check before the work that the cache can be written, and that its workers can see it.

        Args:
            local_workers: Whether the workers are other processes of this machine.

        Raises:
            InputError, OutputError: It is not so.
        """
        if local_workers and not self._objects.shared:
            raise InputError(
                f"the cache {self.location} exists in one process only, and the local workers are "
                "other processes; choose a folder or an object store"
            )
        self._objects.check()

    @contextmanager
    def token(self) -> Iterator[str]:
        """Store an object for the duration of the block, for the test :meth:`sees`."""
        name = f"token-{secrets.token_hex(8)}"
        with self._writing():
            self._objects.write(name, b"")
        try:
            yield name
        finally:
            with suppress(OSError):
                self._objects.remove(name)

    def sees(self, token: str) -> bool:
        """Return whether this cache has the object of a token."""
        try:
            return self._objects.has(token)
        except OSError:
            return False

    @staticmethod
    def name(kind: str, key: str) -> str:
        """The name of the object of an entry, relative to the location."""
        return f"{kind}/{key[:2]}/{key}.npz"

    def has(self, kind: str, key: str) -> bool:
        with self._reading(kind, key):
            return self._objects.has(self.name(kind, key))

    def get_bytes(self, kind: str, key: str) -> bytes | None:
        """Return the bytes of an entry, or None. Counts as use."""
        with self._reading(kind, key):
            return self._objects.read(self.name(kind, key))

    def get(self, kind: str, key: str, warn: Callable[[str], None] | None = None) -> Entry | None:
        """The entry, or None where there is none. A damaged one is removed and reported to
        `warn`."""
        data = self.get_bytes(kind, key)
        if data is None:
            return None
        try:
            return Entry.from_bytes(data, key)
        except DamagedEntry as error:
            if warn is not None:
                warn(f"cache entry {kind}/{key[:12]} is {error}; it is computed again")
            self.drop(kind, key)
            return None

    def put(self, kind: str, entry: Entry) -> None:
        self.put_bytes(kind, entry.key, entry.to_bytes())

    def put_bytes(self, kind: str, key: str, data: bytes) -> None:
        """Store an entry, in one piece or not at all.

        Raises:
            OutputError: the cache cannot be written or the disk is full.
        """
        with self._writing():
            self._objects.write(self.name(kind, key), data)

    def drop(self, kind: str, key: str) -> None:
        with suppress(OSError):
            self._objects.remove(self.name(kind, key))

    def _entries(self) -> Iterator[tuple[str, Found]]:
        for kind in KINDS:
            with self._reading(kind, ""):
                for found in self._objects.find(kind):
                    yield kind, found

    @contextmanager
    def _reading(self, kind: str, key: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(
                f"{self.name(kind, key) if key else kind} in the cache {self.location} cannot be "
                f"read: {error.strerror or error}"
            ) from error

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(
                f"the cache {self.location} cannot be written: {error.strerror or error}; make "
                "room or choose another "
                f"with --cache or {VARIABLE}, and start again; finished results are kept"
            ) from error

    def stats(self) -> Stats:
        kinds = dict.fromkeys(KINDS, (0, 0))
        for kind, found in self._entries():
            n, size = kinds[kind]
            kinds[kind] = (n + 1, size + found.nbytes)
        return Stats(kinds)

    def verify(self, progress: Callable[[int], None] | None = None) -> tuple[int, list[str]]:
        """Read every entry and remove the damaged ones.

        Returns:
            The number of entries, and a line for each damaged one.
        """
        n, damaged = 0, []
        for kind, found in list(self._entries()):
            key = PurePosixPath(found.name).stem
            try:
                data = self._objects.read(found.name)
                if data is None:  # another process has just removed it
                    continue
                Entry.from_bytes(data, key)
            except (DamagedEntry, OSError) as error:
                damaged.append(f"{kind}/{key[:12]}: {error}")
                self.drop(kind, key)
            n += 1
            if progress is not None:
                progress(n)
        return n, damaged

    def tidy(self) -> int:
        """Remove the entries that were used longest ago until the rest is within the limit.

        Files that crashed writers left are removed too.

        Returns:
            Bytes freed.
        """
        self._objects.sweep()
        entries = [found for _, found in self._entries()]
        size, freed = sum(found.nbytes for found in entries), 0
        if size <= self.limit:
            return 0
        for found in sorted(entries, key=lambda found: found.used):
            if size - freed <= _ROOM * self.limit:
                break
            with suppress(OSError):
                self._objects.remove(found.name)
                freed += found.nbytes
        return freed

    def clear(self) -> Stats:
        """Remove everything and return what there was."""
        before = self.stats()
        for _, found in list(self._entries()):
            with suppress(OSError):
                self._objects.remove(found.name)
        return before
