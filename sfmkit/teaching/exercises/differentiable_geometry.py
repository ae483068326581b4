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
                "The one-sided quotient has an error of h f''/2. Take a step to both sides.",
            ),
            (
                lambda f, x, h: (f(x + h) - f(x - h)) / h,
                "The distance between x - h and x + h is 2 h.",
            ),
        ),
        lambda: tuple((f, x, 0.1) for f in (np.sin, np.exp) for x in (0.3, 1.1)),
        tolerance=1e-9,
    ),
    "07.2": Exercise(
        "step(J, r): the Gauss-Newton step for residuals r (N,) with the Jacobian J (N, P).",
        lambda J, r: -np.linalg.solve(J.T @ J, J.T @ r),
        (
            (
                lambda J, r: np.linalg.solve(J.T @ J, J.T @ r),
                "The sign is wrong: the step must decrease the cost.",
            ),
            (
                lambda J, r: -J.T @ r,
                "This is the direction of steepest descent. Solve the system with J^T J instead.",
            ),
        ),
        _LINEAR,
    ),
    "07.3": Exercise(
        "covariance_of(J, sigma): the covariance of a least-squares estimate with the Jacobian J "
        "(N, P), if each residual has the standard deviation sigma.",
        lambda J, s: s**2 * np.linalg.inv(J.T @ J),
        (
            (
                lambda J, s: s * np.linalg.inv(J.T @ J),
                "A covariance has squared units: sigma appears squared.",
            ),
            (
                lambda J, s: J.T @ J / s**2,
                "This is the information matrix. The covariance is its inverse.",
            ),
            (
                lambda J, s: np.linalg.inv(J.T @ J),
                "The noise is missing: twice the noise gives four times the covariance.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(20, 3)), g.uniform(0.2, 3))),
    ),
    "07.4": Exercise(
        "total(pixels, regions, cameras): the standard deviation that these three parts give "
        "together. The part of the image regions contains that of the pixels.",
        lambda pixels, regions, cameras: np.hypot(regions, cameras),
        (
            (
                lambda pixels, regions, cameras: np.sqrt(pixels**2 + regions**2 + cameras**2),
                "The pixel noise is counted twice: the part of the image regions contains it.",
            ),
            (
                lambda pixels, regions, cameras: regions + cameras,
                "Variances of independent errors add up, not standard deviations.",
            ),
            (
                lambda pixels, regions, cameras: np.hypot(pixels, cameras),
                "This leaves out the errors that the matches of a region share.",
            ),
        ),
        random_inputs(lambda g: tuple(g.uniform(0.01, 0.2, 3))),
    ),
}
