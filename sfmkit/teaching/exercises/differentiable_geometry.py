"""Notebook 07: differentiable geometry."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs

_LINEAR = random_inputs(lambda g: (g.normal(size=(20, 3)), g.normal(size=20)))

EXERCISES: dict[str, Exercise] = {
    "07.1": Exercise(
        "derivative(f, x, h): the central difference quotient of the function f at x with step h.",
        lambda f, x, h: (f(x + h) - f(x - h)) / (2 * h),
        (
            (
                lambda f, x, h: (f(x + h) - f(x)) / h,
                "The one-sided quotient is off by h f''/2; take a step to both sides.",
            ),
            (lambda f, x, h: (f(x + h) - f(x - h)) / h, "From x - h to x + h it is 2 h."),
        ),
        lambda: tuple((f, x, 0.1) for f in (np.sin, np.exp) for x in (0.3, 1.1)),
        tolerance=1e-9,
    ),
    "07.2": Exercise(
        "step(J, r): the step of Gauss-Newton from residuals r (N,) and their Jacobian J (N, P).",
        lambda J, r: -np.linalg.solve(J.T @ J, J.T @ r),
        (
            (
                lambda J, r: np.linalg.solve(J.T @ J, J.T @ r),
                "Only the sign is wrong: the step goes downhill.",
            ),
            (
                lambda J, r: -J.T @ r,
                "That is steepest descent; divide by the curvature, solve with J^T J.",
            ),
        ),
        _LINEAR,
    ),
    "07.3": Exercise(
        "covariance(J, sigma): of the least-squares estimate, when each residual has the standard deviation sigma.",
        lambda J, s: s**2 * np.linalg.inv(J.T @ J),
        (
            (
                lambda J, s: s * np.linalg.inv(J.T @ J),
                "A covariance has squared units: sigma appears squared.",
            ),
            (
                lambda J, s: J.T @ J / s**2,
                "That is the information matrix; the covariance is its inverse.",
            ),
            (
                lambda J, s: np.linalg.inv(J.T @ J),
                "The noise is missing: twice the noise is four times the covariance.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(20, 3)), g.uniform(0.2, 3))),
    ),
}
