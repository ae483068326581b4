"""Pairs of photographs with known geometry, and the folders of the data sets."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

from ..errors import InputError
from ..io.images import read_image
from ..types import Camera

IMAGE_SUFFIXES = (".png", ".ppm", ".pgm", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VARIABLE = "SFMKIT_DATA"
HOMOGRAPHY, TWO_VIEW = KINDS = ("homography", "two-view")
_ORIENTATION, _TURNED = 0x0112, (5, 6, 7, 8)  # EXIF: the stored rows are columns


@dataclass(frozen=True, eq=False)
class Pair:
    """Two photographs of a scene with their ground truth, as far as it is known.

    Attributes:
        dataset, sequence, name: Names that identify the pair, e.g. ``oxford``, ``graf``, ``1-2``.
        image1, image2: Paths, or (H, W, 3) or (H, W) uint8 arrays.
        camera1, camera2: Intrinsics; None if EXIF contains them or if they are not needed.
        H: (3, 3) float64, ``x2 = H x1`` in pixels with ``H[2, 2] = 1``, for planes and rotations.
        R, t: (3, 3) and (3,) float64, ``X2 = R X1 + t``, in the units of the data set.
        check_points: (N, 4) float64 annotated correspondences x1, y1, x2, y2 in pixels of the
            stored images. If given, estimated homographies are evaluated at these points.
        kind: Model to estimate: ``homography`` or ``two-view``. None becomes ``homography`` if H is
            given, otherwise ``two-view``.

    Raises:
        InputError: An array has a wrong shape or contains NaN, R is not a rotation matrix, R and t
            are not given together, or the kind is unknown.
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
    check_points: np.ndarray | None = None
    kind: str | None = None

    def __post_init__(self) -> None:
        for field, shape in (("H", (3, 3)), ("R", (3, 3)), ("t", (3,)), ("check_points", (-1, 4))):
            value = getattr(self, field)
            if value is not None:
                object.__setattr__(self, field, self._checked(field, value, shape))
        if (self.R is None) != (self.t is None):
            raise InputError(f"{self}: R and t must be given together")
        if self.R is not None and not (
            np.allclose(self.R @ self.R.T, np.eye(3), atol=1e-3) and np.linalg.det(self.R) > 0
        ):
            raise InputError(f"{self}: R is not a rotation matrix")
        if self.kind is None:
            object.__setattr__(self, "kind", TWO_VIEW if self.H is None else HOMOGRAPHY)
        if self.kind not in KINDS:
            raise InputError(f"{self}: kind must be {' or '.join(KINDS)}, not {self.kind!r}")

    def _checked(self, field: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
        """Return a read-only copy of finite numbers of this shape; -1 stands for any length."""
        array = np.array(value, dtype=np.float64)
        right = array.ndim == len(shape) and all(
            n in (-1, m) for n, m in zip(shape, array.shape, strict=True)
        )
        if not right or not np.isfinite(array).all():
            raise InputError(
                f"{self}: {field} must hold finite numbers of shape {shape}, not {array.shape}"
            )
        array.flags.writeable = False
        return array

    def __str__(self) -> str:
        return f"{self.dataset}/{self.sequence} {self.name}"


def data_root(dataset: str, data: str | os.PathLike | None = None) -> Path:
    """Find the folder of a data set.

    It is searched in `data`, in ``SFMKIT_DATA``, and in the folder of ``sfmkit data fetch``.

    Args:
        dataset: Name of its folder, e.g. ``oxford``.
        data: Folder that contains the data sets, or the folder of the data set itself.

    Raises:
        InputError: The data set was not found; the message states how to download it.
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
        f"the data set '{dataset}' was not found (in {', '.join(str(f) for f in looked)}). "
        f"`sfmkit data fetch {dataset}` downloads it; off-line, name the folder that holds "
        f"{dataset}/ with --data or the environment variable {VARIABLE}"
    )


def download_folder() -> Path:
    """Return the folder of downloads: ``sfmkit`` in the user's cache folder."""
    import pooch

    return Path(pooch.os_cache("sfmkit"))


def choose_sequences(
    root: Path, known: Iterable[str], wanted: Iterable[str] | None
) -> tuple[str, ...]:
    """Return the wanted sequences, or all that are present, in the order of `known`.

    Raises:
        InputError: A name is unknown, a sequence is missing, or there are none.
    """
    known = tuple(known)
    if wanted is None:
        present = tuple(name for name in known if (root / name).is_dir())
        if not present:
            raise InputError(
                f"{root} holds none of the sequences {', '.join(known) or '(it has no folders)'}"
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
                f"the sequence '{name}' is missing from {root}; fetch the data set again, "
                "or leave it out"
            )
    return names


def find_image(folder: Path, stem: str) -> Path:
    """Find the image `stem` in `folder`, in any of the known formats.

    Raises:
        InputError: There is none.
    """
    for suffix in IMAGE_SUFFIXES:
        for name in (f"{stem}{suffix}", f"{stem}{suffix.upper()}"):
            if (folder / name).is_file():
                return folder / name
    raise InputError(
        f"{folder} is incomplete: there is no image {stem} ({', '.join(IMAGE_SUFFIXES[:4])}, ...)"
    )


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a sort key that orders numbers in file names by value: im9 before im10."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)
    ]


def image_files(folder: Path) -> list[Path]:
    """List the images in `folder`, in natural order.

    Raises:
        InputError: There is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}")
    files = [file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES]
    return sorted(files, key=lambda file: natural_order(file.name))


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of the upright image, as :func:`sfmkit.io.images.read_image` does.

    Only the header is read if Pillow supports the format.

    Raises:
        ImageError: The file is not an image.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with PIL.Image.open(path) as picture:
                turned = picture.getexif().get(_ORIENTATION) in _TURNED
                return picture.size[::-1] if turned else picture.size
    except Exception:  # Pillow raises almost anything; reading the image states what is wrong
        return read_image(path).size_wh


def read_homography(path: str | os.PathLike) -> np.ndarray:
    """Read a (3, 3) float64 homography from a text file of nine numbers.

    Returns:
        The matrix, scaled to ``H[2, 2] = 1``.

    Raises:
        InputError: There is no such file, it does not hold nine finite numbers, or the matrix is
            singular.
    """
    path = Path(path)
    try:
        words = path.read_text(encoding="utf-8-sig").replace(",", " ").split()
    except FileNotFoundError:
        raise InputError(
            f"there is no homography file {path}; the data set is incomplete"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read as text: {error}") from error
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{path} holds a word that is not a number: {error}") from None
    if len(numbers) != 9:
        raise InputError(
            f"{path} holds {len(numbers)} numbers; a homography has nine, in three rows"
        )
    H = numbers.reshape(3, 3)
    with np.errstate(all="ignore"):
        H = H / H[2, 2]
        singular = not np.isfinite(H).all() or not abs(np.linalg.det(H)) >= 1e-12
    if singular:
        raise InputError(
            f"{path} does not hold a homography: it is singular, not finite, or its last number "
            "is 0"
        )
    return H
