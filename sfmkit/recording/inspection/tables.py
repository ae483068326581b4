"""The keypoints, matches and points of a recorded reconstruction as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..read import Recording, RecordingError
from ..trace import MERGED
from ._columns import POINTS, escaped, operators_of, own_columns


@dataclass(frozen=True, eq=False)
class Keypoints:
    """The N keypoints of one operator in one image.

    Attributes:
        xy: (N, 2) pixels of the recorded photograph (without distortion).
        scale_px, angle_deg, response: (N,) diameter, orientation and score.
        partner: (N,) matched keypoint of the other image, -1 for none.
        distance, ratio: (N,) of the descriptors of that match; NaN for none.
        match: (N,) row of the fused correspondences, -1 for none.
        merged: (N,) bool, whether the match was merged into another one.
    """

    xy: np.ndarray
    scale_px: np.ndarray
    angle_deg: np.ndarray
    response: np.ndarray
    partner: np.ndarray
    distance: np.ndarray
    ratio: np.ndarray
    match: np.ndarray
    merged: np.ndarray


@dataclass(frozen=True, eq=False)
class FusedMatches:
    """The N fused correspondences.

    Attributes:
        kept: (N,) index of the operator whose pixels were kept.
        mask: (N,) bit k is set if operator k found it.
        xy1, xy2: (N, 2) pixels of the recorded photographs (without distortion).
        x1, x2: (N, 2) pixels of the original files.
        keypoint1, keypoint2: (N,) keypoints of the operator `kept`.
        distance, ratio: (N,) of the descriptors.
        fate: (N,) str, a constant of :mod:`sfmkit.recording.trace`.
        distance_px: (N,) from the geometry; NaN without one.
        point: (N,) row of the cloud, -1 for none.
    """

    kept: np.ndarray
    mask: np.ndarray
    xy1: np.ndarray
    xy2: np.ndarray
    x1: np.ndarray
    x2: np.ndarray
    keypoint1: np.ndarray
    keypoint2: np.ndarray
    distance: np.ndarray
    ratio: np.ndarray
    fate: np.ndarray
    distance_px: np.ndarray
    point: np.ndarray


@dataclass(frozen=True, eq=False)
class Points:
    """The M points of the cloud.

    Attributes:
        xyz: (M, 3) baselines, in the frame of camera 1.
        rgb: (M, 3) uint8 colours of the photograph.
        residual_px, parallax_deg: (M,) reprojection error and angle between the rays.
        sigma: (M,) standard deviation along the worst direction, baselines; NaN if not computed.
    """

    xyz: np.ndarray
    rgb: np.ndarray
    residual_px: np.ndarray
    parallax_deg: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class Tables:
    """Everything that was recorded about one reconstruction's keypoints, matches and points.

    Attributes:
        operators: in the order of the bits of the masks.
        keypoints: per operator, those of image 1 and of image 2.
        matches, points: the fused correspondences, and the cloud (of no points without one).
        report: of the reconstruction.
    """

    operators: tuple[str, ...]
    keypoints: Mapping[str, tuple[Keypoints, Keypoints]]
    matches: FusedMatches
    points: Points
    report: Mapping[str, Any]


def read_tables(recording: Recording, prefix: str = "") -> Tables:
    """Read the tables of a reconstruction.

    Raises:
        RecordingError: there is no reconstruction, or an older sfmkit recorded fewer columns.
    """
    report = recording.report(prefix)
    operators = operators_of(recording, prefix)
    try:
        keypoints = {
            name: (_keypoints(recording, prefix, name, 1), _keypoints(recording, prefix, name, 2))
            for name in operators
        }
        matches = _matches(recording, prefix, operators)
    except KeyError as missing:
        raise RecordingError(
            f"{recording.path} lacks the column {missing}: write the recording again"
        ) from None
    return Tables(operators, keypoints, matches, _points(recording, prefix), report)


def _keypoints(recording: Recording, prefix: str, operator: str, image: int) -> Keypoints:
    entity = f"{prefix}/world/cam{image}/image/keypoints/{escaped(operator)}"
    if entity not in recording:
        none = np.zeros(0)
        return Keypoints(np.zeros((0, 2)), none, none, none, *[none.astype(int)] * 5)
    own = own_columns(recording, entity)
    return Keypoints(
        xy=np.asarray(recording.latest(entity)["Points2D:positions"]),
        scale_px=own["scale_px"],
        angle_deg=own["angle_deg"],
        response=own["score"],
        partner=own["partner"],
        distance=own["descriptor_distance"],
        ratio=own["descriptor_ratio"],
        match=own["match"],
        merged=own["fate"] == MERGED,
    )


def _matches(recording: Recording, prefix: str, operators: tuple[str, ...]) -> FusedMatches:
    parts, rows = [], []
    for k, name in enumerate(operators):
        for kind in ("inliers", "outliers"):
            at = [f"{prefix}/world/cam{i}/image/{kind}/{escaped(name)}" for i in (1, 2)]
            if at[0] not in recording:
                continue
            own = own_columns(recording, at[0])
            xy1, xy2 = (np.asarray(recording.latest(a)["Points2D:positions"]) for a in at)
            masks = {
                names: sum(1 << operators.index(n) for n in names.split("+") if n in operators)
                for names in np.unique(own["operators"]).tolist()
            }
            rows.append(own["match"])
            parts.append(
                FusedMatches(
                    kept=np.full(len(xy1), k),
                    mask=np.array([masks[names] for names in own["operators"].tolist()]),
                    xy1=xy1,
                    xy2=xy2,
                    x1=own["x1"],
                    x2=own["x2"],
                    keypoint1=own["keypoint1"],
                    keypoint2=own["keypoint2"],
                    distance=own["descriptor_distance"],
                    ratio=own["descriptor_ratio"],
                    fate=own["fate"],
                    distance_px=own["distance_px"],
                    point=own["point"],
                )
            )
    if not parts:
        flat, pairs, whole = np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=int)
        return FusedMatches(
            whole, whole, pairs, pairs, pairs, pairs, whole, whole, flat, flat,
            np.zeros(0, dtype=str), flat, whole,
        )  # fmt: skip
    order = np.argsort(np.concatenate(rows))
    return FusedMatches(
        *(np.concatenate([getattr(p, f.name) for p in parts])[order] for f in fields(FusedMatches))
    )


def _points(recording: Recording, prefix: str) -> Points:
    entity = f"{prefix}/{POINTS}"
    if entity not in recording:
        none = np.zeros(0)
        return Points(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8), none, none, none)
    own = own_columns(recording, entity)
    rgba = np.asarray(recording.latest(f"{prefix}/world/points/photograph")["Points3D:colors"])
    rgba = rgba.astype(np.uint32)
    return Points(
        xyz=np.asarray(recording.latest(entity)["Points3D:positions"]),
        rgb=np.stack([rgba >> 24 & 255, rgba >> 16 & 255, rgba >> 8 & 255], 1).astype(np.uint8),
        residual_px=own["residual_px"],
        parallax_deg=own["parallax_deg"],
        sigma=own.get("sigma", np.full(len(own["point"]), np.nan)),
    )
