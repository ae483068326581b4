"""Trace every keypoint and match through the pipeline, to a 3-D point or to its rejection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from ..estimation import undistorted_pixels
from ..geometry.coordinates import normalize
from ..geometry.fundamental import signed_sampson_distance
from ..geometry.homography import squared_transfer_error
from ..geometry.pose import cheirality
from ..types import Correspondences, Features, Matches, PointCloud, TwoView, Verdict

POINT = "point"
INLIER = "inlier without a point"
OFF_LINE = "outlier: off its epipolar line"
OFF_HOMOGRAPHY = "outlier: off the homography"
BEHIND = "outlier: behind a camera"
NO_GEOMETRY = "no geometry to agree with"
MERGED = "merged into a duplicate"
UNMATCHED = "unmatched"


@dataclass(frozen=True, eq=False)
class Trace:
    """The outcome of N correspondences.

    Attributes:
        fate: (N,) one of the constants of this module.
        distance_px: (N,) float64 Sampson distance to the epipolar geometry, or transfer error if a
            homography is the model; NaN without a model.
        point: (N,) int64 row of the cloud, -1 for none.
        operators: (N,) names of all operators that found it, joined by ``+``.
    """

    fate: np.ndarray
    distance_px: np.ndarray
    point: np.ndarray
    operators: np.ndarray


def trace(
    corr: Correspondences, view: TwoView, cloud: PointCloud | None, threshold_px: float
) -> Trace:
    """Determine the outcome of every correspondence.

    Args:
        threshold_px: largest distance of an inlier; separates the two kinds of outliers.
    """
    x1, x2 = undistorted_pixels(corr, view.camera1, view.camera2)
    n = len(corr)
    distance = torch.full((n,), torch.nan, dtype=torch.float64)
    fate = np.full(n, NO_GEOMETRY, dtype=object)
    if view.verdict is Verdict.PURE_ROTATION and view.H is not None:
        distance = squared_transfer_error(view.H, x1, x2).sqrt()
        fate[:] = OFF_HOMOGRAPHY
    elif view.F is not None:
        distance = signed_sampson_distance(view.F, x1, x2).abs()
        if view.verdict is not Verdict.TOO_LITTLE:
            fate[:] = OFF_LINE
    if view.R is not None and view.t is not None:
        (K1, _), (K2, _) = view.camera1.tensors(), view.camera2.tensors()
        in_front = cheirality(normalize(x1, K1), normalize(x2, K2), view.R, view.t)
        fate[((distance < threshold_px) & ~in_front).numpy()] = BEHIND
    fate[view.inliers.numpy()] = INLIER
    point = np.full(n, -1, dtype=np.int64)
    if cloud is not None:
        point[cloud.match.numpy()] = np.arange(len(cloud))
        fate[point >= 0] = POINT
    return Trace(
        fate.astype(str),
        distance.numpy(),
        point,
        joined_names(corr.operator_mask.numpy(), corr.operators),
    )


def joined_names(mask: np.ndarray, operators: tuple[str, ...]) -> np.ndarray:
    """Convert bit masks (N,) int64 to joined names of operators (N,) str, e.g. ``surf+orb``."""
    values, inverse = np.unique(mask, return_inverse=True)
    names = [
        "+".join(name for k, name in enumerate(operators) if value >> k & 1)
        for value in values.tolist()
    ]
    return np.array(names, dtype=str)[inverse] if len(values) else np.zeros(0, dtype=str)


def matches_to_rows(
    features: Mapping[str, tuple[Features, Features]],
    matches: Mapping[str, Matches],
    corr: Correspondences,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Find the fused correspondence of every match, per operator.

    Returns:
        For each operator ``(rows, merged)``: (M,) int64 the correspondence of a match, and (M,)
        bool whether the match was merged into it as a duplicate. The correspondence of a merged
        match is the nearest one, in both images together, that its operator also found.
    """
    operator_id, mask = corr.operator_id.numpy(), corr.operator_mask.numpy()
    index1, index2 = corr.index1.numpy(), corr.index2.numpy()
    places = np.concatenate([corr.x1.numpy(), corr.x2.numpy()], axis=1)
    found = {}
    for k, name in enumerate(corr.operators):
        m, (f1, f2) = matches[name], features[name]
        own = np.flatnonzero(operator_id == k)
        width = max(len(f2), 1)
        keys = index1[own] * width + index2[own]
        order = np.argsort(keys)
        wanted = m.index1 * width + m.index2
        at = np.searchsorted(keys, wanted, sorter=order)
        slot = (
            order[np.minimum(at, len(order) - 1)] if len(own) else np.zeros(len(m), dtype=np.int64)
        )
        merged = keys[slot] != wanted if len(own) else np.ones(len(m), dtype=bool)
        rows = own[slot] if len(own) else np.full(len(m), -1)
        with_k = np.flatnonzero(mask >> k & 1)
        if merged.any() and len(with_k):
            lost = np.concatenate(
                [f1.keypoints[m.index1[merged]], f2.keypoints[m.index2[merged]]], axis=1
            )
            rows[merged] = with_k[cKDTree(places[with_k]).query(lost)[1]]
        found[name] = (rows, merged)
    return found


@dataclass(frozen=True, eq=False)
class KeypointTrace:
    """The outcome of an operator's N keypoints in one image.

    Attributes:
        fate: (N,) str.
        match: (N,) int64 row of the correspondence, -1 for none.
        point: (N,) int64 row of the cloud, -1 for none.
        partner: (N,) int64 row of the matched keypoint in the other image, -1 for none.
        distance, ratio: (N,) float32 of the match's descriptors; NaN without a match.
    """

    fate: np.ndarray
    match: np.ndarray
    point: np.ndarray
    partner: np.ndarray
    distance: np.ndarray
    ratio: np.ndarray


def trace_keypoints(
    features: Mapping[str, tuple[Features, Features]],
    matches: Mapping[str, Matches],
    corr: Correspondences,
    traced: Trace,
) -> dict[str, tuple[KeypointTrace, KeypointTrace]]:
    """Determine the outcome of every keypoint of every operator, in both images."""
    became = {}
    for name, (rows, merged) in matches_to_rows(features, matches, corr).items():
        m = matches[name]
        pair = []
        for f, index, other in zip(
            features[name], (m.index1, m.index2), (m.index2, m.index1), strict=True
        ):
            match = np.full(len(f), -1, dtype=np.int64)
            match[index] = rows
            fate = np.full(len(f), UNMATCHED, dtype=object)
            fate[index] = np.where(
                merged, MERGED, traced.fate[rows] if len(traced.fate) else MERGED
            )
            point = np.where(match >= 0, traced.point[match] if len(traced.point) else -1, -1)
            partner = np.full(len(f), -1, dtype=np.int64)
            partner[index] = other
            distance, ratio = np.full((2, len(f)), np.nan, dtype=np.float32)
            distance[index], ratio[index] = m.distance, m.ratio
            pair.append(KeypointTrace(fate.astype(str), match, point, partner, distance, ratio))
        became[name] = (pair[0], pair[1])
    return became
