"""Coordinates against NumPy's linear algebra."""

from __future__ import annotations

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.errors import InputError
from sfmkit.geometry.coordinates import (
    denormalize,
    from_homogeneous,
    hartley_normalization,
    inverse_intrinsics,
    normalize,
    to_homogeneous,
)


def test_normalize_is_the_inverse_intrinsic_matrix():
    s = make_scene(50)
    expected = from_homogeneous(to_homogeneous(s.x2) @ torch.linalg.inv(s.K2).T)
    assert torch.allclose(normalize(s.x2, s.K2), expected, rtol=0, atol=1e-14)
    assert torch.allclose(denormalize(normalize(s.x2, s.K2), s.K2), s.x2, rtol=0, atol=1e-11)
    assert torch.allclose(
        inverse_intrinsics(s.K2) @ s.K2, torch.eye(3).double(), rtol=0, atol=1e-15
    )


def test_batches_equal_single_results():
    s = make_scene(40)
    x, K = torch.stack((s.x1, s.x2)), torch.stack((s.K1, s.K2))
    both = normalize(x, K)
    assert torch.equal(both[0], normalize(s.x1, s.K1))
    assert torch.equal(both[1], normalize(s.x2, s.K2))


def test_hartley_normalization_centres_and_scales():
    x = make_scene(30).x1
    w = torch.rand(30, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    xn, T = hartley_normalization(x, w)
    assert torch.allclose((w[:, None] * xn).sum(0), torch.zeros(2).double(), atol=1e-12)
    assert float((w * (xn**2).sum(-1)).sum() / w.sum()) == pytest.approx(2, abs=1e-12)
    assert torch.allclose(from_homogeneous(to_homogeneous(x) @ T.T), xn, atol=1e-12)


def test_hartley_normalization_of_one_repeated_point_stays_finite():
    x = torch.full((5, 2), 7.0, dtype=torch.float64, requires_grad=True)
    xn, T = hartley_normalization(x)
    (xn.sum() + T.sum()).backward()
    assert torch.equal(xn, torch.zeros(5, 2).double())
    assert torch.isfinite(x.grad).all()


@pytest.mark.parametrize(
    "K, words",
    [
        (torch.zeros(3, 3).double(), "singular"),
        (torch.eye(3).double().index_fill(0, torch.tensor([1]), 1), "upper triangular"),
        (torch.eye(3), "float32"),
        (torch.eye(3).double() * torch.nan, "NaN"),
    ],
)
def test_bad_intrinsics_are_named(K, words):
    with pytest.raises(InputError, match=words):
        normalize(torch.zeros(4, 2).double(), K)


@pytest.mark.parametrize(
    "x", [torch.zeros(4, 2, dtype=torch.int64), torch.zeros(4, 2, dtype=torch.half)]
)
def test_other_dtypes_are_rejected(x):
    with pytest.raises(InputError, match="float32 or float64"):
        hartley_normalization(x)
