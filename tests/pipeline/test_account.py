"""Per-operator statistics compared with numbers counted by hand."""

from __future__ import annotations

import torch

from sfmkit.pipeline.account import ALL, make_account
from sfmkit.types import Correspondences, OperatorCounts, PointCloud


def test_small_statistics_computed_by_hand():
    # Six correspondences of operators a and b; the third was found by both. Five inliers, four
    # points.
    mask = torch.tensor([1, 1, 3, 2, 2, 2])
    ids = torch.tensor([0, 0, 0, 1, 1, 1])
    x = torch.rand(6, 2, dtype=torch.float64)
    rows = torch.arange(6)
    nan = torch.full((6,), float("nan"), dtype=torch.float64)
    counts = {
        "a": OperatorCounts((10, 11), 4, merged=1),
        "b": OperatorCounts((20, 21), 4, merged=0),
    }
    corr = Correspondences(x, x, nan, nan, ids, mask, rows, rows, ("a", "b"), counts)
    inliers = torch.tensor([1, 0, 1, 1, 1, 1]).bool()
    kept = torch.tensor([0, 2, 3, 5])
    cloud = PointCloud(
        torch.rand(4, 3, dtype=torch.float64),
        torch.zeros(4, 3, dtype=torch.uint8),
        ids[kept],
        mask[kept],
        ("a", "b"),
        nan[:4],
        nan[:4],
        kept,
    )
    account = make_account(corr, inliers, cloud)
    a, b, both = account["a"], account["b"], account[ALL]
    assert list(account) == ["a", "b", ALL]
    assert (a.keypoints, a.matches, a.initial, a.inliers, a.points, a.points_alone) == (
        (10, 11),
        4,
        3,
        2,
        2,
        1,
    )
    assert (b.keypoints, b.matches, b.initial, b.inliers, b.points, b.points_alone) == (
        (20, 21),
        4,
        4,
        4,
        3,
        2,
    )
    assert (both.keypoints, both.matches, both.initial, both.inliers, both.points) == (
        (30, 32),
        8,
        6,
        5,
        4,
    )
    assert (a.share_initial, a.share_points, a.loss) == (3 / 6, 2 / 4, 1 - 2 / 3)
    assert (both.share_initial, both.share_points, both.loss) == (1, 1, 1 - 4 / 6)


def test_an_empty_result_has_statistics_too():
    empty = torch.zeros(0, dtype=torch.int64)
    none = torch.zeros(0, dtype=torch.float64)
    corr = Correspondences(
        torch.zeros(0, 2, dtype=torch.float64),
        torch.zeros(0, 2, dtype=torch.float64),
        none,
        none,
        empty,
        empty,
        empty,
        empty,
        ("a",),
        {"a": OperatorCounts((0, 0), 0)},
    )
    account = make_account(corr, torch.zeros(0, dtype=torch.bool), None)
    assert account["a"] == account[ALL]
    assert account["a"].loss == account["a"].share_points == 0
