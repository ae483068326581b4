"""The units of work, each with the key of its result.

A task holds the recipe of everything that it needs, so any worker can compute it from scratch, or
read it from the cache. Equal recipes have equal keys, so 31 combinations of five operators need
five detections per image and five matchings per pair.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..matching.plugins import matcher_of
from ..options import EstimateOptions, FuseOptions, MatchOptions, as_plain
from ..types import Camera
from .variants import Combination, Setting, Variant
from .version import digest, stage_version


@dataclass(frozen=True)
class ImageRef:
    """An image of a task.

    Attributes:
        digest: Sha256 of the bytes of the file.
        path: The file, for workers that see it.
        size_wh: Pixels, upright.
    """

    digest: str
    path: str
    size_wh: tuple[int, int]

    @property
    def megapixels(self) -> float:
        return self.size_wh[0] * self.size_wh[1] / 1e6


@dataclass(frozen=True)
class DetectTask:
    """One operator on one image.

    Attributes:
        code: Of the operator, see :class:`sfmkit.ablation.plugins.PlugIn`.
    """

    image: ImageRef
    setting: Setting
    code: str = ""
    kind = "features"

    @cached_property
    def key(self) -> str:
        return digest(
            "features",
            stage_version("features"),
            self.image.digest,
            self.setting.as_json(),
            self.code,
        )

    @property
    def needs(self) -> tuple[DetectTask, ...]:
        return ()

    def __str__(self) -> str:
        return f"{self.setting.operator} on {self.image.path.rpartition('/')[2]}"


@dataclass(frozen=True)
class MatchTask:
    """The matching of one operator's features of two images.

    Attributes:
        code: Of the matcher, see :class:`sfmkit.ablation.plugins.PlugIn`.
    """

    first: DetectTask
    second: DetectTask
    options: MatchOptions
    code: str = ""
    kind = "matches"

    @cached_property
    def key(self) -> str:
        o = self.options
        return digest(
            "matches",
            stage_version("matches"),
            self.first.key,
            self.second.key,
            [o.mutual, o.max_ratio, o.max_distance],
            [matcher_of(self.operator, o), as_plain(o.overrides.get(self.operator, {}))],
            self.code,
        )

    @property
    def operator(self) -> str:
        return self.first.setting.operator

    @property
    def needs(self) -> tuple[DetectTask, DetectTask]:
        return (self.first, self.second)

    def __str__(self) -> str:
        return f"{self.operator} matches"


@dataclass(frozen=True)
class Job:
    """One estimate: a combination and a seed."""

    combination: Combination
    seed: int
    key: str


@dataclass(frozen=True, eq=False)
class EstimateTask:
    """Some of the estimates of one pair; their rows are one file of the folder of the sweep.

    Attributes:
        key: of the unit of the plan that it belongs to; a part of a unit keeps it.
        pair: index of the pair in the plan.
        homography: a homography is estimated, else the two-view geometry.
        cameras: of both images, for the two-view geometry.
        variant: preset and changes.
        jobs: what to estimate.
        matches: operator -> its matches.
    """

    key: str
    pair: int
    homography: bool
    cameras: tuple[Camera, Camera] | None
    variant: Variant
    jobs: tuple[Job, ...]
    matches: dict[str, MatchTask]
    kind = "estimates"

    @property
    def needs(self) -> tuple[MatchTask, ...]:
        return tuple(self.matches.values())

    def only(self, jobs: tuple[Job, ...], key: str | None = None) -> EstimateTask:
        """The part of this task with these jobs."""
        used = {o for job in jobs for o in job.combination}
        matches = {o: m for o, m in self.matches.items() if o in used}
        return replace(self, key=key or self.key, jobs=jobs, matches=matches)

    def __str__(self) -> str:
        return f"{len(self.jobs)} estimates"


@dataclass(frozen=True, eq=False)
class PairTask:
    """The matching of all operators on one pair of a folder, its fusion and its geometry.

    The result is one entry for each pair: a folder of many photographs has many pairs, and an entry
    for each operator and pair would be as many small files.

    Attributes:
        matches: operator -> the recipe of its matches; they are part of the result.
        cameras: of both images.
        masks: of both images, or None; keypoints on black pixels of a mask are not used.
        fuse, estimate: options of the stages.
        code: Of the estimator, see :class:`sfmkit.ablation.plugins.PlugIn`.
        seed: Of the robust estimation.
    """

    matches: Mapping[str, MatchTask]
    cameras: tuple[Camera, Camera]
    masks: tuple[ImageRef | None, ImageRef | None]
    fuse: FuseOptions
    estimate: EstimateOptions
    code: str = ""
    seed: int = 0
    kind = "geometries"

    @cached_property
    def key(self) -> str:
        return digest(
            "geometry",
            stage_version("geometries"),
            [[name, match.key] for name, match in self.matches.items()],
            [_camera_numbers(camera) for camera in self.cameras],
            [mask and mask.digest for mask in self.masks],
            [as_plain(self.fuse), as_plain(self.estimate)],
            [self.code, self.seed],
        )

    @property
    def needs(self) -> tuple[DetectTask, ...]:
        return tuple(detection for match in self.matches.values() for detection in match.needs)

    def __str__(self) -> str:
        detections = next(iter(self.matches.values())).needs
        return " and ".join(d.image.path.rpartition("/")[2] for d in detections)


Task = DetectTask | MatchTask | EstimateTask | PairTask


def _camera_numbers(camera: Camera) -> list[Any]:
    """What an estimate depends on; the uncertainty of the intrinsics shapes that of the pose."""
    sigma = camera.uncertainty
    return [
        np.asarray(camera.K).tolist(),
        np.asarray(camera.distortion).tolist(),
        camera.model,
        [sigma.focal, sigma.principal_point, sigma.k1],
    ]


def estimate_key(
    homography: bool,
    cameras: tuple[Camera, Camera] | None,
    variant: Variant,
    matches: dict[str, MatchTask],
    combination: Combination,
    seed: int,
    code: str = "",
) -> str:
    """The key of an estimate. It depends neither on the order of the operators nor on the truth.

    Args:
        code: Of the estimator, see :class:`sfmkit.ablation.plugins.PlugIn`.
    """
    o = variant.options
    settings: list[Any] = [variant.preset, o.fuse.merge_radius, code]
    if homography:
        settings.append(as_plain(variant.planar))
    else:
        settings.append(as_plain(o.estimate))
        settings += [
            [np.asarray(c.K).tolist(), np.asarray(c.distortion).tolist(), c.model]
            for c in cameras or ()
        ]
    used = [[name, matches[name].key] for name in sorted(combination)]
    return digest("estimate", stage_version("estimates"), homography, settings, used, seed)
