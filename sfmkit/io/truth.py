"""True poses for the evaluation of a reconstruction."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..errors import InputError
from .calibration import load_json, number, read_text, to_array


def read_truth(
    source: str | os.PathLike,
    image1: str | os.PathLike | None = None,
    image2: str | os.PathLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Read the true pose of camera 2 with respect to camera 1, ``X2 = R X1 + t``.

    Args:
        source: A JSON file with ``"R"`` (3x3) and ``"t"`` (3); two ``.camera`` files of the EPFL
            data sets as ``A.camera,B.camera``; or a folder of such files, named ``<image>.camera``.
        image1, image2: Paths of the photographs, to find their files in a folder.

    Returns:
        R (3, 3) and t (3,) float64, t in the units of the source.

    Raises:
        InputError: The file is missing or has other contents, or R is not a rotation matrix.
    """
    text = os.fspath(source)
    path = Path(text)
    if path.is_dir():
        if image1 is None or image2 is None:
            raise InputError(
                f"{path} is a folder of poses: the names of both images are needed to choose from "
                "it"
            )
        files = [path / f"{Path(image).name}.camera" for image in (image1, image2)]
        return _relative(*(_read_pose(file) for file in files))
    if "," in text and not path.exists():
        files = [Path(part.strip()) for part in text.split(",")]
        if len(files) != 2:
            raise InputError(
                f"'{text[:200]}' names {len(files)} files; the truth is two .camera files A,B"
            )
        return _relative(*(_read_pose(file) for file in files))
    data = load_json(read_text(path), path)
    if not isinstance(data, dict) or not {"R", "t"} <= data.keys():
        raise InputError(f'{path} must hold {{"R": 3x3, "t": 3}} with X2 = R X1 + t')
    R, t = to_array(data["R"], "R", path), to_array(data["t"], "t", path).reshape(-1)
    return _rotation(R, path), _vector(t, path)


def _read_pose(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read R and C of an EPFL ``.camera`` file, ``x_cam = R^T (X - C)``."""
    rows = [
        [number(word, str(path)) for word in line.split()]
        for line in read_text(path).splitlines()
        if line.split()
    ]
    if [len(row) for row in rows] != [3] * 8 + [2]:
        raise InputError(
            f"{path} is not a .camera file: it needs K (3 rows), a row of zeros, R (3 rows), C, "
            "and the size"
        )
    return _rotation(np.array(rows[4:7]), path), _vector(np.array(rows[7]), path)


def _relative(
    pose1: tuple[np.ndarray, np.ndarray], pose2: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the relative pose by inserting ``X = R1 X1 + C1`` in ``X2 = R2^T (X - C2)``."""
    (R1, C1), (R2, C2) = pose1, pose2
    return R2.T @ R1, R2.T @ (C1 - C2)


def _rotation(R: np.ndarray, path: Path) -> np.ndarray:
    orthonormal = (
        R.shape == (3, 3)
        and np.abs(R).max() < 2  # not NaN, and small enough to multiply
        and np.allclose(R @ R.T, np.eye(3), atol=1e-3)
        and np.linalg.det(R) > 0
    )
    if not orthonormal:
        raise InputError(
            f"R in {path} is not a rotation: it must be 3x3 and orthonormal with determinant 1"
        )
    return R


def _vector(t: np.ndarray, path: Path) -> np.ndarray:
    if t.shape != (3,) or not np.isfinite(t).all():
        raise InputError(f"{path} needs a translation of three finite numbers")
    return t
