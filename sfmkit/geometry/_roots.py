"""Real roots of many small polynomials at once.

A polynomial in z is taken homogeneous, in (cos θ, sin θ) with z = cot θ: roots at infinity are then
like any other, and a polynomial of degree D is a trigonometric one with the frequencies D, D - 2,
... in θ. It is known by its values at D + 1 equally spaced angles, which is as well conditioned as can be: coefficients in powers of z are never formed.
"""

from __future__ import annotations

import math
from functools import cache

import torch
from torch import Tensor

_NEWTON = 6


def nodes(degree: int) -> list[float]:
    """The degree + 1 angles at which a polynomial is to be evaluated."""
    return [math.pi * j / (degree + 1) for j in range(degree + 1)]


@cache
def _tables(degree: int, cells: int, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Matrices that turn values at the nodes into coefficients, into values and into slopes on the
    grid."""

    def basis(angles: Tensor, derivative: bool = False) -> Tensor:
        columns = []
        for f in range(degree, -1, -2):
            c, s = torch.cos(f * angles), torch.sin(f * angles)
            columns += [-f * s, f * c] if derivative else [c, s]
        return torch.stack(columns[: degree + 1], -1)

    fit = torch.linalg.inv(basis(torch.tensor(nodes(degree), dtype=torch.float64)))
    grid = torch.arange(cells + 1, dtype=torch.float64) * (math.pi / cells)
    tables = (fit, basis(grid) @ fit, basis(grid, True) @ fit)
    return tuple(T.mT.contiguous().to(device) for T in tables)  # type: ignore[return-value]


class _Trigonometric:
    """M polynomials, each evaluated at its own angle: ``Σ_f Re((a_f - i b_f) e^{i f θ})``."""

    def __init__(self, coefficients: Tensor):
        degree = coefficients.shape[-1] - 1
        if degree % 2 == 0:  # frequency 0 has no sine
            coefficients = torch.nn.functional.pad(coefficients, (0, 1))
        pairs = coefficients.unflatten(-1, (-1, 2)) * torch.tensor(
            [1.0, -1.0], dtype=torch.float64, device=coefficients.device
        )
        self.c = torch.view_as_complex(pairs).mT.contiguous()  # (frequencies, M), highest first
        self.frequencies = range(degree, -1, -2)

    def __call__(self, angle: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, first and second derivative at (M,) angles."""
        u = torch.polar(torch.ones_like(angle), 2 * angle)
        value = slope = curve = torch.zeros_like(u)
        for f, c in zip(self.frequencies, self.c):
            value = value * u + c
            slope = slope * u + f * c
            curve = curve * u + (f * f) * c
        if self.frequencies[-1] == 1:
            turn = torch.polar(torch.ones_like(angle), angle)
            value, slope, curve = value * turn, slope * turn, curve * turn
        return value.real, -slope.imag, -curve.real


def real_roots(values: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """All real roots of B polynomials, as angles.

    Sign changes on a grid bracket the roots; where a polynomial turns back towards zero inside a
    cell without changing sign at its ends, its extremum is looked at, so that close pairs are not
    lost. Newton, kept inside its bracket.

    Args:
        values: (B, D + 1) float64, at :func:`nodes`.
        cells: of the grid on the half circle. Three roots in one cell are found as one.

    Returns:
        owner: (M,) int64, ascending: which polynomial a root is of.
        angle: (M,) the roots, z = cot(angle).
    """
    degree = values.shape[-1] - 1
    fit, to_grid, to_slope = _tables(degree, cells, values.device)
    values = values / values.abs().amax(-1, keepdim=True).clamp(min=torch.finfo(values.dtype).tiny)
    coefficients, grid, slope = values @ fit, values @ to_grid, values @ to_slope
    positive = grid > 0
    crossing = positive[:, 1:] != positive[:, :-1]
    owner, cell = crossing.nonzero(as_tuple=True)
    width = math.pi / cells
    left = cell * width
    right = left + width

    turning = ((slope > 0) != positive)[:, :-1] & ((slope > 0) == positive)[:, 1:] & ~crossing
    extra, cell = turning.nonzero(as_tuple=True)
    if len(extra):
        f = _Trigonometric(coefficients[extra])
        extremum = _newton(
            lambda a: f(a)[1:], cell * width, (cell + 1) * width, slope[extra, cell] > 0, 4
        )
        pair = (f(extremum)[0] > 0) != positive[extra, cell]
        extra, cell, extremum = extra[pair], cell[pair], extremum[pair]
        owner = torch.cat((owner, extra, extra))
        left = torch.cat((left, cell * width, extremum))
        right = torch.cat((right, extremum, (cell + 1) * width))
        owner, order = owner.sort(stable=True)
        left, right = left[order], right[order]

    f = _Trigonometric(coefficients[owner])
    rising = f(left)[0] <= 0
    angle = _newton(lambda a: f(a)[:2], left, right, ~rising, _NEWTON)
    return owner, angle


def _newton(f, left: Tensor, right: Tensor, positive_left: Tensor, steps: int) -> Tensor:
    """A zero of f, which returns (value, derivative), in each bracket; Newton, or bisection where
    it would leave it."""
    x = (left + right) / 2
    for _ in range(steps):
        value, derivative = f(x)
        same = (value > 0) == positive_left
        left, right = torch.where(same, x, left), torch.where(same, right, x)
        step = x - value / derivative
        inside = (step >= left) & (step <= right)
        x = torch.where(inside, step, (left + right) / 2)
    return x
