"""LightGlue through kornia: a learned matcher for ALIKED, DISK, XFeat and SIFT features.

Source: Lindenberger et al., LightGlue, ICCV 2023; Potje et al., XFeat, CVPR 2024 (LighterGlue).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import InputError
from ..features.weights import load_weights
from ..types import Features, Matches

# the operator's features -> kornia's name of the configuration
_TRAINED_FOR = {"aliked": "aliked", "disk": "disk", "xfeat": "xfeat", "sift": "sift"}


def lightglue(
    features1: Features,
    features2: Features,
    *,
    filter_threshold: float = 0.1,
    device: str | torch.device | None = None,
) -> Matches:
    """Match the features of two images by LightGlue.

    Args:
        features1, features2: Features of one operator that LightGlue was trained for: ``aliked``,
            ``disk``, ``xfeat`` or ``sift``.
        filter_threshold: Least matching score, 0 to 1.
        device: Where the network runs; None for the CPU.

    Returns:
        One match per matched keypoint; `distance` is the L2 distance of the descriptors, `ratio` is
        NaN, since LightGlue does not compare with the second-best neighbour.

    Raises:
        InputError: Features of another operator or of two operators.
        OperatorError: The weights are missing.
    """
    operator = features1.operator
    if features2.operator != operator:
        raise InputError(f"cannot match {operator} with {features2.operator} features")
    if operator not in _TRAINED_FOR:
        known = ", ".join(_TRAINED_FOR)
        raise InputError(f"LightGlue is not trained for '{operator}'; it is for {known}")
    if not len(features1) or not len(features2):
        return _matches(features1, features2, np.zeros((0, 2), dtype=np.int64))
    model = _model(operator, str(device or "cpu"), filter_threshold)
    data = {f"image{k}": _data(f, operator, device) for k, f in enumerate((features1, features2))}
    with torch.inference_mode():
        rows = model(data)["matches"][0]
    return _matches(features1, features2, rows.cpu().numpy().astype(np.int64))


def _data(f: Features, operator: str, device: str | torch.device | None) -> dict[str, Tensor]:
    to = device or "cpu"
    data = {
        "keypoints": torch.from_numpy(f.keypoints)[None].to(to),
        "descriptors": torch.from_numpy(f.descriptors)[None].to(to),
        "image_size": torch.tensor([f.size_wh], dtype=torch.float32, device=to),
    }
    if operator == "sift":
        data["scales"] = torch.from_numpy(f.scales)[None].to(to)
        data["oris"] = torch.from_numpy(f.angles)[None].to(to)
        # trained on root-normalised descriptors (Arandjelovic and Zisserman, CVPR 2012)
        d = nn.functional.normalize(data["descriptors"], p=1, dim=-1).sqrt()
        data["descriptors"] = nn.functional.normalize(d, dim=-1)
    return data


def _matches(features1: Features, features2: Features, rows: np.ndarray) -> Matches:
    i, j = rows.T
    distance = np.linalg.norm(features1.descriptors[i] - features2.descriptors[j], axis=1)
    unknown = np.full(len(rows), np.nan, dtype=np.float32)
    return Matches(i, j, distance.astype(np.float32), unknown)


@lru_cache(maxsize=4)
def _model(operator: str, device: str, filter_threshold: float) -> nn.Module:
    from kornia.feature import LightGlue

    settings = dict(LightGlue.features[_TRAINED_FOR[operator]])
    settings.pop("weights")  # else the constructor downloads them
    model = LightGlue(None, **{**settings, "filter_threshold": filter_threshold})
    state = load_weights(f"lightglue-{operator}")
    # Checkpoints name the layers as the original code does: matcher.self_attn.3.x is
    # transformers.3.self_attn.x here.
    renamed = {}
    for key, value in state.items():
        parts = key.removeprefix("matcher.").split(".")
        if parts[0] in ("self_attn", "cross_attn"):
            parts = ["transformers", parts[1], parts[0], *parts[2:]]
        renamed[".".join(parts)] = value
    missing = model.load_state_dict(renamed, strict=False).missing_keys
    learned = {name for name, _ in model.named_parameters()}
    if absent := learned & set(missing):
        raise InputError(f"the weights lightglue-{operator} lack {len(absent)} layers")
    return model.eval().to(device)
