"""Our own columns of a recording."""

from __future__ import annotations

from typing import Any

from ...pipeline.account import ALL
from ..read import Recording

POINTS = "world/points/operator"


def operators_of(recording: Recording, prefix: str) -> tuple[str, ...]:
    """The operators of a reconstruction; bit and class id k is the k-th."""
    return tuple(name for name in recording.report(prefix)["operators"] if name != ALL)


def own_columns(recording: Recording, entity: str) -> dict[str, Any]:
    """Our own columns of an entity, by their bare names."""
    start = "sfmkit:"
    return {
        c.removeprefix(start): v for c, v in recording.latest(entity).items() if c.startswith(start)
    }


def escaped(operator: str) -> str:
    """An operator's name as part of an entity path, where the viewer escapes some characters."""
    return "".join(c if c.isalnum() or c in "-_." else f"\\{c}" for c in operator)
