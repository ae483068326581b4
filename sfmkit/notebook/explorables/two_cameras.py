"""Two cameras: the epipolar geometry of a motion that is chosen with sliders and by dragging."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...errors import InputError
from ...pipeline.reconstruction import Reconstruction
from .bundle import bundle
from .explorable import Explorable, photograph_data, rounded

__all__ = ["TwoCameras"]

MAX_POINTS = 1500  # of the cloud; more are slow to draw without a graphics card


class TwoCameras(Explorable):
    """Both cameras, the epipolar plane, lines and epipoles, in 3-D and in the photographs.

    The sliders change R, t and the focal length of camera 2. The matches of the reconstruction
    show how far a chosen motion is from the photographs.

    Args:
        result: a reconstruction with a cloud.

    Raises:
        InputError: the reconstruction has no cloud, or the photographs have lens distortion.
    """

    title: ClassVar[str] = "Two cameras"
    _esm = bundle("two_cameras")

    def __init__(self, result: Reconstruction):
        view, cloud = result.two_view, result.cloud
        if cloud is None or not len(cloud) or view.R is None or view.t is None:
            raise InputError("the explorable needs a reconstruction with a cloud")
        if view.camera1.has_distortion or view.camera2.has_distortion:
            raise InputError("the explorable needs photographs without lens distortion")
        xyz = cloud.xyz.numpy()
        low, high = np.percentile(xyz, (1, 99), axis=0)
        rows = ((xyz >= low) & (xyz <= high)).all(1).nonzero()[0]
        rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_POINTS)).astype(int)]
        xyz = xyz[rows]
        match = cloud.match.numpy()[rows]
        corr = result.correspondences
        matches = np.hstack([corr.x1.numpy()[match], corr.x2.numpy()[match]])
        w, h = result.images[0].size_wh
        first = matches[np.hypot(*(matches[:, :2] - [0.45 * w, 0.5 * h]).T).argmin(), :2]
        super().__init__(
            data={
                "images": [photograph_data(image.rgb) for image in result.images],
                "K1": view.camera1.K.tolist(),
                "K2": view.camera2.K.tolist(),
                "R": view.R.tolist(),
                "t": view.t.tolist(),
                "points": rounded(xyz, 5),
                "colours": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in cloud.rgb.numpy()[rows]],
                "matches": rounded(matches, 7),
                "pixel": rounded(first, 7),
            }
        )
