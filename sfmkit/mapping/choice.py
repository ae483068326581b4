"""Choice of the pairs of a folder: all, neighbours in order or in space, or similar ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from .collection import Collection

__all__ = [
    "AUTO",
    "PairChoice",
    "all_pairs",
    "default_choice",
    "local_positions",
    "nearest_in_space",
    "parse_choice",
    "sequential_pairs",
]

AUTO = "auto"
_DEFAULTS = {"all": None, "sequential": 5, "gps": 10, "similar": 10}
_FEW = 40  # largest number of photographs of which all pairs are matched; 780 pairs
_SEMI_MAJOR_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563  # WGS 84


@dataclass(frozen=True)
class PairChoice:
    """A rule that chooses pairs.

    Attributes:
        rule: ``all``, ``sequential``, ``gps`` or ``similar``.
        count: Window of ``sequential``, or number of neighbours of ``gps`` and ``similar``.
    """

    rule: str
    count: int | None

    def __str__(self) -> str:
        return self.rule if self.count is None else f"{self.rule}:{self.count}"


def parse_choice(text: str) -> tuple[PairChoice, ...]:
    """Parse rules such as ``sequential:5+similar:10``, whose pairs are combined.

    Raises:
        InputError: A rule is unknown, or a number is not positive.
    """
    rules = []
    for part in text.lower().split("+"):
        found = re.fullmatch(r"\s*([a-z]+)(?::([0-9]{1,6}))?\s*", part)
        if not found or found[1] not in _DEFAULTS:
            raise InputError(
                f"pairs can be {', '.join(_DEFAULTS)}, joined by +, each with a number after a "
                f"colon (sequential:5+similar:10), not {text!r}"
            )
        rule, count = found[1], found[2]
        if count is not None and (rule == "all" or int(count) < 1):
            raise InputError(f"{part.strip()!r}: the number must be positive, and 'all' has none")
        rules.append(PairChoice(rule, int(count) if count else _DEFAULTS[rule]))
    return tuple(dict.fromkeys(rules))


def default_choice(collection: Collection) -> tuple[PairChoice, ...]:
    """Return the default rules for a collection.

    These are all pairs of up to 40 photographs; for more photographs, neighbours in order together
    with similar or near photographs.
    """
    if len(collection) <= _FEW:
        return parse_choice("all")
    located = all(p.header.exif and p.header.exif.position for p in collection.photographs)
    return parse_choice("sequential+gps" if located else "sequential+similar")


def all_pairs(n: int) -> np.ndarray:
    """List all pairs of n photographs: (P, 2) int64 with i < j."""
    return np.stack(np.triu_indices(n, 1), axis=1)


def sequential_pairs(subfolders: Sequence[str], window: int) -> np.ndarray:
    """Pair each photograph with the `window` next ones of its subfolder: (P, 2) int64, i < j."""
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(subfolders):
        groups.setdefault(name, []).append(index)
    found = [
        (members[k], members[k + step])
        for members in groups.values()
        for step in range(1, window + 1)
        for k in range(len(members) - step)
    ]
    return np.array(found, np.int64).reshape(-1, 2)


def local_positions(collection: Collection) -> np.ndarray:
    """Convert the positions of EXIF to (N, 3) float64 metres east, north and up of their mean.

    The altitude of positions without one is the mean altitude of the others, or 0. Rows without a
    position are NaN.
    """
    positions = [p.header.exif and p.header.exif.position for p in collection.photographs]
    known = np.array([p or (np.nan, np.nan, np.nan) for p in positions], np.float64)
    latitude, longitude, altitude = np.radians(known[:, 0]), np.radians(known[:, 1]), known[:, 2]
    has = np.isfinite(latitude)
    if not has.any():
        return np.full((len(known), 3), np.nan)
    heights = altitude[np.isfinite(altitude)]
    altitude = np.where(np.isfinite(altitude), altitude, heights.mean() if len(heights) else 0.0)
    e2 = _FLATTENING * (2 - _FLATTENING)
    normal = _SEMI_MAJOR_M / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    earth = np.stack(
        [
            (normal + altitude) * np.cos(latitude) * np.cos(longitude),
            (normal + altitude) * np.cos(latitude) * np.sin(longitude),
            (normal * (1 - e2) + altitude) * np.sin(latitude),
        ],
        axis=1,
    )
    lat, lon = latitude[has].mean(), longitude[has].mean()
    axes = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    return (earth - earth[has].mean(0)) @ axes.T


def nearest_in_space(positions: np.ndarray, k: int) -> np.ndarray:
    """Pair each photograph with its k nearest ones in the plane: (P, 2) int64 with i < j.

    Args:
        positions: (N, 3) metres east, north, up; rows with NaN have no neighbours. Altitudes are
            ignored, because GPS altitudes are several times less accurate.
        k: Number of neighbours.

    Raises:
        InputError: Fewer than two photographs have a position.
    """
    rows = np.flatnonzero(np.isfinite(positions).all(1))
    if len(rows) < 2:
        raise InputError(
            f"{len(rows)} photographs have a GPS position in EXIF; choose other pairs, such as "
            "--pairs similar"
        )
    tree = cKDTree(positions[rows, :2])
    _, near = tree.query(positions[rows, :2], k=range(1, min(k + 1, len(rows)) + 1))
    return _both(rows, near)


def most_similar(similarity: np.ndarray, k: int) -> np.ndarray:
    """Pair each photograph with its k most similar ones: (P, 2) int64 with i < j.

    Args:
        similarity: (N, N) symmetric similarities; the diagonal is ignored.
        k: Number of neighbours.
    """
    n = len(similarity)
    others = similarity.copy()
    np.fill_diagonal(others, -np.inf)
    near = np.argsort(-others, axis=1, kind="stable")[:, : min(k, n - 1)]
    return _both(np.arange(n), near)


def _both(rows: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the distinct pairs i < j of each row and its neighbours, which may include itself."""
    ends = np.stack([np.repeat(rows, near.shape[1]), rows[near.ravel()]], axis=1)
    ends = np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1)
    return np.unique(ends, axis=0)


def choose_pairs(
    rules: Sequence[PairChoice], collection: Collection, similarity: Callable[[], np.ndarray]
) -> np.ndarray:
    """Choose the pairs of all rules together: (P, 2) int64 with i < j, sorted.

    Args:
        rules: The rules.
        collection: The photographs.
        similarity: Function that computes the (N, N) similarities; called only for the rule
            ``similar``.

    Raises:
        InputError: There are no positions for the rule ``gps``, or no pair is chosen.
    """
    found = []
    for rule in rules:
        if rule.rule == "all":
            found.append(all_pairs(len(collection)))
        elif rule.rule == "sequential":
            subfolders = [p.subfolder for p in collection.photographs]
            found.append(sequential_pairs(subfolders, rule.count or 1))
        elif rule.rule == "gps":
            found.append(nearest_in_space(local_positions(collection), rule.count or 1))
        else:
            found.append(most_similar(similarity(), rule.count or 1))
    pairs = np.unique(np.concatenate(found), axis=0)
    if not len(pairs):
        raise InputError(f"{'+'.join(map(str, rules))} chooses no pair; try --pairs all")
    return pairs
