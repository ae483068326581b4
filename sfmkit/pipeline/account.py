"""Per-operator statistics, from keypoints to points (the paper's Table 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from torch import Tensor

from ..types import Correspondences, PointCloud

ALL = "multi"  # the name of the paper for all operators together


@dataclass(frozen=True)
class OperatorAccount:
    """Statistics of one operator, or of all together.

    A correspondence or point that several operators found counts for each of them. The numbers of
    the operators therefore add up to the total only if nothing was merged.

    Attributes:
        keypoints: Numbers of keypoints in image 1 and image 2.
        matches: Number of matches of the operator before fusion.
        initial: Number of fused correspondences that the operator found; equal to `matches` if
            nothing was merged.
        inliers: Number of these that agree with the epipolar geometry.
        points: Number of points in the cloud that the operator found.
        points_alone: Number of points that no other operator found.
        share_initial: `initial` divided by the number of all correspondences.
        share_points: `points` divided by the number of points of the cloud.
        loss: Share of `initial` that was not triangulated.
        log10_chance: log10 of the probability that so many of its matches agree by chance with the
            pose that the other operators determine; None if not computed.
    """

    keypoints: tuple[int, int]
    matches: int
    initial: int
    inliers: int
    points: int
    points_alone: int
    share_initial: float
    share_points: float
    loss: float
    log10_chance: float | None = None

    def as_dict(self) -> dict:
        """Convert to plain data for JSON."""
        return {**asdict(self), "keypoints": list(self.keypoints)}


HEAD = (
    "operator",
    "keypoints 1",
    "keypoints 2",
    "matches",
    "fused",
    "inliers",
    "points",
    "alone",
    "share",
    "loss",
)


def account_cells(name: str, line: Mapping[str, Any]) -> tuple[str, ...]:
    """Format :meth:`OperatorAccount.as_dict` as the cells below :data:`HEAD`."""
    counts = (
        *line["keypoints"],
        line["matches"],
        line["initial"],
        line["inliers"],
        line["points"],
        line["points_alone"],
    )
    return (name, *(f"{n:,}" for n in counts), f"{line['share_points']:.1%}", f"{line['loss']:.1%}")


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


def make_account(
    corr: Correspondences,
    inliers: Tensor,
    cloud: PointCloud | None,
    witnesses: Mapping[str, float] | None = None,
) -> dict[str, OperatorAccount]:
    """Compute the statistics of every operator and of all operators together (``multi``).

    Args:
        corr: N fused correspondences with their counts.
        inliers: (N,) bool, the correspondences that agree with the geometry.
        cloud: The triangulated points; None without a cloud.
        witnesses: Operator -> `log10_chance`.
    """
    n, m = len(corr), 0 if cloud is None else len(cloud)

    def line(
        keypoints: tuple[int, int],
        matches: int,
        initial: int,
        kept: int,
        points: int,
        alone: int,
        log10_chance: float | None = None,
    ):
        return OperatorAccount(
            keypoints,
            matches,
            initial,
            kept,
            points,
            alone,
            _share(initial, n),
            _share(points, m),
            1 - _share(points, initial) if initial else 0.0,
            log10_chance,
        )

    account = {}
    for k, name in enumerate(corr.operators):
        mine = corr.found_by(name)
        points = alone = 0
        if cloud is not None:
            points = int(cloud.found_by(name).sum())
            alone = int((cloud.operator_mask == 1 << k).sum())
        c = corr.counts[name]
        account[name] = line(
            c.keypoints,
            c.matches,
            int(mine.sum()),
            int((mine & inliers).sum()),
            points,
            alone,
            (witnesses or {}).get(name),
        )
    counts = corr.counts.values()
    total = (sum(c.keypoints[0] for c in counts), sum(c.keypoints[1] for c in counts))
    account[ALL] = line(total, sum(c.matches for c in counts), n, int(inliers.sum()), m, m)
    return account
