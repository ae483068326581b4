"""LightGlue through kornia: a learned matcher for ALIKED, DISK, XFeat and SIFT features.

Source: Lindenberger et al., LightGlue, ICCV 2023; Potje et al., XFeat, CVPR 2024 (LighterGlue).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import InputError, OperatorError
from ..features.weights import find_weights, how_to_get, load_weights, weights_digest
from ..types import Features, Matches

# the names of these operators are those of kornia's configurations
TRAINED_FOR = ("aliked", "disk", "xfeat", "sift")


@dataclass(frozen=True)
class LightGlueMatcher:
    """LightGlue as a matcher; see :class:`sfmkit.matching.plugins.Matcher`."""

    operators = ", ".join(TRAINED_FOR)
    licence = "Apache-2.0 (kornia and weights)"
    summary = "attention network that matches both images jointly (Lindenberger et al. 2023)"

    def available(self) -> tuple[bool, str]:
        """Return whether any of the weights are installed and, if not, how to get some."""
        if any(find_weights(f"lightglue-{name}") for name in TRAINED_FOR):
            return True, ""
        return False, how_to_get("lightglue-aliked")

    def provenance(self) -> str:
        """Return digests of the weights, which are part of cache keys and reports."""
        digests = (f"{name}:{weights_digest(f'lightglue-{name}')}" for name in TRAINED_FOR)
        return "weights " + ", ".join(digests)

    def __call__(
        self,
        features1: Features,
        features2: Features,
        *,
        filter_threshold: float = 0.1,
        device: str | torch.device | None = None,
    ) -> Matches:
        """Match the features of two images.

        Args:
            features1, features2: Features of one operator of :data:`TRAINED_FOR`.
            filter_threshold: Smallest matching score, 0 to 1.
            device: Torch device on which the network runs; None for the CPU.

        Returns:
            One match per matched keypoint. `distance` is one minus the matching score; `ratio` is
            NaN, because LightGlue does not compare with the second-best neighbour.

        Raises:
            InputError: The features are of an unsupported operator or of two operators, or the
                threshold is out of range.
            OperatorError: The weights are missing.
        """
        operator = features1.operator
        if features2.operator != operator:
            raise InputError(f"cannot match {operator} with {features2.operator} features")
        if operator not in TRAINED_FOR:
            known = ", ".join(TRAINED_FOR)
            raise InputError(f"LightGlue is not trained for '{operator}', only for {known}")
        if not 0 <= filter_threshold <= 1:
            raise InputError(f"filter_threshold must be from 0 to 1, not {filter_threshold}")
        if not len(features1) or not len(features2):
            rows, scores = np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.float32)
        else:
            model = _model(
                operator,
                str(device or "cpu"),
                filter_threshold,
                weights_digest(f"lightglue-{operator}"),
            )
            both = enumerate((features1, features2))
            with torch.inference_mode():
                found = model({f"image{k}": _data(f, device) for k, f in both})
            rows = found["matches"][0].cpu().numpy().astype(np.int64)
            scores = found["scores"][0].float().cpu().numpy()
        unknown = np.full(len(rows), np.nan, dtype=np.float32)
        return Matches(rows[:, 0], rows[:, 1], 1 - scores, unknown)


lightglue = LightGlueMatcher()


def _data(f: Features, device: str | torch.device | None) -> dict[str, Tensor]:
    to = device or "cpu"
    data = {
        "keypoints": torch.from_numpy(f.keypoints)[None].to(to),
        "descriptors": torch.from_numpy(f.descriptors)[None].to(to),
        "image_size": torch.tensor([f.size_wh], dtype=torch.float32, device=to),
    }
    if f.operator == "sift":
        data["scales"] = torch.from_numpy(f.scales)[None].to(to)
        data["oris"] = torch.from_numpy(f.angles)[None].to(to)
        # The network was trained on root-normalised descriptors (Arandjelovic and Zisserman, CVPR
        # 2012).
        d = nn.functional.normalize(data["descriptors"], p=1, dim=-1).sqrt()
        data["descriptors"] = nn.functional.normalize(d, dim=-1)
    return data


@lru_cache(maxsize=4)
def _model(operator: str, device: str, filter_threshold: float, digest: str) -> nn.Module:
    from kornia.feature import LightGlue

    settings = dict(LightGlue.features[operator])
    settings.pop("weights")  # otherwise the constructor downloads them
    model = LightGlue(None, **{**settings, "filter_threshold": filter_threshold})  # type: ignore[arg-type]
    state = load_weights(f"lightglue-{operator}")
    # The layers of checkpoints have the names of the original code: matcher.self_attn.3.x is
    # transformers.3.self_attn.x in kornia.
    renamed = {}
    for key, value in state.items():
        parts = key.removeprefix("matcher.").split(".")
        if parts[0] in ("self_attn", "cross_attn"):
            parts = ["transformers", parts[1], parts[0], *parts[2:]]
        renamed[".".join(parts)] = value
    missing = model.load_state_dict(renamed, strict=False).missing_keys
    learned = {name for name, _ in model.named_parameters()}
    if absent := learned & set(missing):
        raise OperatorError(f"the weights lightglue-{operator} lack {len(absent)} layers")
    return model.eval().to(device)
