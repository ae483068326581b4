"""The geometry of two views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import torch
from torch import Tensor

from ..errors import InputError
from ._checks import check_tensor
from .camera import Camera
from .frozen_mapping import FrozenMapping


class Verdict(StrEnum):
    """The kind of geometry that the correspondences support.

    An ambiguous geometry has a pose, which is one of several that the matches support.
    """

    GENERAL = "general"
    PLANAR = "planar"
    PURE_ROTATION = "pure rotation"
    AMBIGUOUS = "ambiguous"
    TOO_LITTLE = "too little evidence"


@dataclass(frozen=True, eq=False)
class Improvement:
    """A model that was the best one so far during a robust search.

    Attributes:
        iteration: Number of minimal samples drawn so far.
        model: (3, 3) matrix.
        inliers: Number of matches that agree with the model, among those it was scored on.
        score: Mean score of these matches, in [0, 1].
        stage: ``sample``, ``local optimisation`` or ``refinement``.
    """

    iteration: int
    model: Tensor
    inliers: int
    score: float
    stage: str


@dataclass(frozen=True, eq=False)
class TwoView:
    """The geometry of two views: the pose of camera 2 with respect to camera 1.

    The pose maps the frame of camera 1 to that of camera 2, ``X2 = R X1 + t``.

    Attributes:
        camera1, camera2: The cameras.
        inliers: (N,) bool over the correspondences.
        verdict: General, planar, pure rotation, ambiguous or too little evidence.
        reason: The verdict in words.
        evidence: The numbers on which the verdict is based.
        R: (3, 3) rotation; None for too little evidence.
        t: (3,) translation of unit length; None for a pure rotation or too little evidence.
        E, F, H: (3, 3) essential matrix, fundamental matrix (pixels) and homography (pixels); None
            if not estimated.
        pose_covariance: (5, 5) covariance of the rotation vector in radians and of the direction of
            the translation in its tangent plane in radians; None if not computed.
        sigma_deg: Standard deviations of the rotation and of the direction of the translation in
            degrees, from `pose_covariance`.
        sigma_parts_deg: The same for each part of the uncertainty alone (``pixel noise``,
            ``image regions``, ``cameras``); see :mod:`sfmkit.estimation.pose_uncertainty`. Empty if
            not computed.
        alternatives: Other poses (R, t) that explain the matches as well: a plane usually permits
            two, and repeated texture permits further ones.
        witnesses: Operator -> log10 of the probability that so many of its matches agree by chance
            with the pose that the other operators determine; empty if not computed.
        history: Improvements of the robust search, oldest first; empty if the back end does not
            report them. The models are E in normalised coordinates or F in pixels, depending on
            what was estimated.
    """

    camera1: Camera
    camera2: Camera
    inliers: Tensor
    verdict: Verdict
    reason: str = ""
    evidence: Mapping[str, float] = field(default_factory=dict)
    R: Tensor | None = None
    t: Tensor | None = None
    E: Tensor | None = None
    F: Tensor | None = None
    H: Tensor | None = None
    pose_covariance: Tensor | None = None
    sigma_deg: tuple[float, float] | None = None
    sigma_parts_deg: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    alternatives: tuple[tuple[Tensor, Tensor], ...] = ()
    witnesses: Mapping[str, float] = field(default_factory=dict)
    history: tuple[Improvement, ...] = ()

    def __post_init__(self) -> None:
        check_tensor("TwoView", "inliers", self.inliers, (None,), torch.bool)
        for name in ("R", "E", "F", "H"):
            value = getattr(self, name)
            if value is not None:
                check_tensor("TwoView", name, value, (3, 3), torch.float64)
        if self.t is not None:
            check_tensor("TwoView", "t", self.t, (3,), torch.float64)
            if abs(float(self.t.norm()) - 1) > 1e-6:
                raise InputError(f"TwoView.t must have unit length, not {float(self.t.norm()):g}")
        if self.pose_covariance is not None:
            check_tensor("TwoView", "pose_covariance", self.pose_covariance, (5, 5), torch.float64)
        if self.verdict is Verdict.TOO_LITTLE and self.R is not None:
            raise InputError("TwoView: a verdict of too little evidence comes without a pose")
        object.__setattr__(self, "evidence", FrozenMapping(self.evidence))
        object.__setattr__(self, "sigma_parts_deg", FrozenMapping(self.sigma_parts_deg))
        object.__setattr__(self, "witnesses", FrozenMapping(self.witnesses))
