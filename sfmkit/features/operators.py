"""Stage 1: detection and description with any operator, ``detect(image, "surf")``."""

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
        budget: Maximum number of keypoints; strong keypoints are selected evenly over the image
            (:func:`~.selection.select_evenly`).
        mask: (H, W) array; keypoints where it is zero are dropped. The mask is applied after
            detection, so an operator's own limits (``nfeatures``, relative thresholds) refer to the
            whole image.
        max_size: Longest side in pixels at which features are detected; a larger image is reduced
            first. Positions and scales are those of the full image.
        preset: Settings for options that are not given: ``default``, ``paper`` (those of the
            paper), or ``dense`` (the default with half the minimum contrast, for as many keypoints
            as can be matched).
        device: Torch device for operators written in torch (SURF, XFeat); others ignore it.
        options: Options of the operator; ``OPERATORS[name].options`` contains those of a built-in
            operator with their defaults. A name that the detector and the descriptor share refers
            to the detector. ``subpixel`` refines whole-pixel corners; ``oriented`` gives upright
            corners the orientation of their intensity centroid.

    Returns:
        The features, bitwise identical for the same input. An image without features gives empty
        arrays of the correct widths.

    Raises:
        OperatorError: The operator is unknown or not available here, fails on this image, or is a
            plug-in that breaks its contract.
        InputError: The image, mask, size, budget or an option is invalid.
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
    """Return the image as contiguous (H, W, 3) uint8."""
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
    """Return the image in grey levels, (H, W) uint8."""
    grey = getattr(image, "grey", image)
    return grey if grey.ndim == 2 else cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)


def _reduced(image: np.ndarray, max_size: int | None) -> tuple[np.ndarray, tuple[float, float]]:
    """Reduce the longest side to `max_size`; return the image and the scales of x and y."""
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
    """Convert pixels of the reduced image to the full image; pixel centres are integers."""
    return (xy.astype(np.float64) + 0.5) / scale - 0.5


@dataclass(frozen=True)
class OperatorInfo:
    """A row of the table of operators.

    Attributes:
        name: Name of the operator.
        norm, width: Norm and width of its descriptors, in words; ``?`` for a plug-in, whose
            descriptors are known only after it has run.
        available: Whether it can run here.
        reason: What is missing if it cannot run.
        licence: Licence of the implementation, and patents; for a plug-in, the provenance of its
            code.
        summary: Description in one line.
    """

    name: str
    norm: str
    width: str
    available: bool
    reason: str
    licence: str
    summary: str


def available(name: str) -> tuple[bool, str]:
    """Return whether an operator can run here and, if not, what to install.

    Raises:
        OperatorError: There is no such operator.
    """
    check = getattr(OPERATOR_PLUGINS[name], "available", None)
    return (True, "") if check is None else check()


def choose_operators(names: Iterable[str]) -> tuple[str, ...]:
    """Return the canonical names of operators, each once, in the given order.

    Raises:
        InputError: No operator is given, or one is not available here.
        OperatorError: An operator is unknown.
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
    """List all registered and installed operators."""
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
