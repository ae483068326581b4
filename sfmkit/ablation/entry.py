"""What a stage made, as bytes: arrays and a few words about them in one npz, without pickle."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import SfmError


class DamagedEntry(SfmError):
    """Bytes that are not, or no longer, what was stored."""


@dataclass(frozen=True, eq=False)
class Entry:
    """The result of one task.

    Attributes:
        key: what it is the result of, see :mod:`sfmkit.ablation.tasks`.
        arrays: name -> array; no objects.
        meta: JSON: what does not need an array, ``seconds`` among it.
    """

    key: str
    meta: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in self.arrays.values())

    def to_bytes(self) -> bytes:
        """An npz, uncompressed: descriptors hardly shrink, and every member has its checksum."""
        words = np.frombuffer(json.dumps({"key": self.key, **self.meta}).encode(), np.uint8)
        file = io.BytesIO()
        np.savez(file, meta=words, **self.arrays)  # type: ignore[arg-type]
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes, key: str) -> Entry:
        """The entry, all of it read and its checksums compared.

        Raises:
            DamagedEntry: the bytes are cut off or changed, or belong to another key.
        """
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            meta = json.loads(arrays.pop("meta").tobytes())
        except (
            zipfile.BadZipFile,
            ValueError,
            KeyError,
            OSError,
            EOFError,
            NotImplementedError,
        ) as error:
            raise DamagedEntry(f"damaged: {error}") from error
        if meta.pop("key", None) != key:
            raise DamagedEntry("it belongs to another key")
        return cls(key, meta, arrays)
