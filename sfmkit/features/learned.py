"""Operators with learned weights: ALIKED, DISK and XFeat with the networks of kornia.

Each operator works on a copy of the image whose longest side has at most `image_size` pixels.
Positions are in pixels of the original image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from ..errors import InputError
from ..types import Features
from .weights import WEIGHTS, find_weights, how_to_get, load_weights, weights_digest

# (1, 3, H, W) in [0, 1] -> pixels (N, 2), scores (N,), descriptors (N, D)
Network = Callable[..., tuple[Tensor, Tensor, Tensor]]
_LEAST_SIDE = 32  # pixels: the networks reduce an image by this factor
_CELL = 8.0  # pixels: side of the neighbourhood that one descriptor describes
_BOUNDS = {
    "top_k": (1, 100_000),
    "image_size": (_LEAST_SIDE, 8192),
    "detection_threshold": (-math.inf, math.inf),
}


@dataclass(frozen=True)
class LearnedOperator:
    """A network that finds and describes keypoints.

    :class:`sfmkit.features.plugins.Operator` describes the call.

    Attributes:
        name: Name of the operator.
        network: Function of an image and the options `top_k`, `detection_threshold` and `device`.
        weights: Name of the weights in :data:`sfmkit.features.weights.WEIGHTS`.
        options: Every option with its default.
        width: Length of a descriptor.
        summary: One line with the source.
    """

    name: str
    network: Network
    weights: str
    options: Mapping[str, int | float]
    width: int
    summary: str
    norm = "l2"

    @property
    def licence(self) -> str:
        """Licence of the network's code and weights."""
        return f"Apache-2.0 (kornia); weights {WEIGHTS[self.weights].licence}"

    def provenance(self) -> str:
        """Return the digest of the weights, which is part of cache keys and reports."""
        return f"{self.weights} sha256:{weights_digest(self.weights)}"

    def available(self) -> tuple[bool, str]:
        """Return whether the weights are installed and, if not, how to get them."""
        if find_weights(self.weights) is None:
            return False, how_to_get(self.weights)
        return True, ""

    def __call__(
        self,
        image: np.ndarray,
        *,
        preset: str = "default",
        device: Any = None,
        **options: int | float,
    ) -> Features:
        """Find and describe the features of an (H, W, 3) or (H, W) uint8 image.

        The preset ``dense`` doubles `top_k`.

        Raises:
            OperatorError: The weights are missing.
            InputError: An option is unknown or out of range.
        """
        settings = self._settings(preset, options)
        rgb = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image
        h, w = rgb.shape[:2]
        scale = min(1.0, settings.pop("image_size") / max(h, w))
        small_wh = max(1, round(w * scale)), max(1, round(h * scale))
        if min(small_wh) < _LEAST_SIDE:
            return self._features(np.zeros((0, 2)), np.zeros(0), np.zeros((0, self.width)), 1, w, h)
        if small_wh != (w, h):
            rgb = cv2.resize(rgb, small_wh, interpolation=cv2.INTER_AREA)
        device = str(device or "cpu")
        tensor = torch.from_numpy(np.array(rgb)).to(device).permute(2, 0, 1)[None]
        with torch.inference_mode():
            xy, scores, descriptors = self.network(tensor.float() / 255, device=device, **settings)
            descriptors = nn.functional.normalize(descriptors.float(), dim=1)
        ratio = np.array([w, h]) / small_wh
        full = (xy.double().cpu().numpy() + 0.5) * ratio - 0.5
        return self._features(
            np.clip(full, 0, (w - 1, h - 1)),
            scores.cpu().numpy(),
            descriptors.cpu().numpy(),
            math.sqrt(ratio.prod()),
            w,
            h,
        )

    def _features(
        self,
        xy: np.ndarray,
        scores: np.ndarray,
        descriptors: np.ndarray,
        ratio: float,
        w: int,
        h: int,
    ) -> Features:
        size = np.full(len(xy), _CELL * ratio, dtype=np.float32)
        upright = np.zeros(len(xy), dtype=np.float32)
        rows = xy.astype(np.float32), size, upright, scores.astype(np.float32)
        return Features(*rows, descriptors.astype(np.float32), "l2", self.name, (w, h))

    def _settings(self, preset: str, options: Mapping[str, Any]) -> dict[str, Any]:
        for name, value in options.items():
            if name not in self.options:
                valid = ", ".join(f"{k}={v!r}" for k, v in self.options.items())
                raise InputError(f"operator '{self.name}' has no option '{name}'. It has: {valid}")
            low, high = _BOUNDS[name]
            whole = isinstance(self.options[name], int)
            kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
            fits = isinstance(value, kinds) and not isinstance(value, bool)
            if not (fits and math.isfinite(value) and low <= value <= high):
                kind = "a whole" if whole else "a finite"
                bounds = f" from {low} to {high}" if math.isfinite(high) else ""
                raise InputError(
                    f"option '{name}' of operator '{self.name}' must be {kind} number{bounds}, "
                    f"not {value!r}"
                )
        settings = {**self.options, **options}
        if preset == "dense" and "top_k" not in options:
            settings["top_k"] = 2 * int(settings["top_k"])
        return settings


