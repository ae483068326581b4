"""The data that flows: ``image -> Features -> Correspondences -> TwoView -> PointCloud``.

Every type is frozen and checks itself when it is made, so that a later stage, or a notebook cell
that is run out of order, can rely on it. The messages name the field, the shape it needs and what
came instead.

Arrays up to :class:`Features` are NumPy (OpenCV's side); from :class:`Correspondences` on they are
torch tensors in float64, on the CPU unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from .errors import CameraError, InputError

Norm = Literal["l2", "hamming"]

MAX_OPERATORS = 62  # an operator is one bit of an int64 mask


def _check_array(
    owner: str, name: str, a: Any, shape: tuple[int | None, ...], kinds: str, finite: bool = True
) -> None:
    """Raise InputError unless `a` is an array of `shape` (None: any length) whose dtype kind is one
    of `kinds`."""
    if not isinstance(a, np.ndarray):
        raise InputError(f"{owner}.{name} must be a NumPy array, not {type(a).__name__}")
    want = (
        "("
        + ", ".join("N" if s is None else str(s) for s in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )
    if a.ndim != len(shape) or any(s is not None and s != n for s, n in zip(shape, a.shape)):
        raise InputError(f"{owner}.{name} must have shape {want}, not {a.shape}")
    if a.dtype.kind not in kinds:
        raise InputError(f"{owner}.{name} has dtype {a.dtype}, which does not fit")
    if finite and a.dtype.kind == "f" and not np.isfinite(a).all():
        raise InputError(f"{owner}.{name} holds NaN or infinite values")


def _check_tensor(
    owner: str, name: str, a: Any, shape: tuple[int | None, ...], dtype: torch.dtype
) -> None:
    """Raise InputError unless `a` is a tensor of `shape` (None: any length) and `dtype`."""
    if not isinstance(a, Tensor):
        raise InputError(f"{owner}.{name} must be a torch tensor, not {type(a).__name__}")
    if a.ndim != len(shape) or any(s is not None and s != n for s, n in zip(shape, a.shape)):
        want = (
            "("
            + ", ".join("N" if s is None else str(s) for s in shape)
            + ("," if len(shape) == 1 else "")
            + ")"
        )
        raise InputError(f"{owner}.{name} must have shape {want}, not {tuple(a.shape)}")
    if a.dtype != dtype:
        raise InputError(f"{owner}.{name} must be {dtype}, not {a.dtype}")


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with radial-tangential distortion.

    Attributes:
        K: (3, 3) float64 intrinsics in pixels; ``K[2] == (0, 0, 1)``. The centre of the top-left
            pixel is (0, 0).
        size_wh: width and height in pixels of the image that K is for.
        distortion: (5,) float64 ``k1, k2, p1, p2, k3`` (OpenCV's order; Brown 1966), zero for none.
        source: where the focal length came from: ``given``, ``exif: ...`` or ``guessed``.

    Raises:
        CameraError: when no camera can have these intrinsics.
    """

    K: np.ndarray
    size_wh: tuple[int, int]
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))
    source: str = "given"

    def __post_init__(self) -> None:
        K = np.array(self.K, dtype=np.float64)
        if K.shape != (3, 3):
            raise CameraError(f"Camera.K must be a 3x3 matrix, not shape {K.shape}")
        if not np.isfinite(K).all():
            raise CameraError("Camera.K holds NaN or infinite values")
        if not np.allclose(K[2], (0, 0, 1)) or K[1, 0] != 0:
            raise CameraError(
                f"Camera.K must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]]; its last row is {K[2].tolist()}"
            )
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise CameraError(
                f"Camera.K has focal lengths {K[0, 0]:g}, {K[1, 1]:g}; both must be positive (pixels)"
            )
        w, h = (int(v) for v in self.size_wh)
        if w < 1 or h < 1:
            raise CameraError(f"Camera.size_wh must be positive, not {self.size_wh}")
        if not (-w <= K[0, 2] <= 2 * w and -h <= K[1, 2] <= 2 * h):
            raise CameraError(
                f"the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies far outside the {w} x {h} image; "
                "is K for another image size?"
            )
        d = np.zeros(5)
        given = np.atleast_1d(np.asarray(self.distortion, dtype=np.float64))
        if given.ndim != 1 or len(given) > 5 or not np.isfinite(given).all():
            raise CameraError(
                f"Camera.distortion must be up to five finite numbers k1 k2 p1 p2 k3, not {given.tolist()}"
            )
        d[: len(given)] = given
        K.flags.writeable = d.flags.writeable = False
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "size_wh", (w, h))
        object.__setattr__(self, "distortion", d)

    @property
    def has_distortion(self) -> bool:
        return bool(np.any(self.distortion))

    def scaled(self, size_wh: tuple[int, int]) -> Camera:
        """The same camera for the image resized to `size_wh` pixels (pixel centres at integers: c'
        = (c + ½) s - ½)."""
        s = np.array(size_wh, dtype=np.float64) / self.size_wh
        K = self.K.copy()
        K[0, :2] *= s[0]
        K[1, 1] *= s[1]
        K[:2, 2] = (K[:2, 2] + 0.5) * s - 0.5
        return Camera(K, size_wh, self.distortion, self.source)

    def tensors(self, device: torch.device | str = "cpu") -> tuple[Tensor, Tensor | None]:
        """``K (3, 3)`` and the distortion ``(5,)`` (None when there is none) as float64 tensors."""
        d = torch.tensor(self.distortion, device=device) if self.has_distortion else None
        return torch.tensor(self.K, device=device), d


