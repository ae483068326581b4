"""A COLMAP model as a data set, with cameras and poses from the reconstruction."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from ..errors import InputError
from ..io.colmap import image_path, model_suffix, read_colmap
from .pair import Pair, natural_order
from .photographs import choose_pairs


def colmap(
    root: str | os.PathLike,
    sequences: Iterable[str] | None = None,
    *,
    images: str | os.PathLike | None = None,
) -> Iterator[Pair]:
    """Yield the pairs of a COLMAP model, text or binary, with cameras and poses.

    Args:
        root: Folder with ``cameras`` and ``images`` as ``.txt`` or ``.bin``, or with such a model
            in ``sparse`` or ``sparse/0``.
        sequences: ``consecutive`` (the default: each image with the next one, in natural order of
            the names) or ``all`` (all pairs).
        images: Folder of the images; None for ``images`` beside or above the model, or the folder
            of the model itself.

    Raises:
        InputError: A file is missing or malformed, a camera model is not supported, an image is
            missing or its name points outside the folder, or there are fewer than two images.
    """
    model = model_folder(Path(root))
    if model is None:
        raise InputError(f"{root} holds no COLMAP model (cameras and images as .txt or .bin)")
    read = read_colmap(model, observations=False)
    posed = sorted(read.images.values(), key=lambda image: natural_order(image.name))
    folder = _image_folder(model, [image.name for image in posed], images)
    for sequence, a, b in choose_pairs(posed, sequences, str(model)):
        R = b.R @ a.R.T
        yield Pair(
            "colmap",
            sequence,
            f"{_stem(a.name)}-{_stem(b.name)}",
            image_path(folder, a.name),
            image_path(folder, b.name),
            read.camera(a),
            read.camera(b),
            R=R,
            t=b.t - R @ a.t,
        )


def model_folder(path: Path) -> Path | None:
    """Return the folder of the model at or below `path`, or None."""
    for folder in (path, path / "sparse", path / "sparse" / "0"):
        if model_suffix(folder):
            return folder
    return None


def _image_folder(model: Path, names: Sequence[str], images: str | os.PathLike | None) -> Path:
    """Find the folder that contains all images of the model.

    Raises:
        InputError: None of the candidates contains them, or a name points outside the folder.
    """
    beside = [model / "images", model.parent / "images", model.parent.parent / "images", model]
    candidates = beside if images is None else [Path(images)]
    missing = ""
    for folder in candidates:
        absent = [name for name in names if not image_path(folder, name).is_file()]
        if not absent:
            return folder
        missing = missing or f"{absent[0]}, which is not in {folder}"
    raise InputError(f"the model in {model} names {missing}; give the folder of the images")


def _stem(name: str) -> str:
    return str(PurePosixPath(name.replace("\\", "/")).with_suffix(""))
