"""The matches of all operators on one pair of a folder, their fusion and geometry, as one entry."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .._utils.notices import collected
from ..errors import InputError
from ..estimation import within_the_field
from ..matching import find_leaders, represent, run_matcher
from ..pipeline.stages import estimate_geometry
from ..types import Correspondences, Features, Matches, TwoView, Verdict
from .entry import Entry
from .memory import PeakMemory
from .tasks import PairTask

__all__ = ["make_geometry"]

FeaturePair = tuple[Features, Features]
Masks = tuple[np.ndarray | None, np.ndarray | None]


def make_geometry(task: PairTask, features: Mapping[str, FeaturePair], masks: Masks) -> Entry:
    """Match, fuse and estimate the geometry of one pair.

    Args:
        task: The recipe.
        features: Per operator, its features in image 1 and image 2.
        masks: (H, W) uint8 or None per image; keypoints on zeros are not used.

    Returns:
        ``operator``, ``index1``, ``index2``, ``ratio``, ``leader`` and ``inlier`` (M,) of the
        matches of all operators before fusion: row of the operator, rows of its features, ratio of
        the distances, row of the match that represents it after fusion, and whether that one is an
        inlier. The verdict, the pose and the counts are in ``meta``.

    Raises:
        InputError: A mask has another size than its image.
    """
    seconds = {}
    with PeakMemory() as memory, warnings.catch_warnings(), collected():
        warnings.simplefilter("ignore", UserWarning)
        began = time.process_time()
        visible = {
            name: tuple(visible_rows(f, mask) for f, mask in zip(pair, masks))
            for name, pair in features.items()
        }
        matches = {name: _match(task, name, features[name], visible[name]) for name in features}
        seconds["match"] = time.process_time() - began
        began = time.process_time()
        matched = {name: (*features[name], matches[name]) for name in features}
        leader = find_leaders(matched, merge_radius=task.fuse.merge_radius)
        kept = np.flatnonzero(leader == np.arange(len(leader)))
        fused = represent(matched, leader)
        seen = within_the_field(fused, *task.cameras)
        rows = kept[_rows_of(seen, fused)]
        # Photographs of a folder share their cameras, which the mapper refines over all pairs.
        estimate = replace(task.estimate, focal="fixed")
        view, _ = estimate_geometry(seen, task.cameras, estimate, seed=task.seed)
        seconds["estimate"] = time.process_time() - began
    fits = np.zeros(len(leader), dtype=bool)
    fits[rows[view.inliers.numpy()]] = True
    arrays = {
        "operator": np.repeat(
            np.arange(len(matches), dtype=np.uint8), [len(m) for m in matches.values()]
        ),
        "index1": np.concatenate([m.index1 for m in matches.values()]).astype(np.int32),
        "index2": np.concatenate([m.index2 for m in matches.values()]).astype(np.int32),
        "ratio": np.concatenate([m.ratio for m in matches.values()]).astype(np.float32),
        "leader": leader.astype(np.int32),
        "inlier": fits[leader],
    }
    counts = {
        name: {
            "keypoints": [len(rows) for rows in visible[name]],
            "matches": len(matches[name]),
            "inliers": int((view.inliers & seen.found_by(name)).sum()),
        }
        for name in matches
    }
    common = {"operators": counts, "correspondences": len(seen), "seconds": seconds}
    return Entry(task.key, common | _numbers(view) | {"peak_mb": memory.mb}, arrays)


def visible_rows(features: Features, mask: np.ndarray | None) -> np.ndarray:
    """The rows of the keypoints that are not on zeros of a mask.

    Args:
        features: N features of an image.
        mask: (H, W) uint8 of the size of the upright image; None for all rows.

    Raises:
        InputError: The mask has another size.
    """
    if mask is None:
        return np.arange(len(features))
    w, h = features.size_wh
    if mask.shape != (h, w):
        raise InputError(
            f"a mask has {mask.shape[1]} x {mask.shape[0]} pixels and its image {w} x {h} (upright)"
        )
    x, y = np.rint(features.keypoints).astype(int).T
    return np.flatnonzero(mask[y.clip(0, h - 1), x.clip(0, w - 1)])


def _match(task: PairTask, name: str, pair: FeaturePair, rows: tuple[np.ndarray, ...]) -> Matches:
    """The matches of one operator among the visible keypoints, as rows of all features."""
    first, second = (f if len(r) == len(f) else f.take(r) for f, r in zip(pair, rows))
    found = run_matcher(first, second, task.matches[name].options, operator=name)
    return replace(found, index1=rows[0][found.index1], index2=rows[1][found.index2])


def _rows_of(part: Correspondences, whole: Correspondences) -> np.ndarray:
    """The rows of `part`, which was taken from `whole` in order, in `whole`."""
    if len(part) == len(whole):
        return np.arange(len(whole))
    keys = [
        np.stack([c.operator_id.numpy(), c.index1.numpy(), c.index2.numpy()], axis=1)
        for c in (part, whole)
    ]
    wanted = {tuple(key) for key in keys[0].tolist()}
    return np.array([k for k, key in enumerate(keys[1].tolist()) if tuple(key) in wanted], np.int64)


def _numbers(view: TwoView) -> dict[str, Any]:
    """The geometry as JSON values."""
    trusted = view.verdict is not Verdict.TOO_LITTLE

    def flat(matrix: Any) -> list[float] | None:
        return None if matrix is None or not trusted else matrix.flatten().tolist()

    return {
        "verdict": view.verdict.value,
        "reason": view.reason,
        "inliers": int(view.inliers.sum()),
        "sigma_deg": None if view.sigma_deg is None else list(view.sigma_deg),
        "alternatives": len(view.alternatives),
        **{name: flat(getattr(view, name)) for name in ("R", "t", "E", "F", "H")},
    }