@dataclass(frozen=True, eq=False)
class Features:
    """What one operator found in one image.

    Attributes:
        keypoints: (N, 2) float32 pixels of the full-size image, x right, y down, centre of the
            top-left pixel (0, 0).
        scales: (N,) float32 diameter of the described neighbourhood, pixels.
        angles: (N,) float32 orientation in radians, from x towards y (clockwise on screen); 0 for
            upright operators.
        scores: (N,) float32 the detector's response; larger is stronger, comparable within one
            operator only.
        descriptors: (N, D) float32, or (N, bytes) uint8 of packed bits.
        norm: how descriptors are compared: ``l2`` or ``hamming``.
        operator: the operator's name.
        size_wh: size of the image in pixels.
        laplacian: (N,) int8 sign of the Laplacian (+1 dark blob on light, -1 light on dark) where
            the operator knows it (SURF), else None. Features of different sign cannot match.
    """

    keypoints: np.ndarray
    scales: np.ndarray
    angles: np.ndarray
    scores: np.ndarray
    descriptors: np.ndarray
    norm: Norm
    operator: str
    size_wh: tuple[int, int]
    laplacian: np.ndarray | None = None

    def __post_init__(self) -> None:
        _check_array("Features", "keypoints", self.keypoints, (None, 2), "f")
        n = len(self.keypoints)
        for name in ("scales", "angles", "scores"):
            _check_array("Features", name, getattr(self, name), (n,), "f")
        if self.norm not in ("l2", "hamming"):
            raise InputError(f"Features.norm must be 'l2' or 'hamming', not {self.norm!r}")
        _check_array(
            "Features",
            "descriptors",
            self.descriptors,
            (n, None),
            "f" if self.norm == "l2" else "u",
        )
        if self.norm == "hamming" and self.descriptors.dtype != np.uint8:
            raise InputError(
                f"Features.descriptors of norm hamming must be uint8, not {self.descriptors.dtype}"
            )
        if self.laplacian is not None:
            _check_array("Features", "laplacian", self.laplacian, (n,), "i")

    def __len__(self) -> int:
        return len(self.keypoints)

    def __repr__(self) -> str:
        return (
            f"Features({self.operator}: {len(self):,} keypoints, {self.descriptors.shape[1]} x "
            f"{self.descriptors.dtype}, {self.norm}, image {self.size_wh[0]} x {self.size_wh[1]})"
        )

    def take(self, index: np.ndarray) -> Features:
        """The features at `index` (integers or a mask), in that order."""
        rows = ("keypoints", "scales", "angles", "scores", "descriptors")
        taken = {name: getattr(self, name)[index] for name in rows}
        return replace(
            self, **taken, laplacian=None if self.laplacian is None else self.laplacian[index]
        )


