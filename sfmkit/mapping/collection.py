"""Folders of photographs: names, headers, masks and skipped files."""

from __future__ import annotations

import hashlib
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from .._utils.progress import Progress, silent
from ..ablation.tasks import ImageRef
from ..datasets.pair import natural_order
from ..errors import ImageError, InputError
from ..io.header import ImageHeader, read_header
from ..io.images import SUFFIXES

__all__ = ["Collection", "Photograph", "read_collection"]

_CHUNK = 1 << 20  # bytes per step of the hash


@dataclass(frozen=True)
class Photograph:
    """A photograph of a folder.

    Attributes:
        name: Path relative to the folder, with ``/``; also its name in tables and databases.
        header: Size and metadata.
        mask: Path of its mask; None without a mask.
    """

    name: str
    header: ImageHeader
    mask: Path | None = None

    @property
    def path(self) -> Path:
        return self.header.path

    @property
    def size_wh(self) -> tuple[int, int]:
        """The upright width and height, pixels."""
        return self.header.size_wh

    @property
    def subfolder(self) -> str:
        """The subfolder, with ``/``; empty for the folder itself."""
        return self.name.rpartition("/")[0]


@dataclass(frozen=True)
class Collection:
    """The photographs of a folder and of its subfolders.

    Attributes:
        folder: The folder.
        photographs: At least two photographs, in the natural order of their names.
        skipped: Name -> reason of skipped files.
    """

    folder: Path
    photographs: tuple[Photograph, ...]
    skipped: dict[str, str] = field(default_factory=dict)
    _refs: dict[Path, ImageRef] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.photographs)

    @property
    def names(self) -> list[str]:
        return [photograph.name for photograph in self.photographs]

    def ref(self, index: int) -> ImageRef:
        """Return the reference of a photograph for tasks; the first call hashes its bytes."""
        photograph = self.photographs[index]
        return self._ref(photograph.path, photograph.size_wh)

    def mask_ref(self, index: int) -> ImageRef | None:
        """Return the reference of the mask of a photograph; None without a mask."""
        photograph = self.photographs[index]
        return None if photograph.mask is None else self._ref(photograph.mask, photograph.size_wh)

    def _ref(self, path: Path, size_wh: tuple[int, int]) -> ImageRef:
        if path not in self._refs:
            self._refs[path] = ImageRef(_sha256(path), str(path), size_wh)
        return self._refs[path]


def read_collection(
    folder: str | os.PathLike,
    *,
    masks: str | os.PathLike | None = None,
    say: Progress = silent,
) -> Collection:
    """Read the headers of all photographs below a folder.

    Hidden files and folders are ignored. Unreadable files and copies of another file are skipped.
    Only files of equal size are compared, so few bytes are read.

    Args:
        folder: Folder, possibly with one subfolder per camera.
        masks: Folder of masks: the mask of ``sub/a.jpg`` is ``sub/a.jpg.png`` or ``sub/a.png``.
            The whole image is used for a photograph without a mask.
        say: Called with the progress.

    Raises:
        InputError: The folder does not exist or has fewer than two usable photographs, or no
            photograph has a mask in `masks`.
    """
    root = Path(os.path.abspath(folder))
    if not root.is_dir():
        raise InputError(f"there is no folder {folder}")
    files = _image_files(root)
    found: list[Photograph] = []
    skipped: dict[str, str] = {}
    for number, (name, path) in enumerate(files, start=1):
        if number % 100 == 1:
            say("headers", f"{number:,} of {len(files):,}", fraction=number / len(files))
        try:
            found.append(Photograph(name, read_header(path), _mask_of(name, masks)))
        except ImageError as error:
            skipped[name] = str(error)
    copies = _copies(found)
    skipped |= copies
    kept = tuple(p for p in found if p.name not in copies)
    if len(kept) < 2:
        raise InputError(
            f"{folder} holds {len(kept)} usable photographs and a pair takes two"
            + "".join(f"; {name}: {reason}" for name, reason in list(skipped.items())[:3])
        )
    if masks is not None and all(p.mask is None for p in kept):
        raise InputError(
            f"{masks} has no mask of any photograph; the mask of {kept[0].name} would be "
            f"{Path(masks) / (kept[0].name + '.png')}"
        )
    return Collection(root, kept, skipped)


def _image_files(root: Path) -> list[tuple[str, Path]]:
    """Find name and path of every image file below a folder, in natural order."""
    found = []
    for folder, subfolders, files in os.walk(root):
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        for file in files:
            if not file.startswith(".") and file.lower().endswith(SUFFIXES):
                path = Path(folder) / file
                found.append((path.relative_to(root).as_posix(), path))
    return sorted(found, key=lambda item: [natural_order(part) for part in item[0].split("/")])


def _mask_of(name: str, masks: str | os.PathLike | None) -> Path | None:
    if masks is None:
        return None
    candidates = (Path(masks) / f"{name}.png", (Path(masks) / name).with_suffix(".png"))
    return next((Path(os.path.abspath(path)) for path in candidates if path.is_file()), None)


def _copies(photographs: Sequence[Photograph]) -> dict[str, str]:
    """Map the names of photographs that are copies of an earlier one to the reason."""
    by_size: dict[int, list[Photograph]] = defaultdict(list)
    for photograph in photographs:
        by_size[photograph.path.stat().st_size].append(photograph)
    copies = {}
    for group in by_size.values():
        first: dict[str, str] = {}
        for photograph in group if len(group) > 1 else ():
            original = first.setdefault(_sha256(photograph.path), photograph.name)
            if original != photograph.name:
                copies[photograph.name] = f"a copy of {original}"
    return copies


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK):
                digest.update(chunk)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    return digest.hexdigest()
