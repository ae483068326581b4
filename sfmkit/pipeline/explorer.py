"""Epipolar line, candidates, match and ray of a pixel of image 1.

The interactive views use this module, which does not depend on their widgets.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.coordinates import normalize
from ..geometry.distortion import distort_pixels, undistort_pixels
from ..geometry.fundamental import epipolar_lines
from ..geometry.lines import clip_lines
from .reconstruction import Reconstruction

_KEYPOINT = re.compile(r"/world/cam1/image/keypoints/(?P<operator>[^/]+)$")  # see docs/recording.md
_STEPS = 200  # number of points of a curve, if the lens distorts lines


@dataclass(frozen=True)
class Candidate:
    """A keypoint of image 2 near the epipolar line."""

    operator: str
    row: int
    x2: tuple[float, float]
    distance_px: float


@dataclass(frozen=True, eq=False)
class EpipolarView:
    """The epipolar line, candidates, match and ray of a pixel of image 1.

    Attributes:
        x1: (2,) the pixel.
        line: (3,) epipolar line of the pixel in the undistorted image 2, ``a² + b² = 1``.
        curve: (N, 2) part of the line inside image 2, in pixels of the photograph: two ends without
            lens distortion, more points with distortion, and no points if the line does not cross
            the image.
        candidates: Keypoints of image 2 near the line, nearest first.
        match: Row of the inlier correspondence nearest to the pixel; None if none is near.
        x1_match, x2_match: (2,) pixels of the match.
        residual_px: Distance of the match from its own epipolar line in image 2, pixels.
        ray: (3,) unit direction of the pixel in the frame of camera 1.
        X: (3,) triangulated point of the match in the frame of camera 1, in baselines; None if
            there is none.
    """

    x1: np.ndarray
    line: np.ndarray
    curve: np.ndarray
    candidates: tuple[Candidate, ...]
    match: int | None
    x1_match: np.ndarray | None
    x2_match: np.ndarray | None
    residual_px: float | None
    ray: np.ndarray
    X: np.ndarray | None

    def describe(self) -> str:
        """Describe the view in one sentence."""
        words = [
            f"pixel ({self.x1[0]:.1f}, {self.x1[1]:.1f}) of image 1: "
            f"{len(self.candidates):,} keypoints near its line"
        ]
        if self.x2_match is None:
            words.append("no inlier near the pixel")
        else:
            words.append(
                f"match {self.match} at ({self.x2_match[0]:.1f}, {self.x2_match[1]:.1f}) of image "
                f"2, {self.residual_px:.2f} px from its line"
            )
        if self.X is not None:
            words.append(
                f"its point lies at ({self.X[0]:.3f}, {self.X[1]:.3f}, {self.X[2]:.3f}) baselines"
            )
        return "; ".join(words) + "."


class EpipolarExplorer:
    """A search for epipolar lines, candidates, matches and rays of pixels of image 1.

    Args:
        result: A reconstruction with a fundamental matrix (general or planar).
        reach_px: Largest distance of a match from the pixel.
        band_px: Largest distance of a candidate keypoint from the line.

    Raises:
        InputError: The reconstruction has no epipolar geometry.
    """

    def __init__(self, result: Reconstruction, *, reach_px: float = 12.0, band_px: float = 1.5):
        view = result.two_view
        if view.F is None:
            raise InputError(
                "the reconstruction has no epipolar geometry to explore: the verdict is "
                f"'{view.verdict}'. {view.reason}"
            )
        self.result, self.F = result, view.F
        self.reach_px, self.band_px = reach_px, band_px
        self._rows = view.inliers.nonzero().squeeze(1)
        names = [name for name, (_, f2) in result.features.items() if len(f2)]
        self._operators = [
            (name, row) for name in names for row in range(len(result.features[name][1]))
        ]
        keypoints = [result.features[name][1].keypoints for name in names] or [
            np.zeros((0, 2), np.float32)
        ]
        self._keypoints2 = torch.from_numpy(np.concatenate(keypoints).astype(np.float64))
        # Keypoints outside the field of the lens are NaN and therefore on no epipolar line.
        self._ideal2 = undistort_pixels(self._keypoints2, view.camera2, return_valid=True)[0]
        cloud = result.cloud
        #: Depth to which rays are drawn, in baselines.
        self.far = (
            10.0
            if cloud is None or not len(cloud)
            else float(np.percentile(cloud.xyz[:, 2].numpy(), 98))
        )
        self._point_of = {} if cloud is None else {int(m): k for k, m in enumerate(cloud.match)}

    def look(self, x1: tuple[float, float] | np.ndarray) -> EpipolarView:
        """Find the epipolar line, candidates, match and ray of the pixel x1 of image 1.

        Args:
            x1: Pixel (x, y).

        Raises:
            InputError: x1 is not two finite numbers, or lies outside image 1.
        """
        pixel = np.asarray(x1, dtype=np.float64)
        w, h = self.result.images[0].size_wh
        if pixel.shape != (2,) or not np.isfinite(pixel).all():
            raise InputError(f"a pixel is two finite numbers (x, y), not {x1!r}")
        if not (-0.5 <= pixel[0] <= w - 0.5 and -0.5 <= pixel[1] <= h - 0.5):
            raise InputError(
                f"pixel ({pixel[0]:g}, {pixel[1]:g}) lies outside image 1, which has {w} x {h} "
                "pixels"
            )
        view, corr = self.result.two_view, self.result.correspondences
        ideal = undistort_pixels(torch.from_numpy(pixel)[None], view.camera1)
        line = epipolar_lines(self.F, ideal)[0]
        K1, _ = view.camera1.tensors()
        ray = torch.nn.functional.normalize(
            torch.cat((normalize(ideal, K1)[0], torch.ones(1, dtype=torch.float64))), dim=0
        )

        match = self._match_near(pixel)
        x1_match = x2_match = residual = X = None
        if match is not None:
            x1_match, x2_match = corr.x1[match].numpy(), corr.x2[match].numpy()
            own = epipolar_lines(self.F, undistort_pixels(corr.x1[match][None], view.camera1))[0]
            residual = abs(
                float(own[:2] @ undistort_pixels(corr.x2[match][None], view.camera2)[0] + own[2])
            )
            if match in self._point_of and self.result.cloud is not None:
                X = self.result.cloud.xyz[self._point_of[match]].numpy()
        return EpipolarView(
            pixel,
            line.numpy(),
            self._curve(line),
            self._candidates(line),
            match,
            x1_match,
            x2_match,
            residual,
            ray.numpy(),
            X,
        )

    def keypoint(self, operator: str, row: int) -> np.ndarray:
        """Return the pixel (2,) of an operator's keypoint in image 1.

        Raises:
            InputError: The operator or the row does not exist.
        """
        if operator not in self.result.features:
            raise InputError(
                f"operator '{operator}' was not used; known: {', '.join(self.result.features)}"
            )
        f1 = self.result.features[operator][0]
        if not 0 <= row < len(f1):
            raise InputError(
                f"{operator} has {len(f1):,} keypoints in image 1; number {row} does not exist"
            )
        return f1.keypoints[row].astype(np.float64)

    def selected(self, entity_path: str, instance: int | None) -> np.ndarray | None:
        """Return the pixel (2,) of a keypoint of image 1 that is selected in the Rerun viewer.

        The result is None for any other entity.
        """
        found = _KEYPOINT.search(entity_path)
        if found is None or instance is None or found["operator"] not in self.result.features:
            return None
        return self.keypoint(found["operator"], instance)

    def _match_near(self, pixel: np.ndarray) -> int | None:
        if not len(self._rows):
            return None
        away = (self.result.correspondences.x1[self._rows] - torch.from_numpy(pixel)).norm(dim=1)
        k = int(away.argmin())
        return int(self._rows[k]) if float(away[k]) <= self.reach_px else None

    def _candidates(self, line: Tensor) -> tuple[Candidate, ...]:
        away = (self._ideal2 @ line[:2] + line[2]).abs()
        near = (away <= self.band_px).nonzero().squeeze(1)
        near = near[away[near].argsort()]
        found = []
        for k in near.tolist():
            (operator, row), (x, y) = self._operators[k], self._keypoints2[k].tolist()
            found.append(Candidate(operator, row, (x, y), float(away[k])))
        return tuple(found)

    def _curve(self, line: Tensor) -> np.ndarray:
        camera = self.result.two_view.camera2
        w, h = camera.size_wh
        margin = 0.25 * max(w, h) if camera.has_distortion else 0.0
        (ends,), (crosses,) = clip_lines(line[None], (w, h), margin)
        if not crosses or not camera.has_distortion:
            return ends.numpy() if crosses else np.zeros((0, 2))
        share = torch.linspace(0, 1, _STEPS, dtype=torch.float64)[:, None]
        straight = (1 - share) * ends[0] + share * ends[1]
        bent = distort_pixels(straight, camera).numpy()
        return bent[((bent >= -0.5) & (bent <= (w - 0.5, h - 0.5))).all(1)]