@dataclass(frozen=True, eq=False)
class Matches:
    """One operator's matches between two images, before fusion.

    Attributes:
        index1, index2: (M,) int64 rows of the two Features.
        distance: (M,) float32 descriptor distance (L2, or number of differing bits).
        ratio: (M,) float32 distance over the distance to the second-nearest neighbour in image 2
            (in [0, 1]; NaN where it was not asked for).
    """

    index1: np.ndarray
    index2: np.ndarray
    distance: np.ndarray
    ratio: np.ndarray

    def __post_init__(self) -> None:
        _check_array("Matches", "index1", self.index1, (None,), "i")
        n = len(self.index1)
        _check_array("Matches", "index2", self.index2, (n,), "i")
        _check_array("Matches", "distance", self.distance, (n,), "f")
        _check_array("Matches", "ratio", self.ratio, (n,), "f", finite=False)

    def __len__(self) -> int:
        return len(self.index1)


@dataclass(frozen=True)
class OperatorCounts:
    """What one operator put into a set of correspondences.

    Attributes:
        keypoints: found in image 1 and image 2.
        matches: after the operator's own matching.
        merged: of those, how many were merged into a coincident correspondence of another keypoint
            or operator.
    """

    keypoints: tuple[int, int]
    matches: int
    merged: int = 0


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Matched points of all operators, in pixels, with their provenance.

    Attributes:
        x1, x2: (N, 2) float64 pixels in image 1 and image 2.
        distance: (N,) float64 descriptor distance, comparable within one operator only.
        ratio: (N,) float64 distance over second-best distance, NaN where unknown.
        operator_id: (N,) int64 into `operators`; of a merged correspondence, the operator whose
            position was kept.
        operator_mask: (N,) int64; bit k is set when `operators[k]` found this correspondence.
        index1, index2: (N,) int64 rows of the Features of `operator_id`.
        operators: names; bit and id k is `operators[k]`.
        counts: per operator, what it put in and lost so far.
    """

    x1: Tensor
    x2: Tensor
    distance: Tensor
    ratio: Tensor
    operator_id: Tensor
    operator_mask: Tensor
    index1: Tensor
    index2: Tensor
    operators: tuple[str, ...]
    counts: Mapping[str, OperatorCounts]

    def __post_init__(self) -> None:
        _check_tensor("Correspondences", "x1", self.x1, (None, 2), torch.float64)
        n = len(self.x1)
        _check_tensor("Correspondences", "x2", self.x2, (n, 2), torch.float64)
        for name in ("distance", "ratio"):
            _check_tensor("Correspondences", name, getattr(self, name), (n,), torch.float64)
        for name in ("operator_id", "operator_mask", "index1", "index2"):
            _check_tensor("Correspondences", name, getattr(self, name), (n,), torch.int64)
        if not (torch.isfinite(self.x1).all() and torch.isfinite(self.x2).all()):
            raise InputError("Correspondences.x1 and x2 must be finite")
        if len(self.operators) > MAX_OPERATORS:
            raise InputError(
                f"at most {MAX_OPERATORS} operators fit one set, not {len(self.operators)}"
            )
        if n and not (
            int(self.operator_id.min()) >= 0 and int(self.operator_id.max()) < len(self.operators)
        ):
            raise InputError("Correspondences.operator_id points outside Correspondences.operators")
        if n and not bool(((self.operator_mask >> self.operator_id) & 1).all()):
            raise InputError("Correspondences.operator_mask must hold the bit of operator_id")
        object.__setattr__(self, "counts", MappingProxyType(dict(self.counts)))

    def __len__(self) -> int:
        return len(self.x1)

    def __repr__(self) -> str:
        per = ", ".join(f"{o} {int(self.found_by(o).sum()):,}" for o in self.operators)
        return f"Correspondences({len(self):,}: {per})"

    def found_by(self, operator: str) -> Tensor:
        """(N,) bool: the correspondences that `operator` found, alone or with others."""
        return ((self.operator_mask >> self.operators.index(operator)) & 1).bool()

    def take(self, index: Tensor) -> Correspondences:
        """The correspondences at `index` (integers or a mask), in that order; the counts are
        kept."""
        rows = ("x1", "x2", "distance", "ratio", "operator_id", "operator_mask", "index1", "index2")
        return replace(self, **{name: getattr(self, name)[index] for name in rows})


class Verdict(StrEnum):
    """What the correspondences turned out to show."""

    GENERAL = "general"
    PLANAR = "planar"
    PURE_ROTATION = "pure rotation"
    TOO_LITTLE = "too little evidence"


@dataclass(frozen=True, eq=False)
class Improvement:
    """A model that was the best so far.

    Attributes:
        iteration: minimal samples tried by then.
        model: (3, 3).
        inliers: how many of the matches it was scored on agree with it.
        score: its mean score per match it was scored on, in [0, 1].
        stage: ``sample``, ``local optimisation`` or ``refinement``.
    """

    iteration: int
    model: Tensor
    inliers: int
    score: float
    stage: str


@dataclass(frozen=True, eq=False)
class TwoView:
    """The geometry of two views: how camera 2 stands to camera 1, ``X2 = R X1 + t``.

    Attributes:
        camera1, camera2: the cameras.
        inliers: (N,) bool over the correspondences.
        verdict: general, planar, pure rotation or too little evidence.
        reason: the verdict in words.
        evidence: the numbers the verdict rests on.
        R: (3, 3) rotation, None without a trustworthy one.
        t: (3,) unit translation, None where unknown (pure rotation) or untrustworthy.
        E, F, H: (3, 3) essential, fundamental (pixels), homography (pixels) where estimated, else
            None.
        pose_covariance: (5, 5) covariance of (rotation vector, radians; translation direction on
            its tangent plane, radians), None where not computed.
        sigma_deg: standard deviation of rotation and translation direction, degrees, from
            `pose_covariance`.
        alternatives: other poses (R, t) that explain the matches as well: a plane seen twice
            usually allows two.
        history: how the robust search improved, oldest first; empty where the back end does not
            say. Its models are E, in normalised coordinates, or F, in pixels, whichever was
            estimated.
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
    alternatives: tuple[tuple[Tensor, Tensor], ...] = ()
    history: tuple[Improvement, ...] = ()

    def __post_init__(self) -> None:
        _check_tensor("TwoView", "inliers", self.inliers, (None,), torch.bool)
        for name in ("R", "E", "F", "H"):
            value = getattr(self, name)
            if value is not None:
                _check_tensor("TwoView", name, value, (3, 3), torch.float64)
        if self.t is not None:
            _check_tensor("TwoView", "t", self.t, (3,), torch.float64)
            if abs(float(self.t.norm()) - 1) > 1e-6:
                raise InputError(f"TwoView.t must have unit length, not {float(self.t.norm()):g}")
        if self.pose_covariance is not None:
            _check_tensor("TwoView", "pose_covariance", self.pose_covariance, (5, 5), torch.float64)
        if self.verdict is Verdict.TOO_LITTLE and self.R is not None:
            raise InputError("TwoView: a verdict of too little evidence comes without a pose")
        object.__setattr__(self, "evidence", MappingProxyType(dict(self.evidence)))


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Triangulated points in the frame of camera 1, in units of the baseline.

    Attributes:
        xyz: (M, 3) float64, x right, y down, z forward.
        rgb: (M, 3) uint8, from image 1.
        operator_id, operator_mask: (M,) int64 as in :class:`Correspondences`.
        operators: names.
        reprojection_error: (M,) float64 root mean square over the two images, pixels.
        parallax: (M,) float64 angle between the two rays, degrees.
        match: (M,) int64 row of the Correspondences that a point came from.
        covariance: (M, 3, 3) float64 in squared baselines, None where not computed.
    """

    xyz: Tensor
    rgb: Tensor
    operator_id: Tensor
    operator_mask: Tensor
    operators: tuple[str, ...]
    reprojection_error: Tensor
    parallax: Tensor
    match: Tensor
    covariance: Tensor | None = None

    def __post_init__(self) -> None:
        _check_tensor("PointCloud", "xyz", self.xyz, (None, 3), torch.float64)
        n = len(self.xyz)
        _check_tensor("PointCloud", "rgb", self.rgb, (n, 3), torch.uint8)
        for name in ("operator_id", "operator_mask", "match"):
            _check_tensor("PointCloud", name, getattr(self, name), (n,), torch.int64)
        for name in ("reprojection_error", "parallax"):
            _check_tensor("PointCloud", name, getattr(self, name), (n,), torch.float64)
        if not torch.isfinite(self.xyz).all():
            raise InputError("PointCloud.xyz holds NaN or infinite values")
        if self.covariance is not None:
            _check_tensor("PointCloud", "covariance", self.covariance, (n, 3, 3), torch.float64)

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({len(self):,} points from {', '.join(self.operators)})"

    def found_by(self, operator: str) -> Tensor:
        """(M,) bool: the points that `operator` found, alone or with others."""
        return ((self.operator_mask >> self.operators.index(operator)) & 1).bool()
