"""Pair lists of the SuperGlue and LightGlue evaluations: ScanNet-1500, YFCC100M, MegaDepth-1500.

A line of a ``*_pairs_with_gt.txt`` list holds 38 words: the two image names, the rotations of both
images in quarter turns, K of both images (9 numbers each) and the 4 x 4 matrix from camera 1 to
camera 2 (Sarlin, DeTone, Malisiewicz & Rabinovich, "SuperGlue", CVPR 2020, evaluation code). K and
the matrix refer to the stored images; the quarter turns are applied to image, K and pose.

The lists of glue-factory (``pairs_calibrated.txt``; Lindenberger, Sarlin & Pollefeys, "LightGlue",
ICCV 2023, evaluation code) have no rotations, and the pose is the 4 x 4 matrix (36 words) or R and
t (32 words).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.images import read_image
from ..types import Camera
from .pair import Pair, image_size
from .pair_list import find_listed_image, reject_sequences

TURNS, MATRIX, R_AND_T = WORDS = (38, 36, 32)  # words of a line with rotations, a matrix, R and t


def pairs_with_gt(
    root: str | os.PathLike,
    sequences: Iterable[str] | None = None,
    *,
    images: str | os.PathLike | None = None,
) -> Iterator[Pair]:
    """Yield the pairs of a list in a text file, with cameras and poses.

    Args:
        root: Path of the list.
        sequences: Must be None, because the format has no sequences.
        images: Folder of the images; None for the folder of the list.

    Raises:
        InputError: The list cannot be read, or a line is malformed: wrong number of words, a word
            that is not a number, an invalid camera or rotation matrix, or a missing image. The
            message names the line.
    """
    file = Path(root)
    reject_sequences(file, sequences)
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file} cannot be read as text: {error}") from None
    folder = file.parent if images is None else Path(images)
    count = 0
    for number, line in enumerate(lines, start=1):
        if line.strip():
            count += 1
            yield _pair(line.split(), f"{file.name}, line {number}", file.stem, folder, str(number))
    if not count:
        raise InputError(f"{file} lists no pairs")


def _pair(words: list[str], where: str, dataset: str, folder: Path, name: str) -> Pair:
    if len(words) not in WORDS:
        raise InputError(
            f"{where}: {len(words)} words; a line has {TURNS}: two image names, two rotations, "
            "K of both images (9 numbers each) and the 4 x 4 matrix from camera 1 to camera 2; or "
            f"{MATRIX} without the rotations; or {R_AND_T} with R and t in place of the matrix"
        )
    paths = [find_listed_image(folder, word, where) for word in words[:2]]
    names = 4 if len(words) == TURNS else 2
    try:
        turns = [int(word) % 4 for word in words[2:names]] or [0, 0]
        numbers = np.array([float(word) for word in words[names:]])
        K1, K2, pose = np.split(numbers, (9, 18))
        R, t = _pose(pose)
        stored = [Camera(K.reshape(3, 3), image_size(path)) for K, path in zip((K1, K2), paths)]
        Z1, Z2 = (_quarter_turns(n) for n in turns)
        return Pair(
            dataset,
            dataset,
            name,
            _turned_image(paths[0], turns[0]),
            _turned_image(paths[1], turns[1]),
            _turned_camera(stored[0], turns[0]),
            _turned_camera(stored[1], turns[1]),
            R=Z2 @ R @ Z1.T,  # X2' = Z2 (R Z1^T X1' + t)
            t=Z2 @ t,
        )
    except (InputError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None


def _pose(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return R (3, 3) and t (3,) of 16 numbers of a matrix, or of 12 numbers of R and t."""
    if len(numbers) == 12:
        return numbers[:9].reshape(3, 3), numbers[9:]
    T = numbers.reshape(4, 4)
    if not np.allclose(T[3], (0, 0, 0, 1)):
        raise InputError(f"the last row of the 4 x 4 matrix is {T[3].tolist()}, not 0 0 0 1")
    return T[:3, :3], T[:3, 3]


def _turned_image(path: Path, turns: int) -> Path | np.ndarray:
    """Turn an image counter-clockwise by quarter turns."""
    return np.ascontiguousarray(np.rot90(read_image(path).rgb, turns)) if turns else path


def _turned_camera(camera: Camera, turns: int) -> Camera:
    """Compute the camera of an image that was turned counter-clockwise by quarter turns.

    One turn maps the pixel (x, y) of an image of width w to (y, w - 1 - x).
    """
    for _ in range(turns):
        (fx, _, cx), (_, fy, cy), _ = camera.K
        w, h = camera.size_wh
        camera = Camera(np.array([[fy, 0, cy], [0, fx, w - 1 - cx], [0, 0, 1]]), (h, w))
    return camera


def _quarter_turns(turns: int) -> np.ndarray:
    """Return the (3, 3) rotation of the camera frame for counter-clockwise quarter turns."""
    quarter = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # (X, Y) -> (Y, -X)
    return np.linalg.matrix_power(quarter, turns)
