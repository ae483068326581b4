"""Fused matches of all operators."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..errors import InputError
from ._checks import check_tensor
from .frozen_mapping import FrozenMapping

MAX_OPERATORS = 62  # one bit of an int64 mask per operator


@dataclass(frozen=True)
class OperatorCounts:
    """The contribution of one operator to a set of correspondences.

    Attributes:
        keypoints: Numbers of keypoints in image 1 and image 2.
        matches: Number of matches of the operator before fusion.
        merged: Number of these matches that were merged into a coincident correspondence of another
            keypoint or operator.
    """

    keypoints: tuple[int, int]
    matches: int
    merged: int = 0


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Matched points of all operators, in pixels, with their provenance.

    Attributes:
        x1, x2: (N, 2) float64 pixels in image 1 and image 2.
        distance: (N,) float64 descriptor distances, comparable only within one operator.
        ratio: (N,) float64 ratios of the distance to the second-best distance; NaN if unknown.
        operator_id: (N,) int64 indices into `operators`; for a merged correspondence, the operator
            whose position was kept.
        operator_mask: (N,) int64 bit masks; bit k is set if `operators[k]` found the
            correspondence.
        index1, index2: (N,) int64 rows of the Features of `operator_id`.
        operators: Names of the operators; bit k and id k refer to `operators[k]`.
        counts: Per operator, the numbers of its keypoints, matches and merged matches.
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
        check_tensor("Correspondences", "x1", self.x1, (None, 2), torch.float64)
        n = len(self.x1)
        check_tensor("Correspondences", "x2", self.x2, (n, 2), torch.float64)
        for name in ("distance", "ratio"):
            check_tensor("Correspondences", name, getattr(self, name), (n,), torch.float64)
        for name in ("operator_id", "operator_mask", "index1", "index2"):
            check_tensor("Correspondences", name, getattr(self, name), (n,), torch.int64)
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
        object.__setattr__(self, "counts", FrozenMapping(self.counts))

    def __len__(self) -> int:
        return len(self.x1)

    def __repr__(self) -> str:
        per = ", ".join(f"{o} {int(self.found_by(o).sum()):,}" for o in self.operators)
        return f"Correspondences({len(self):,}: {per})"

    def found_by(self, operator: str) -> Tensor:
        """Return which correspondences `operator` found, alone or with others, (N,) bool."""
        return ((self.operator_mask >> self.operators.index(operator)) & 1).bool()

    def take(self, index: Tensor) -> Correspondences:
        """Return the correspondences at `index` (integers or a mask), in that order.

        The counts do not change.
        """
        rows = ("x1", "x2", "distance", "ratio", "operator_id", "operator_mask", "index1", "index2")
        return replace(self, **{name: getattr(self, name)[index] for name in rows})
