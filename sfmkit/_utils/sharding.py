"""Parts of a list, one for each job of a batch system."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from ..errors import InputError

__all__ = ["Shard", "part_bounds", "part_of"]

Shard = tuple[int, int]
T = TypeVar("T")


def part_bounds(count: int, shard: Shard | None) -> slice:
    """Return the rows of a shard: consecutive ones, in parts whose sizes differ by at most one.

    Args:
        count: Number of rows, such as pairs.
        shard: (i, n) for part i of n, i from 1; None for all.

    Raises:
        InputError: There are fewer pairs than shards, or i is not from 1 to n.
    """
    if shard is None:
        return slice(0, count)
    number, of = shard
    if not 1 <= number <= of:
        raise InputError(f"shard must be (i, n) with 1 <= i <= n, not {shard}")
    if of > count:
        raise InputError(f"{count} pairs cannot be split into {of} shards")
    return slice(count * (number - 1) // of, count * number // of)


def part_of(pairs: Sequence[T], shard: Shard | None) -> Sequence[T]:
    """Return the pairs of a shard, see :func:`part_bounds`."""
    return pairs[part_bounds(len(pairs), shard)]
