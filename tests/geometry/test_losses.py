"""Losses compared with numerical integration over the noise level and their derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.stats import chi

from sfmkit.errors import InputError
from sfmkit.geometry.losses import loss_terms, marginal_score, marginal_weight


def marginal(r: float, threshold: float) -> float:
    """Return the average density of a four-vector of length r over the noise level.

    The density is cut off at k sigma, and sigma ranges up to threshold / k.
    """
    k = chi(4).ppf(0.99)
    top = threshold / k
    density = quad(
        lambda s: s**-4 * math.exp(-(r**2) / (2 * s**2)), r / k, top, epsabs=0, epsrel=1e-10
    )[0]
    return density * r**3  # relative to a chi distributed length: what MAGSAC++ weighs with


def test_the_weight_is_the_average_over_the_noise_level():
    r = np.linspace(0.2, 2.9, 12)
    expected = np.array([marginal(x, 3.0) for x in r])
    ours = marginal_weight(torch.from_numpy(r**2), 3.0).numpy()
    assert np.allclose(ours / ours[0], expected / expected[0], rtol=1e-5)


def test_the_score_is_one_at_zero_and_zero_beyond_the_threshold():
    s = torch.tensor([0.0, 3.999, 4.0, 100.0], dtype=torch.float64)
    assert torch.allclose(marginal_score(s, 2.0), torch.tensor([1.0, 0, 0, 0]).double(), atol=1e-6)
    assert torch.allclose(marginal_weight(s, 2.0), torch.tensor([1.0, 0, 0, 0]).double(), atol=1e-3)


@pytest.mark.parametrize("loss", ["squared", "huber", "cauchy", "marginal"])
def test_slope_and_curvature_are_the_derivatives_of_the_value(loss):
    s = torch.tensor([1e-8, 1e-4, 0.01, 0.3, 0.6, 2.0], dtype=torch.float64, requires_grad=True)
    value, slope, curvature = loss_terms(loss, s, 0.9)
    assert torch.allclose(torch.autograd.grad(value.sum(), s)[0], slope, rtol=1e-6, atol=1e-9)
    h = 1e-5
    by_differences = (
        loss_terms(loss, s.detach()[1:] + h, 0.9).slope
        - loss_terms(loss, s.detach()[1:] - h, 0.9).slope
    ) / (2 * h)
    assert torch.allclose(curvature[1:], by_differences, rtol=1e-3, atol=1e-6)
    assert float(loss_terms(loss, torch.zeros(1).double(), 0.9).slope) == pytest.approx(1)


def test_unknown_loss_is_named():
    with pytest.raises(InputError, match="'tukey'"):
        loss_terms("tukey", torch.zeros(1), 1.0)  # type: ignore[arg-type]
