"""Results of stages as bytes: arrays and JSON in one npz file, without pickle."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import SfmError

_DIGEST_SIZE = hashlib.sha256().digest_size


class DamagedEntry(SfmError):
    """Bytes that differ from what was stored."""


@dataclass(frozen=True, eq=False)
class Entry:
    """The result of one task.

    Attributes:
        key: The key of the task, see :mod:`sfmkit.ablation.tasks`.
        arrays: name -> array, not of objects.
        meta: JSON values, among them ``seconds``.
    """

    key: str
    meta: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in self.arrays.values())

    def to_bytes(self) -> bytes:
        """The entry as an uncompressed npz file that ends with its sha256.

        The digest is the comment of the zip archive and covers every byte before it.
        """
        meta = np.frombuffer(json.dumps({"key": self.key, **self.meta}).encode(), np.uint8)
        file = io.BytesIO()
        np.savez(file, meta=meta, **self.arrays)  # type: ignore[arg-type]
        # a zip archive ends with the length of its comment (2 bytes) and the comment
        content = file.getvalue()[:-2] + _DIGEST_SIZE.to_bytes(2, "little")
        return content + hashlib.sha256(content).digest()

    @classmethod
    def from_bytes(cls, data: bytes, key: str) -> Entry:
        """Read an entry whose digest is right.

        Raises:
            DamagedEntry: The bytes are cut off or changed, or belong to another key.
        """
        content, stored = data[:-_DIGEST_SIZE], data[-_DIGEST_SIZE:]
        if hashlib.sha256(content).digest() != stored:
            raise DamagedEntry("damaged: its digest differs")
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            meta = json.loads(arrays.pop("meta").tobytes())
            found = meta.pop("key", None)
        except (
            Exception
        ) as error:  # bytes with a right digest that are not an entry: any of numpy's
            raise DamagedEntry(f"damaged: {error}") from error
        if found != key:
            raise DamagedEntry("stored under another key")
        return cls(key, meta, arrays)
