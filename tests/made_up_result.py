"""A reconstruction made of arrays alone, every number of which is known: for tests of what reads
and draws results."""

from __future__ import annotations

import numpy as np
import torch

from sfmkit.geometry.essential import essential_from_pose
from sfmkit.geometry.fundamental import fundamental_from_essential
from sfmkit.io.images import read_image
from sfmkit.options import DEFAULT
from sfmkit.pipeline.account import make_account
from sfmkit.pipeline.provenance import used_plugins
from sfmkit.pipeline.reconstruction import Reconstruction
from sfmkit.types import (
    Camera,
    Correspondences,
    Features,
    Improvement,
    Matches,
    OperatorCounts,
    PointCloud,
    TwoView,
    Verdict,
)

OPERATORS = ("surf", "orb", "fast-brief")
SIZE = (320, 240)
POINTS, OUTLIERS, LONELY = (
    300,
    40,
    50,
)  # in the cloud; wrong matches; keypoints an operator without a match


def make_result(
    *,
    points: int = POINTS,
    outliers: int = OUTLIERS,
    lonely: int = LONELY,
    size_wh: tuple[int, int] = SIZE,
    image: np.ndarray | None = None,
    noise_px: float = 0.3,
    seed: int = 0,
) -> Reconstruction:
    """Points in a box seen by two cameras, each found by one to three operators, and wrong matches
    among them.

    Operator ``n % 3`` is the one kept for correspondence n; every fourth is also found by the next
    operator, whose match was merged into it.
    """
    g = np.random.default_rng(seed)
    w, h = size_wh
    camera = Camera(np.array([[w, 0, w / 2 - 0.5], [0, w, h / 2 - 0.5], [0, 0, 1.0]]), size_wh)
    a = np.radians(5)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    t = np.array([-0.96, 0.0, 0.28])
    z = g.uniform(4, 8, points)
    X = np.c_[g.uniform(-0.3, 0.4, points) * z, g.uniform(-0.3, 0.3, points) * z, z]

    def seen(Y: np.ndarray) -> np.ndarray:
        y = Y @ camera.K.T
        return y[:, :2] / y[:, 2:] + g.normal(0, noise_px, (len(Y), 2))

    n = points + outliers
    wrong = [g.uniform(0, 1, (outliers, 2)) * (w - 1, h - 1) for _ in range(2)]
    x1, x2 = np.concatenate([seen(X), wrong[0]]), np.concatenate([seen(X @ R.T + t), wrong[1]])

    kept = np.arange(n) % 3
    also = np.where(np.arange(n) % 4 == 0, (kept + 1) % 3, kept)
    mask = (1 << kept) | (1 << also)
    features, matches, counts = {}, {}, {}
    index = np.zeros(n, dtype=np.int64)
    for k, name in enumerate(OPERATORS):
        own, merged = np.flatnonzero(kept == k), np.flatnonzero((also == k) & (kept != k))
        index[own] = np.arange(len(own))
        rows = np.concatenate([own, merged])
        offset = np.concatenate([np.zeros(len(own)), np.full(len(merged), 0.4)])[
            :, None
        ]  # what a merged one is off by
        pair = []
        for x in (x1, x2):
            p = np.concatenate(
                [x[rows] + offset, g.uniform(0, 1, (lonely, 2)) * (w - 1, h - 1)]
            ).astype(np.float32)
            m = len(p)
            pair.append(
                Features(
                    p,
                    g.uniform(4, 20, m).astype(np.float32),
                    g.uniform(-3, 3, m).astype(np.float32),
                    g.uniform(0, 1, m).astype(np.float32),
                    g.integers(0, 256, (m, 4), dtype=np.uint8),
                    "hamming",
                    name,
                    size_wh,
                )
            )
        features[name] = (pair[0], pair[1])
        both = np.arange(len(rows))
        matches[name] = Matches(
            both, both, np.ones(len(rows), np.float32), np.full(len(rows), 0.7, np.float32)
        )
        counts[name] = OperatorCounts((len(pair[0]), len(pair[1])), len(rows), len(merged))

    def tensor(v: np.ndarray, dtype: torch.dtype = torch.int64) -> torch.Tensor:
        return torch.as_tensor(v, dtype=dtype)

    corr = Correspondences(
        tensor(x1, torch.float64),
        tensor(x2, torch.float64),
        torch.ones(n, dtype=torch.float64),
        torch.full((n,), 0.7, dtype=torch.float64),
        tensor(kept),
        tensor(mask),
        tensor(index),
        tensor(index),
        OPERATORS,
        counts,
    )
    R_, t_ = torch.tensor(R), torch.tensor(t)
    E = essential_from_pose(R_, t_)
    K, _ = camera.tensors()
    inliers = torch.arange(n) < points
    view = TwoView(
        camera,
        camera,
        inliers,
        Verdict.GENERAL,
        "Made up.",
        {"matches": n, "inliers": points},
        R=R_,
        t=t_,
        E=E,
        F=fundamental_from_essential(E, K, K),
        H=torch.eye(3, dtype=torch.float64),
        sigma_deg=(0.01, 0.02),
        history=tuple(Improvement(64 * i, E, 100 * i + 50, 0.1 * i, "sample") for i in range(3)),
    )
    ray = torch.tensor(X / np.linalg.norm(X, axis=1, keepdims=True))
    covariance = 1e-4 * torch.eye(3, dtype=torch.float64) + 1e-2 * ray[:, :, None] * ray[:, None, :]
    rgb = np.c_[np.arange(points) % 256, np.full(points, 128), np.full(points, 64)].astype(np.uint8)
    cloud = PointCloud(
        torch.tensor(X),
        torch.from_numpy(rgb),
        corr.operator_id[:points],
        corr.operator_mask[:points],
        OPERATORS,
        torch.linspace(0.1, 0.9, points, dtype=torch.float64),
        torch.linspace(2, 12, points, dtype=torch.float64),
        torch.arange(points),
        covariance,
    )
    if image is None:
        image = (
            (g.uniform(0, 1, (h // 8, w // 8, 3)) * 255).astype(np.uint8).repeat(8, 0).repeat(8, 1)
        )
    return Reconstruction(
        images=(read_image(image), read_image(image)),
        features=features,
        matches=matches,
        correspondences=corr,
        two_view=view,
        cloud=cloud,
        account=make_account(corr, inliers, cloud),
        options=DEFAULT,
        seed=seed,
        timings_s={"detect": 1.5, "match": 0.75, "total": 2.5},
        warnings=("made up",),
        errors={"rotation_deg": 0.03, "translation_deg": 0.08},
        plugins=used_plugins(OPERATORS, DEFAULT),
    )
