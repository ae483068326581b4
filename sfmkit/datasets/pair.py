"""A pair of photographs with what is known about it, and where the data sets lie on this
machine."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..types import Camera

IMAGE_SUFFIXES = (".png", ".ppm", ".pgm", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VARIABLE = "SFMKIT_DATA"


@dataclass(frozen=True, eq=False)
class Pair:
    """Two photographs of one scene and the truth about them, as far as it is known.

    Attributes:
        dataset, sequence, name: where the pair belongs, e.g. ``oxford``, ``graf``, ``1-2``.
        image1, image2: paths, or (H, W, 3) or (H, W) uint8 arrays.
        camera1, camera2: intrinsics; None where the photographs' EXIF, or nothing, has to do.
        H: (3, 3) float64, ``x2 = H x1`` in pixels with ``H[2, 2] = 1``, for planes and rotations.
        R, t: (3, 3) and (3,) float64, ``X2 = R X1 + t``, in the data set's units.

    Raises:
        InputError: matrices of another shape or with NaN, a rotation that is none, R without t.
    """

    dataset: str
    sequence: str
    name: str
    image1: Path | np.ndarray
    image2: Path | np.ndarray
    camera1: Camera | None = None
    camera2: Camera | None = None
    H: np.ndarray | None = None
    R: np.ndarray | None = None
    t: np.ndarray | None = None

    def __post_init__(self) -> None:
        for field, shape in (("H", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            value = getattr(self, field)
            if value is None:
                continue
            value = np.array(value, dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(
                    f"{self}: {field} must hold finite numbers of shape {shape}, not {value.shape}"
                )
            value.flags.writeable = False
            object.__setattr__(self, field, value)
        if (self.R is None) != (self.t is None):
            raise InputError(f"{self}: R and t come together or not at all")
        if self.R is not None and not np.allclose(self.R @ self.R.T, np.eye(3), atol=1e-3):
            raise InputError(f"{self}: R is no rotation")

    def __str__(self) -> str:
        return f"{self.dataset}/{self.sequence} {self.name}"


def data_root(dataset: str, data: str | os.PathLike | None = None) -> Path:
    """The folder of a data set: below `data`, below ``SFMKIT_DATA``, or where ``sfmkit data fetch``
    puts it.

    Args:
        dataset: its folder's name, e.g. ``oxford``.
        data: a folder that holds the data sets, or the data set itself.

    Raises:
        InputError: it is in none of them; the message says how to get it.
    """
    if data is not None:
        candidates = [Path(data) / dataset, Path(data)]
        if candidates[1].is_dir() and (candidates[0].is_dir() or candidates[1].name == dataset):
            return next(folder for folder in candidates if folder.is_dir())
        raise InputError(
            f"there is no folder {candidates[0]}; --data names the folder that holds {dataset}/"
        )
    looked = []
    if os.environ.get(VARIABLE):
        looked.append(Path(os.environ[VARIABLE]))
    looked.append(download_folder())
    for folder in looked:
        if (folder / dataset).is_dir():
            return folder / dataset
    raise InputError(
        f"the data set '{dataset}' is not here (looked in {', '.join(str(f) for f in looked)}). "
        f"`sfmkit data fetch {dataset}` downloads it; off-line, name the folder that holds {dataset}/ with --data or "
        f"the environment variable {VARIABLE}"
    )


def download_folder() -> Path:
    """Where downloads go: ``sfmkit`` in the user's cache folder."""
    import pooch

    return Path(pooch.os_cache("sfmkit"))


def choose_sequences(
    root: Path, known: Iterable[str], wanted: Iterable[str] | None
) -> tuple[str, ...]:
    """The sequences to go through: those wanted, or all that are there, in the order of `known`.

    Raises:
        InputError: unknown names, sequences that are missing, or none at all.
    """
    known = tuple(known)
    if wanted is None:
        present = tuple(name for name in known if (root / name).is_dir())
        if not present:
            raise InputError(
                f"{root} holds none of the sequences {', '.join(known) or '(no folders at all)'}"
            )
        return present
    names = tuple(dict.fromkeys(wanted))
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise InputError(f"unknown sequence '{name}'.{hint} Known: {', '.join(known)}")
        if not (root / name).is_dir():
            raise InputError(
                f"the sequence '{name}' is missing from {root}; fetch the data set again, or leave it out"
            )
    return names


def find_image(folder: Path, stem: str) -> Path:
    """The image `stem` in `folder`, whatever its format.

    Raises:
        InputError: there is none.
    """
    for suffix in IMAGE_SUFFIXES:
        for name in (f"{stem}{suffix}", f"{stem}{suffix.upper()}"):
            if (folder / name).is_file():
                return folder / name
    raise InputError(
        f"{folder} is incomplete: there is no image {stem} ({', '.join(IMAGE_SUFFIXES[:4])}, ...)"
    )


def photographs(folder: Path) -> list[Path]:
    """The images in `folder`, in the order of the numbers in their names."""
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}")
    files = [file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES]
    return sorted(
        files,
        key=lambda file: [
            (int(p), "") if p.isdigit() else (-1, p) for p in re.split(r"(\d+)", file.name)
        ],
    )


def neighbours(files: list[Path], folder: Path) -> Iterator[tuple[Path, Path]]:
    """Each photograph with the next one.

    Raises:
        InputError: fewer than two.
    """
    if len(files) < 2:
        raise InputError(f"{folder} holds {len(files)} photographs; a pair takes two")
    return pairwise(files)


def read_homography(path: str | os.PathLike) -> np.ndarray:
    """(3, 3) float64 homography from a text file of nine numbers, scaled to ``H[2, 2] = 1``.

    Raises:
        InputError: no such file, not nine finite numbers, or a singular matrix.
    """
    path = Path(path)
    try:
        words = path.read_text(encoding="utf-8-sig").replace(",", " ").split()
    except FileNotFoundError:
        raise InputError(
            f"there is no homography file {path}; the data set is incomplete"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as text: {error}") from error
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{path} holds something that is no number: {error}") from None
    if len(numbers) != 9:
        raise InputError(
            f"{path} holds {len(numbers)} numbers; a homography has nine, in three rows"
        )
    H = numbers.reshape(3, 3)
    if not np.isfinite(H).all() or H[2, 2] == 0 or abs(np.linalg.det(H / H[2, 2])) < 1e-12:
        raise InputError(
            f"{path} is no homography: it is singular, not finite, or has 0 in its last place"
        )
    return H / H[2, 2]
