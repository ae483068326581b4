"""The independent units of a data set: its scenes or its pairs.

Pairs of one scene share images, the camera and the kind of texture, so their results are
correlated, and an interval that draws pairs is too narrow. Drawing scenes, each with all of its
pairs, keeps the correlation (cluster bootstrap: Davison & Hinkley, Bootstrap Methods and their
Application, 1997, section 3.8; Field & Welsh, J. R. Stat. Soc. B 69, 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...errors import InputError

__all__ = ["CHOICES", "FEWEST_SCENES", "Choice", "Units", "choose_units", "mean_per_unit"]

Choice = Literal["auto", "scene", "pair"]
CHOICES: tuple[Choice, ...] = ("auto", "scene", "pair")
FEWEST_SCENES = 5  # with ``auto``; four scenes have 35 different samples, five have 126


@dataclass(frozen=True, eq=False)
class Units:
    """What bootstrap samples draw and tests count.

    Attributes:
        name: ``scene`` or ``pair``.
        of_pair: (P,) int64 number of the unit of every pair, 0 to ``len(units) - 1``.
    """

    name: Literal["scene", "pair"]
    of_pair: np.ndarray

    def __len__(self) -> int:
        return int(self.of_pair.max()) + 1

    def count(self) -> str:
        """Return the number of units in words: ``8 scenes``."""
        return f"{len(self):,} {self.name}{'' if len(self) == 1 else 's'}"


def choose_units(scenes: Sequence[str], choice: Choice = "auto") -> Units:
    """Choose scenes or pairs as units.

    Args:
        scenes: The scene of every pair.
        choice: ``scene``, ``pair``, or ``auto``: scenes if there are at least five, else pairs.

    Raises:
        InputError: An unknown choice.
    """
    if choice not in CHOICES:
        raise InputError(f"units must be {', '.join(CHOICES)}, not {choice!r}")
    names, of_pair = np.unique(np.asarray(scenes), return_inverse=True)
    if choice == "scene" or (choice == "auto" and len(names) >= FEWEST_SCENES):
        return Units("scene", of_pair.astype(np.int64))
    return Units("pair", np.arange(len(scenes)))


def mean_per_unit(values: np.ndarray, of_pair: np.ndarray | None = None) -> np.ndarray:
    """Average the values of the pairs of every unit.

    Args:
        values: (P, ...).
        of_pair: (P,) as in :class:`Units`; None if every pair is a unit.

    Returns:
        (G, ...).
    """
    if of_pair is None:
        return values
    sizes = np.bincount(of_pair)
    sums = np.zeros((len(sizes), *values.shape[1:]))
    np.add.at(sums, of_pair, values)
    return sums / sizes.reshape(-1, *(1,) * (values.ndim - 1))
