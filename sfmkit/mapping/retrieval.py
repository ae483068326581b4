"""Similarity of photographs by a global descriptor without a trained network.

VLAD: the residuals of local descriptors to the nearest of some centres, summed per centre. The
centres are learned from the photographs themselves. Jégou, Douze, Schmid & Pérez, "Aggregating
local descriptors into a compact image representation", CVPR 2010; intra-normalisation by
Arandjelović & Zisserman, "All about VLAD", CVPR 2013.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.cluster import vq  # as a module: autodoc cannot render the signature of kmeans2

from ..errors import InputError
from ..types import Features

__all__ = ["BUDGET", "MAX_SIZE", "similarities", "vlad"]

BUDGET, MAX_SIZE = 500, 480  # keypoints per photograph, and its longest side, pixels
_CENTRES = 64  # as in the papers
_SAMPLE = 20_000  # descriptors from which the centres are learned


def similarities(features_of: Callable[[int], Features], n: int, seed: int = 0) -> np.ndarray:
    """Compute the similarities of n photographs.

    Only the global descriptors are kept in memory: 32 kB per photograph for descriptors of 128
    numbers.

    Args:
        features_of: Function that returns the features of a photograph, with real-valued
            descriptors; called twice per photograph.
        n: Number of photographs.
        seed: Seed of the sample and of the clustering.

    Returns:
        (n, n) float32 cosine similarities; 0 for a photograph without features.

    Raises:
        InputError: The descriptors are binary, or there are fewer than 64 in all photographs.
    """
    random = np.random.default_rng(seed)
    share = -(-_SAMPLE // n)
    parts = []
    for index in range(n):
        found = root_descriptors(features_of(index))
        parts.append(random.permutation(found)[:share])
    sample = np.concatenate(parts)
    if len(sample) < _CENTRES:
        raise InputError(
            f"the {n} photographs have {len(sample)} features; too few to compare them. Choose "
            "other pairs, such as --pairs sequential"
        )
    centres, _ = vq.kmeans2(sample, _CENTRES, iter=15, minit="++", rng=seed)
    described = np.stack([vlad(root_descriptors(features_of(k)), centres) for k in range(n)])
    return described @ described.T


def root_descriptors(features: Features) -> np.ndarray:
    """Compute signed square roots of L1-normalised descriptors: (N, D) float32.

    The Euclidean distance of such descriptors is the Hellinger distance; Arandjelović & Zisserman,
    "Three things everyone should know to improve object retrieval", CVPR 2012.

    Raises:
        InputError: The descriptors are binary.
    """
    if features.norm != "l2":
        raise InputError(
            f"the descriptors of '{features.operator}' are binary; photographs are compared by an "
            "operator with real-valued ones, such as sift or surf"
        )
    d = features.descriptors.astype(np.float32)
    d = d / np.maximum(np.abs(d).sum(1, keepdims=True), 1e-12)
    return np.sign(d) * np.sqrt(np.abs(d))


def vlad(descriptors: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Describe an image by the residuals of its descriptors to centres.

    Args:
        descriptors: (N, D) descriptors.
        centres: (K, D) centres.

    Returns:
        (K D,) float32 of unit length; zeros where N is 0.
    """
    sums = np.zeros(centres.shape, np.float32)
    if len(descriptors):
        nearest, _ = vq.vq(descriptors, centres)
        np.add.at(sums, nearest, descriptors - centres[nearest])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    return (sums / max(float(np.linalg.norm(sums)), 1e-12)).ravel()
