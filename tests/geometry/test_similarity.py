"""Similarities compared with known transformations and a general optimiser."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.similarity import Similarity, fit_similarity


def known(batch: int, seed: int = 0) -> Similarity:
    rng = np.random.default_rng(seed)
    R = Rotation.random(batch, random_state=rng).as_matrix()
    return Similarity(
        *(
            torch.from_numpy(v)
            for v in (np.exp(rng.normal(size=batch)), R, 10 * rng.normal(size=(batch, 3)))
        )
    )


def points(batch: int, n: int = 30) -> torch.Tensor:
    return torch.randn(batch, n, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


@pytest.mark.parametrize("flat", [False, True])
def test_known_similarities_are_recovered_in_a_batch(flat):
    x, true = points(5), known(5)
    if flat:
        x[..., 2] = 0.3 * x[..., 0]
    found = fit_similarity(x, true.apply(x))
    for one, other in zip(found, true):
        assert torch.allclose(one, other, atol=1e-10)
    assert torch.allclose(true.inverse().apply(true.apply(x)), x, atol=1e-12)
    single = fit_similarity(x[3], true.apply(x)[3])
    assert torch.allclose(single.R, found.R[3], atol=1e-12)


def test_the_fit_agrees_with_a_general_optimiser():
    x = points(1)[0]
    y = known(1).apply(x[None])[0] + 0.3 * torch.randn(
        30, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64
    )
    found = fit_similarity(x, y)

    def residual(p):
        return (
            np.exp(p[0]) * x.numpy() @ Rotation.from_rotvec(p[1:4]).as_matrix().T
            + p[4:]
            - y.numpy()
        ).ravel()

    start = np.concatenate(
        [
            [np.log(float(found.s))],
            Rotation.from_matrix(found.R.numpy()).as_rotvec(),
            found.t.numpy(),
        ]
    )
    best = least_squares(residual, start + 0.1, xtol=1e-14, ftol=1e-14)
    assert np.allclose(best.x, start, atol=1e-6)


def test_the_fit_is_never_a_reflection():
    x = points(1)[0]
    found = fit_similarity(x, x * torch.tensor([1.0, 1, -1], dtype=torch.float64))
    assert torch.linalg.det(found.R) == pytest.approx(1)
    assert found.s > 0


def test_bad_input():
    x = points(1)[0]
    with pytest.raises(InputError, match="shape"):
        fit_similarity(x, x[:5])
    with pytest.raises(InputError, match="NaN"):
        fit_similarity(x, x * float("nan"))
    with pytest.raises(DegenerateGeometryError, match="three pairs"):
        fit_similarity(x[:2], x[:2])
    line = torch.outer(torch.arange(5.0, dtype=torch.float64), torch.ones(3, dtype=torch.float64))
    with pytest.raises(DegenerateGeometryError, match="line"):
        fit_similarity(line, x[:5])
