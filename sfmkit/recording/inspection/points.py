"""The origin of a 3-D point: pixels, keypoints and operators."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..read import Recording, RecordingError, read_recording
from ._columns import POINTS, escaped, operators_of, own_columns
from ._words import facts, pixel_words, ratio_words


@dataclass(frozen=True)
class Sighting:
    """A keypoint of a 3-D point.

    Attributes:
        operator, image, keypoint: row `keypoint` of the operator's features in image 1 or 2.
        pixel: where it was found, pixels of the pinhole without distortion.
        scale_px, angle_deg: diameter and orientation of the described neighbourhood.
        kept: whether its position was used; else it was merged into the one whose was.
    """

    operator: str
    image: int
    keypoint: int
    pixel: tuple[float, float]
    scale_px: float
    angle_deg: float
    kept: bool


@dataclass(frozen=True)
class PointOrigin:
    """The origin of a 3-D point.

    Attributes:
        point, total: its row in the cloud, and the cloud's size.
        xyz: baselines, in the frame of camera 1.
        operators: all that found it; `kept` is the one whose pixels were used.
        x1, x2: those pixels in the photographs.
        match: row of the fused correspondences.
        distance_px: to the epipolar geometry (Sampson).
        descriptor_distance, descriptor_ratio: similarity of the two neighbourhoods.
        residual_px, residual_rank: root mean square reprojection error, and the share of points
            that have a larger one.
        parallax_deg: angle between the two rays.
        sigma: standard deviation along the worst direction, baselines; None where it was not
            computed.
        sightings: its keypoints, of all operators and both images.
    """

    point: int
    total: int
    xyz: tuple[float, float, float]
    operators: tuple[str, ...]
    kept: str
    x1: tuple[float, float]
    x2: tuple[float, float]
    match: int
    distance_px: float
    descriptor_distance: float
    descriptor_ratio: float
    residual_px: float
    residual_rank: float
    parallax_deg: float
    sigma: float | None
    sightings: tuple[Sighting, ...]

    def __str__(self) -> str:
        depth = self.xyz[2]
        rows = [
            (
                "position",
                f"({', '.join(f'{v:.4f}' for v in self.xyz)}) baselines, in the frame of camera 1",
            ),
            (
                "found by",
                ", ".join(self.operators)
                + (f"; position of {self.kept}" if len(self.operators) > 1 else ""),
            ),
            ("image 1", f"pixel {pixel_words(self.x1)}"),
            ("image 2", f"pixel {pixel_words(self.x2)}"),
            (
                "match",
                f"{self.match:,}: descriptor distance {self.descriptor_distance:.4g}, "
                f"{ratio_words(self.descriptor_ratio)}"
                f"{self.distance_px:.3f} px from the epipolar geometry",
            ),
            (
                "residual",
                f"{self.residual_px:.3f} px; {self.residual_rank:.0%} of the points have a larger "
                "one",
            ),
            ("parallax", f"{self.parallax_deg:.2f} deg between the two rays"),
        ]
        if self.sigma is not None:
            rows.append(
                (
                    "uncertainty",
                    f"{self.sigma:.4g} baselines along the worst direction, "
                    f"{self.sigma / depth:.2%} of the depth",
                )
            )
        for s in self.sightings:
            merged = "" if s.kept else ", merged into it"
            rows.append(
                (
                    f"keypoint {s.keypoint:,}",
                    f"{s.operator}, image {s.image}, pixel {pixel_words(s.pixel)}, "
                    f"scale {s.scale_px:.1f} px, orientation {s.angle_deg:.0f} deg{merged}",
                )
            )
        return f"point {self.point:,} of {self.total:,}\n{facts(rows)}"


def point_origin(recording: Recording, n: int, prefix: str = "") -> PointOrigin:
    """Trace point `n` of the cloud back to its pixels and operators.

    Raises:
        RecordingError: the recording has no cloud, or the cloud no such point.
    """
    entity = f"{prefix}/{POINTS}"
    operators = operators_of(recording, prefix)
    if entity not in recording:
        verdict = recording.report(prefix)["verdict"]["kind"]
        raise RecordingError(f"{recording.path} has no cloud; its verdict is: {verdict}")
    cloud = own_columns(recording, entity)
    total = len(cloud["point"])
    if not 0 <= n < total:
        raise RecordingError(f"there is no point {n}; {recording.path} has points 0 to {total - 1}")
    xyz = recording.latest(entity)["Points3D:positions"][n]
    row, kept = int(cloud["match"][n]), str(cloud["operator"][n])
    inliers = own_columns(recording, f"{prefix}/world/cam1/image/inliers/{escaped(kept)}")
    match = int(np.flatnonzero(inliers["match"] == row)[0])
    found_by = tuple(o for k, o in enumerate(operators) if int(cloud["operator_mask"][n]) >> k & 1)
    sightings = [
        s
        for o in found_by
        for i in (1, 2)
        for s in _sightings(recording, prefix, o, i, n, o == kept, cloud)
    ]
    return PointOrigin(
        point=n,
        total=total,
        xyz=tuple(float(v) for v in xyz),  # type: ignore[arg-type]
        operators=found_by,
        kept=kept,
        x1=tuple(float(v) for v in cloud["x1"][n]),  # type: ignore[arg-type]
        x2=tuple(float(v) for v in cloud["x2"][n]),  # type: ignore[arg-type]
        match=row,
        distance_px=float(inliers["distance_px"][match]),
        descriptor_distance=float(inliers["descriptor_distance"][match]),
        descriptor_ratio=float(inliers["descriptor_ratio"][match]),
        residual_px=float(cloud["residual_px"][n]),
        residual_rank=float(np.mean(cloud["residual_px"] > cloud["residual_px"][n])),
        parallax_deg=float(cloud["parallax_deg"][n]),
        sigma=float(cloud["sigma"][n]) if "sigma" in cloud else None,
        sightings=tuple(sorted(sightings, key=lambda s: (not s.kept, s.operator, s.image))),
    )


def _sightings(
    recording: Recording,
    prefix: str,
    operator: str,
    image: int,
    n: int,
    is_kept: bool,
    cloud: dict[str, Any],
) -> list[Sighting]:
    """The keypoints of an operator in one image that belong to point n."""
    entity = f"{prefix}/world/cam{image}/image/keypoints/{escaped(operator)}"
    keypoints, own = recording.latest(entity), own_columns(recording, entity)
    return [
        Sighting(
            operator,
            image,
            k,
            (float(x), float(y)),
            float(own["scale_px"][k]),
            float(own["angle_deg"][k]),
            kept=is_kept and k == int(cloud[f"keypoint{image}"][n]),
        )
        for k in np.flatnonzero(own["point"] == n).tolist()
        for x, y in [keypoints["Points2D:positions"][k]]
    ]


def describe_point(path: str | Path, n: int, prefix: str = "") -> str:
    """Describe point `n`: pixels, operators, residual, angle, uncertainty."""
    return str(point_origin(read_recording(path), n, prefix))
