"""An operator and a matcher."""

from __future__ import annotations

import cv2
import numpy as np

from sfmkit.types import Features, Matches


def corners(image: np.ndarray, *, count: int = 300) -> Features:
    """Shi-Tomasi corners, described by their 15 x 15 grey values with zero mean and unit norm."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (0, 0), 1.0)
    found = cv2.goodFeaturesToTrack(grey, count, 0.001, 4)
    xy = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2)
    padded = cv2.copyMakeBorder(grey, 8, 8, 8, 8, cv2.BORDER_REFLECT).astype(np.float32)
    patches = [cv2.getRectSubPix(padded, (15, 15), (float(x) + 8, float(y) + 8)) for x, y in xy]
    descriptors = np.array(patches, np.float32).reshape(len(xy), 225)
    descriptors -= descriptors.mean(axis=1, keepdims=True) if len(xy) else 0
    descriptors /= np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-6)
    return Features(
        keypoints=xy,
        scales=np.full(len(xy), 15, np.float32),
        angles=np.zeros(len(xy), np.float32),
        scores=np.linspace(1, 0.5, len(xy), dtype=np.float32),
        descriptors=descriptors,
        norm="l2",
        operator="corners",
        size_wh=(image.shape[1], image.shape[0]),
    )


def one_way(features1: Features, features2: Features) -> Matches:
    """The nearest neighbour of every feature of image 1."""
    d1, d2 = (f.descriptors.astype(np.float32) for f in (features1, features2))
    if not len(d1) or not len(d2):
        empty = np.zeros(0, np.int64)
        return Matches(empty, empty, np.zeros(0, np.float32), np.zeros(0, np.float32))
    distance = np.linalg.norm(d1[:, None] - d2[None], axis=2)
    nearest = distance.argmin(axis=1)
    best = distance[np.arange(len(d1)), nearest]
    ratio = np.full(len(d1), np.nan, np.float32)
    return Matches(np.arange(len(d1)), nearest, best.astype(np.float32), ratio)