def aliked(
    image: Tensor, *, top_k: int, detection_threshold: float, device: str
) -> tuple[Tensor, Tensor, Tensor]:
    """Run ALIKED (model n16).

    Source: Zhao et al., ALIKED, IEEE Transactions on Instrumentation and Measurement 2023.
    """
    found = _aliked(top_k, detection_threshold, device, weights_digest("aliked-n16"))(image)[0]
    return found.keypoints, found.keypoint_scores, found.descriptors


def disk(
    image: Tensor, *, top_k: int, detection_threshold: float, device: str
) -> tuple[Tensor, Tensor, Tensor]:
    """Run DISK (weights trained on depth maps).

    Source: Tyszkiewicz et al., DISK, NeurIPS 2020.
    """
    model = _disk(device, weights_digest("disk-depth"))
    found = model(image, n=top_k, score_threshold=detection_threshold, pad_if_not_divisible=True)[0]
    return found.keypoints, found.detection_scores, found.descriptors


def xfeat(
    image: Tensor, *, top_k: int, detection_threshold: float, device: str
) -> tuple[Tensor, Tensor, Tensor]:
    """Run XFeat.

    Source: Potje et al., XFeat, CVPR 2024.
    """
    found = _xfeat(device, weights_digest("xfeat")).detectAndCompute(
        image, top_k=top_k, detection_threshold=detection_threshold
    )[0]
    # kornia resizes the image to multiples of 32 and multiplies the pixels by the ratio of the
    # sides, which ignores that pixel centres are at integers.
    h, w = image.shape[-2:]
    ratio = image.new_tensor([w / (w // 32 * 32), h / (h // 32 * 32)])
    return found["keypoints"] + (ratio - 1) / 2, found["scores"], found["descriptors"]


# `digest` distinguishes the networks of different weight files.
@lru_cache(maxsize=4)
def _aliked(top_k: int, detection_threshold: float, device: str, digest: str) -> nn.Module:
    from kornia.feature import ALIKED

    model = ALIKED("aliked-n16", top_k, detection_threshold)
    model.load_state_dict(load_weights("aliked-n16"), strict=False)
    return model.eval().to(device)


@lru_cache(maxsize=2)
def _disk(device: str, digest: str) -> nn.Module:
    from kornia.feature import DISK

    model = DISK()
    model.load_state_dict(load_weights("disk-depth")["extractor"])
    return model.eval().to(device)


@lru_cache(maxsize=2)
def _xfeat(device: str, digest: str) -> Any:
    from kornia.feature import XFeat

    model = XFeat()
    model.net.load_state_dict(load_weights("xfeat"))
    return model.eval().to(device)


# kornia's default threshold of ALIKED, 0.2, finds 100 to 700 keypoints in a textureless indoor
# photograph of 640 x 480 pixels; 0.01 finds 800 to 2,048 there and solves more pairs.
LEARNED: Mapping[str, LearnedOperator] = MappingProxyType(
    {
        operator.name: operator
        for operator in (
            LearnedOperator(
                "aliked",
                aliked,
                "aliked-n16",
                {"top_k": 2048, "detection_threshold": 0.01, "image_size": 1600},
                128,
                "learned keypoints with deformable descriptors (Zhao et al. 2023)",
            ),
            LearnedOperator(
                "disk",
                disk,
                "disk-depth",
                {"top_k": 2048, "detection_threshold": 0.0, "image_size": 1024},
                128,
                "learned keypoints trained by policy gradient (Tyszkiewicz et al. 2020)",
            ),
            LearnedOperator(
                "xfeat",
                xfeat,
                "xfeat",
                {"top_k": 4096, "detection_threshold": 0.05, "image_size": 1600},
                64,
                "fast learned keypoints and descriptors (Potje et al. 2024)",
            ),
        )
    }
)
