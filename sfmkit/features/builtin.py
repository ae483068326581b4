"""The built-in operators: callables for the rows of :mod:`~sfmkit.features.tables`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import cv2
import numpy as np

from ..errors import InputError, OperatorError
from ..types import Features
from . import opencv
from .bounds import bounds_of
from .opencv import Keypoints
from .subpixel import refine
from .tables import DESCRIPTORS, DETECTORS, OperatorSpec

Select = Callable[[np.ndarray, np.ndarray], np.ndarray]

_CONTRIB_REPAIR = (
    "this OpenCV has no xfeatures2d: another OpenCV package overwrote "
    "opencv-contrib-python-headless. Repair: "
    "pip uninstall -y opencv-python opencv-python-headless && "
    "pip install --force-reinstall --no-deps 'opencv-contrib-python-headless>=5,<6'"
)


def _all(xy: np.ndarray, scores: np.ndarray) -> np.ndarray:
    return np.arange(len(xy))


@dataclass(frozen=True)
class BuiltInOperator:
    """An operator of sfmkit; see :class:`sfmkit.features.plugins.Operator` for the call."""

    spec: OperatorSpec

    @property
    def options(self) -> Mapping[str, Any]:
        """Every option with its default."""
        return self.spec.options

    def available(self) -> tuple[bool, str]:
        """Return whether the operator can run here and, if not, what to install."""
        return available(self.spec)

    def __call__(
        self,
        image: np.ndarray,
        *,
        grey: np.ndarray | None = None,
        select: Select = _all,
        preset: str = "default",
        device: Any = None,
        **options: Any,
    ) -> Features:
        """Return the selected features of an (H, W, 3) or (H, W) uint8 image.

        Raises:
            OperatorError: The operator is not available here, or fails on this image.
            InputError: An option is unknown or out of range.
        """
        usable, reason = available(self.spec)
        if not usable:
            raise OperatorError(f"operator '{self.spec.name}' is not available here: {reason}")
        settings = _settings(self.spec, preset, options)
        if grey is None:
            grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
        if DETECTORS[self.spec.detector].function and not self.spec.is_pair:
            found = _function(DETECTORS[self.spec.detector].function)(
                grey, device=device, **settings
            )
            return found.take(select(found.keypoints, found.scores))
        return _find(self.spec, grey, settings, device, select)


def available(spec: OperatorSpec) -> tuple[bool, str]:
    """Return whether an operator can run here and, if not, what to install."""
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


def _function(path: str | None) -> Callable[..., Any]:
    """Import the function ``module:name`` of this package."""
    assert path is not None
    module, _, name = path.partition(":")
    return getattr(import_module(f".{module}", __package__), name)


def _find(
    spec: OperatorSpec, grey: np.ndarray, settings: dict[str, Any], device: Any, select: Select
) -> Features:
    """Run an operator of OpenCV, or a detector with the descriptor of another operator."""
    size_wh = (grey.shape[1], grey.shape[0])
    subpixel, oriented = settings.pop("subpixel", False), settings.pop("oriented", False)
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
        inside = opencv.describable(kp.xy, spec.descriptor, describer_settings, size_wh)
        kp = kp.take(np.flatnonzero(inside))
        kp = kp.take(select(kp.xy, kp.scores))
        if oriented:
            angles = opencv.centroid_angles(grey, kp.xy)
            kp = Keypoints(kp.xy, kp.sizes, angles, kp.scores, kp.octaves)
            if what.rotates_by is not None:
                describer_settings[what.rotates_by] = True
        kp, descriptors = _describe(grey, kp, spec, describer_settings, device)
    if what.hellinger:
        descriptors = _hellinger(descriptors)
    xy = kp.xy
    if subpixel and len(kp):
        xy = refine(grey, xy, spec.detector, detector_settings, kp.octaves).astype(np.float32)
    # Some of OpenCV's descriptors divide by the gradient of the patch, which may be zero.
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
    function = DETECTORS[detector].function
    if function is None:
        return opencv.detect(grey, detector, settings)
    found = _function(function)(grey, device=device, **settings)
    octaves = np.zeros(len(found), dtype=np.int64)
    return Keypoints(found.keypoints, found.scales, np.rad2deg(found.angles), found.scores, octaves)


def _describe(
    grey: np.ndarray, kp: Keypoints, spec: OperatorSpec, settings: dict[str, Any], device: Any
) -> tuple[Keypoints, np.ndarray]:
    what = DESCRIPTORS[spec.descriptor]
    if what.function is None:
        return opencv.describe(grey, kp, spec.detector, spec.descriptor, settings)
    angles = np.deg2rad(opencv.upright_is_zero(kp.angles))
    sizes = kp.sizes * np.float32(DETECTORS[spec.detector].fast_size * what.size)
    describe = _function(what.function)
    return kp, describe(grey, kp.xy, sizes, angles, device=device, **settings)


def _hellinger(descriptors: np.ndarray) -> np.ndarray:
    """Return the square roots of L1-normalised descriptors.

    Their L2 distance is the Hellinger distance of the original descriptors (Arandjelovic &
    Zisserman 2012).
    """
    total = descriptors.sum(axis=1, keepdims=True)
    return np.sqrt(descriptors / np.maximum(total, np.finfo(np.float32).tiny))


def _settings(spec: OperatorSpec, preset: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Check the options and merge them: defaults, then the preset, then those of the caller."""
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
        whole = isinstance(default, int)
        kinds = (int, np.integer) if whole else (int, np.integer, float, np.floating)
        fits = (
            isinstance(value, kinds)
            and not boolean
            and math.isfinite(value)
            and bool(low <= value <= high)
        )
        want = ("a whole number" if whole else "a finite number") + (
            f" from {low:g} to {high:g}" if math.isfinite(high) else ", not negative"
        )
    if not fits:
        raise InputError(f"option '{name}' of operator '{spec.name}' must be {want}, not {value!r}")
