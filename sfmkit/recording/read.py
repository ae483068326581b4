"""Read a recording: the logged values as NumPy arrays."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from ..errors import InputError
from . import _reader

SCHEMA = 2  # of recordings; docs/recording.md says what each number means

# followed by the version of Rerun that wrote the file: major, minor, patch, kind of release
_MAGIC = b"RRF2"

_ROW = "rerun.controls.RowId"  # grows with time


class RecordingError(InputError):
    """A file is not a readable recording, or does not contain the requested data."""


@dataclass(frozen=True)
class Logged:
    """One component of an entity at one time.

    Attributes:
        entity, component: e.g. ``/world/points/operator`` and ``sfmkit:residual_px``.
        times: timeline -> value (clock times in ns since 1970); empty for static values.
        values: an array with one row per mark, or a list for other data (texts, line strips).
    """

    entity: str
    component: str
    times: Mapping[str, int]
    values: np.ndarray | list


class Recording:
    """The contents of a file. Values are converted on access.

    Attributes:
        path: of the file.
        entities: sorted paths of the logged entities, without the viewer's internal ones.
    """

    def __init__(self, path: Path, chunks: Mapping[str, list[pa.RecordBatch]]):
        self.path = path
        self._chunks = chunks
        self.entities = tuple(sorted(chunks))

    def __contains__(self, entity: str) -> bool:
        return entity in self._chunks

    def below(self, entity: str) -> tuple[str, ...]:
        """Return the names of the direct children, unescaped (``gftt+brief``)."""
        start = entity.rstrip("/") + "/"
        rest = (e[len(start) :] for e in self.entities if e.startswith(start))
        first_parts = (re.split(r"(?<!\\)/", r, maxsplit=1)[0] for r in rest)
        return tuple(dict.fromkeys(re.sub(r"\\(.)", r"\1", part) for part in first_parts))

    def logged(self, entity: str) -> list[Logged]:
        """Return everything logged to an entity, by stage and then in the order of logging.

        Raises:
            RecordingError: the entity does not exist; the message suggests similar names.
        """
        if entity not in self._chunks:
            near = get_close_matches(entity, self.entities, n=3, cutoff=0.4)
            hint = f" Did you mean {' or '.join(near)}?" if near else ""
            raise RecordingError(
                f"{self.path} has no entity {entity}.{hint} It has {len(self.entities)} in all."
            )
        found: list[tuple[int, bytes, Logged]] = []
        for batch in self._chunks[entity]:
            kinds = {f.name: (f.metadata or {}).get(b"rerun:kind") for f in batch.schema}
            timelines = [name for name, kind in kinds.items() if kind == b"index"]
            names = [name for name, kind in kinds.items() if kind == b"data"]
            for row in range(batch.num_rows):
                times = {n: _integer(batch[n][row]) for n in timelines if batch[n][row].is_valid}
                order = (times.get("stage", -1), batch[_ROW][row].as_py())
                for name in names:
                    if batch[name][row].is_valid:
                        found.append(
                            (*order, Logged(entity, name, times, _plain(batch[name][row].values)))
                        )
        return [item for _, _, item in sorted(found, key=lambda f: f[:2])]

    def latest(self, entity: str) -> dict[str, np.ndarray | list]:
        """Return the last values of all components of an entity."""
        return {item.component: item.values for item in self.logged(entity)}

    def text(self, entity: str) -> str:
        """Return the last text document of an entity."""
        return str(self.latest(entity)["TextDocument:text"][0])

    def prefixes(self) -> tuple[str, ...]:
        """Return the path prefixes of the reconstructions in the file; the default is ``""``."""
        return tuple(e.removesuffix("/report") for e in self.entities if e.endswith("/report"))

    def report(self, prefix: str = "") -> dict[str, Any]:
        """Return the report of a reconstruction.

        Raises:
            RecordingError: the report does not exist or follows another schema.
        """
        if f"{prefix}/report" not in self:
            others = self.prefixes()
            hint = (
                f"; it has some under {', '.join(others)}"
                if others
                else ": it was not written by sfmkit reconstruct"
            )
            raise RecordingError(
                f"{self.path} holds no reconstruction{f' under {prefix}' if prefix else ''}{hint}"
            )
        report = json.loads(self.text(f"{prefix}/report"))
        if report.get("schema") != SCHEMA:
            by = report.get("versions", {}).get("sfmkit", "another version")
            raise RecordingError(
                f"{self.path} follows schema {report.get('schema')} of recordings (sfmkit {by}); "
                f"this sfmkit reads schema {SCHEMA}: use the sfmkit that wrote it, or write the "
                "recording again"
            )
        return report


def read_recording(path: str | Path) -> Recording:
    """Open an .rrd file.

    Raises:
        RecordingError: the file does not exist, is not a recording, is truncated, or was written by
            a newer Rerun.
    """
    path = Path(path)
    written, here = _version(path), rr.__version_info__[:2]
    if written > here:
        raise RecordingError(
            f"{path} was written by Rerun {_dotted(written)}, this is Rerun {_dotted(here)}: use "
            f"the environment that wrote it, or install rerun-sdk {_dotted(written)}"
        )
    # -P: the modules beside the script must not hide others of the same name.
    command = [sys.executable, "-P", _reader.__file__, str(path)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if done.returncode == _reader.DAMAGED or done.returncode < 0:
        if written < here:
            hint = (
                f"it was written by Rerun {_dotted(written)}, this is {_dotted(here)}; try "
                f"`rerun rrd migrate {path}`"
            )
        else:
            hint = (
                "it is cut off or damaged, perhaps because writing or copying it was interrupted; "
                "write or fetch it again"
            )
        raise RecordingError(f"{path} cannot be read: {hint}")
    if done.returncode:
        raise RuntimeError(f"Rerun's reader failed: {done.stderr.decode(errors='replace')[-2000:]}")
    chunks: dict[str, list[pa.RecordBatch]] = {}
    source = pa.BufferReader(done.stdout)
    while source.tell() < source.size():
        (batch,) = pa.ipc.open_stream(source)
        entity = batch.schema.metadata[b"rerun:entity_path"].decode()
        chunks.setdefault(entity, []).append(batch)
    return Recording(path, chunks)


def _version(path: Path) -> tuple[int, int]:
    """Read the release of Rerun that wrote a file from its first bytes."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except FileNotFoundError:
        raise RecordingError(f"there is no file {path}") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    if not head:
        raise RecordingError(f"{path} is empty (0 bytes)")
    if head[:3] != _MAGIC[:3]:
        raise RecordingError(
            f"{path} is not a recording: an .rrd file begins with {_MAGIC.decode()}"
        )
    if head[:4] != _MAGIC or len(head) < 8:
        raise RecordingError(
            f"{path} cannot be read: it is cut off, or an old release of Rerun wrote it"
        )
    return head[4], head[5]


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


def _integer(time: pa.Scalar) -> int:
    return time.value if hasattr(time, "value") else time.as_py()


def _plain(values: pa.Array) -> np.ndarray | list:
    """Convert the Arrow values of one row to (N,) or (N, d) NumPy, or to a list if nested."""
    if pa.types.is_fixed_size_list(values.type) and pa.types.is_primitive(values.type.value_type):
        return (
            values.flatten()
            .to_numpy(zero_copy_only=False)
            .reshape(len(values), values.type.list_size)
        )
    if pa.types.is_primitive(values.type):
        return values.to_numpy(zero_copy_only=False)
    if pa.types.is_string(values.type):
        return np.array(values.to_pylist(), dtype=str)
    return values.to_pylist()
