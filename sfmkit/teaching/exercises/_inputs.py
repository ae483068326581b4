"""Inputs on which answers are tested: random numbers from fixed seeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Inputs = Callable[[], tuple[tuple[Any, ...], ...]]


def random_inputs(make: Callable[[np.random.Generator], tuple[Any, ...]], n: int = 4) -> Inputs:
    """Make `n` inputs from fixed seeds."""
    return lambda: tuple(make(np.random.default_rng(seed)) for seed in range(n))


def hat(t: np.ndarray) -> np.ndarray:
    return np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def rotation(g: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(g.normal(size=(3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def camera(g: np.random.Generator) -> np.ndarray:
    return np.array(
        [
            [g.uniform(700, 1500), 0, g.uniform(300, 700)],
            [0, g.uniform(700, 1500), g.uniform(200, 500)],
            [0, 0, 1],
        ]
    )
