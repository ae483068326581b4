"""Stage 1: one call for every feature operator, ``detect(image, "surf") -> Features``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np

from ..errors import InputError, OperatorError
from ..types import Features
from .builtin import BuiltInOperator
from .learned import LearnedOperator
from .plugins import OPERATOR_PLUGINS, run_operator
from .selection import select_evenly


def detect(
    image: Any,
    operator: str = "surf",
    *,
    budget: int | None = None,
    mask: np.ndarray | None = None,
    max_size: int | None = None,
    preset: Literal["default", "paper", "dense"] = "default",
    device: Any = None,
    **options: Any,
) -> Features:
    """Find and describe the keypoints of an image.

    Args:
        image: (H, W) or (H, W, 3) uint8, RGB; or an :class:`sfmkit.io.images.Image`.
        operator: The name of an operator (``sfmkit operators`` lists them), ``detector+descriptor``
            (``fast+freak``), ``affine-`` and a name, or the import path of a plug-in
            (``mypackage.mine:detect``).
        budget: At most this many keypoints, strong ones spread evenly
            (:func:`~.selection.select_evenly`).
        mask: (H, W); keypoints where it is zero are dropped. It is applied after detection, so an
            operator's own limits (``nfeatures``, relative thresholds) refer to the whole image.
        max_size: The longest side, in pixels, at which to search; a larger image is reduced first.
            Positions and scales are those of the full image.
        preset: Which settings are used where `options` does not say: ours, the paper's, or ours
            for as many keypoints as can be matched (``dense``: half the least contrast).
        device: Where operators in torch compute (SURF, XFeat); the others ignore it.
        options: Of the operator; ``OPERATORS[name].options`` lists those of a built-in one with
            their defaults. Where detector and descriptor share a name, it is the detector's.
            ``subpixel`` refines whole-pixel corners, ``oriented`` gives upright corners the
            orientation of their intensity centroid.

    Returns:
        The features, the same bits for the same input. An image without any gives empty arrays of
        the right widths.

    Raises:
        OperatorError: The operator is unknown or not available here, fails on this image, or is a
            plug-in that breaks its contract.
        InputError: An unusable image, mask, size, budget or option.
    """
    name = OPERATOR_PLUGINS.canonical(operator)
    rgb = _rgb(image)
    height, width = rgb.shape[:2]
    if budget is not None and not _is_positive(budget):
        raise InputError(
            f"the keypoint budget must be a whole number of at least 1, not {budget!r}"
        )
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != (height, width):
            raise InputError(
                f"the mask must have the image's shape {(height, width)}, not {mask.shape}"
            )
    small, scale = _reduced(rgb, max_size)
    grey, _ = _reduced(_grey(image, rgb), max_size)
    small_wh = (small.shape[1], small.shape[0])

    def select(xy: np.ndarray, scores: np.ndarray) -> np.ndarray:
        rows = np.arange(len(xy))
        if mask is not None:
            at = np.rint(_full_size(xy, scale)).astype(np.int64)
            x, y = np.clip(at, 0, (width - 1, height - 1)).T
            rows = rows[mask[y, x] != 0]
        if budget is not None:
            rows = rows[select_evenly(xy[rows], scores[rows], budget, small_wh)]
        return rows

    found = run_operator(
        name, small, grey=grey, select=select, preset=preset, device=device, **options
    )
    xy = np.clip(_full_size(found.keypoints, scale), 0, (width - 1, height - 1))
    return replace(
        found,
        keypoints=xy.astype(np.float32),
        scales=(found.scales / math.sqrt(scale[0] * scale[1])).astype(np.float32),
        operator=name,
        size_wh=(width, height),
    )


def _is_positive(value: Any) -> bool:
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and bool(value >= 1)


def _rgb(image: Any) -> np.ndarray:
    """(H, W, 3) uint8, contiguous."""
    array = getattr(image, "rgb", image)
    if not isinstance(array, np.ndarray):
        raise InputError(
            "image must be an (H, W) or (H, W, 3) uint8 array or an sfmkit Image, not "
            f"{type(image).__name__}; read a file with sfmkit.read_image"
        )
    if array.dtype != np.uint8:
        raise InputError(
            f"image must be uint8, not {array.dtype}; scale it to 0..255 and convert it first"
        )
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3) or 0 in array.shape:
        raise InputError(
            f"image must be (H, W) grey or (H, W, 3) RGB with at least one pixel, not {array.shape}"
        )
    array = np.ascontiguousarray(array)
    return cv2.cvtColor(array, cv2.COLOR_GRAY2RGB) if array.ndim == 2 else array


def _grey(image: Any, rgb: np.ndarray) -> np.ndarray:
    """(H, W) uint8."""
    grey = getattr(image, "grey", image)
    return grey if grey.ndim == 2 else cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)


def _reduced(image: np.ndarray, max_size: int | None) -> tuple[np.ndarray, tuple[float, float]]:
    """The image with its longest side at most `max_size`, and the true scales of x and y."""
    if max_size is None:
        return image, (1.0, 1.0)
    if not _is_positive(max_size):
        raise InputError(
            f"max_size must be a whole number of pixels of at least 1, not {max_size!r}"
        )
    h, w = image.shape[:2]
    if max(h, w) <= max_size:
        return image, (1.0, 1.0)
    new_w, new_h = (max(1, round(side * max_size / max(h, w))) for side in (w, h))
    return cv2.resize(image, (new_w, new_h), interpolation=cv2.INTER_AREA), (new_w / w, new_h / h)


def _full_size(xy: np.ndarray, scale: tuple[float, float]) -> np.ndarray:
    """Pixels of the full image from those of the reduced one; pixel centres are whole numbers."""
    return (xy.astype(np.float64) + 0.5) / scale - 0.5


@dataclass(frozen=True)
class OperatorInfo:
    """One line of the table of operators.

    Attributes:
        name: Of the operator.
        norm, width: Of its descriptors, in words; ``?`` for a plug-in, whose descriptors are known
            only once it has run.
        available: Whether it can run here.
        reason: What is missing where it cannot.
        licence: Of the implementation, and patents; for a plug-in, where its code comes from.
        summary: One line.
    """

    name: str
    norm: str
    width: str
    available: bool
    reason: str
    licence: str
    summary: str


def available(name: str) -> tuple[bool, str]:
    """Whether an operator can run here, and if not, what to install.

    Raises:
        OperatorError: There is no such operator.
    """
    check = getattr(OPERATOR_PLUGINS[name], "available", None)
    return (True, "") if check is None else check()


def choose_operators(names: Iterable[str]) -> tuple[str, ...]:
    """The canonical names of operators that can run here, each once, in the given order.

    Raises:
        InputError: There is none, or one is not available here.
        OperatorError: One is unknown.
    """
    chosen = tuple(dict.fromkeys(OPERATOR_PLUGINS.canonical(name) for name in names))
    if not chosen:
        raise InputError("name at least one operator")
    for name in chosen:
        usable, reason = available(name)
        if not usable:
            raise InputError(f"operator '{name}' is not available here: {reason}")
    return chosen


def list_operators() -> list[OperatorInfo]:
    """Every operator that has a name here, for a table."""
    return [_info(name) for name in OPERATOR_PLUGINS]


def _info(name: str) -> OperatorInfo:
    try:
        operator = OPERATOR_PLUGINS[name]
    except OperatorError as error:  # an entry point that cannot be loaded
        return OperatorInfo(name, "?", "?", False, str(error), "?", "")
    if isinstance(operator, (BuiltInOperator, LearnedOperator)):
        spec = operator.spec if isinstance(operator, BuiltInOperator) else operator
        usable, reason = operator.available()
        width = f"{spec.width} {'bits' if spec.norm == 'hamming' else 'floats'}"
        return OperatorInfo(name, spec.norm, width, usable, reason, spec.licence, spec.summary)
    summary = (operator.__doc__ or "").strip().partition("\n")[0]
    return OperatorInfo(name, "?", "?", True, "", OPERATOR_PLUGINS.provenance(name), summary)
