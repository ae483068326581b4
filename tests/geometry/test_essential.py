"""The essential matrix against known poses, an SVD, and kornia's five-point solver."""

from __future__ import annotations

import kornia
import pytest
import torch
from made_up_scene import make_scene, same_up_to_sign
from torch.autograd import gradcheck

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.coordinates import normalize, to_homogeneous
from sfmkit.geometry.essential import (
    decompose_essential,
    essential_5point,
    essential_from_fundamental,
    essential_from_pose,
    project_to_essential,
)
from sfmkit.geometry.fundamental import fundamental_from_essential
from sfmkit.geometry.lie import so3_exp

EXACT = make_scene(200)
NOISY = make_scene(200, noise=0.5)
E = essential_from_pose(EXACT.R, EXACT.t)


def rays(s) -> tuple[torch.Tensor, torch.Tensor]:
    return normalize(s.x1, s.K1), normalize(s.x2, s.K2)


def samples(s, count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    index = torch.stack([torch.randperm(len(s.x1), generator=g)[:5] for _ in range(count)])
    n1, n2 = rays(s)
    return n1[index], n2[index]


def test_the_true_matrix_satisfies_the_constraint():
    n1, n2 = rays(EXACT)
    assert float((to_homogeneous(n2) * (to_homogeneous(n1) @ E.T)).sum(-1).abs().max()) < 1e-14


def test_from_fundamental_and_back():
    F = 1e3 * fundamental_from_essential(E, EXACT.K1, EXACT.K2)
    assert float(same_up_to_sign(essential_from_fundamental(F, EXACT.K1, EXACT.K2), E)) < 1e-12


def test_the_projection_agrees_with_an_svd():
    A = E + 0.1 * torch.rand(
        5, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )
    U, _, Vt = torch.linalg.svd(A)
    expected = U @ torch.diag(torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)) @ Vt
    assert torch.allclose(project_to_essential(3 * A), expected, rtol=0, atol=1e-12)
    assert torch.allclose(project_to_essential(5 * E), E, rtol=0, atol=1e-14)


def test_the_decomposition_contains_the_pose_and_three_others():
    R, t = decompose_essential(-4 * E)
    gap = (R - EXACT.R).flatten(1).norm(dim=1) + (t - EXACT.t).norm(dim=1)
    assert float(gap.min()) < 1e-14
    assert torch.allclose(torch.linalg.det(R), torch.ones(4).double())
    assert torch.allclose(R @ R.mT, torch.eye(3).double().expand(4, 3, 3), atol=1e-14)
    assert float(same_up_to_sign(essential_from_pose(R, t), E).max()) < 1e-14
    pairs = torch.cat((R.flatten(1), t), 1)
    assert float(torch.cdist(pairs, pairs).fill_diagonal_(9).min()) > 0.1  # four different poses


def test_five_points_find_the_true_matrix_in_nearly_every_sample():
    solutions, valid = essential_5point(*samples(EXACT, 2000))
    gap = torch.where(valid, same_up_to_sign(solutions, E), torch.inf).amin(-1)
    assert float((gap < 1e-7).double().mean()) > 0.997
    assert torch.equal(solutions[~valid], torch.zeros_like(solutions[~valid]))


def test_every_solution_of_a_noisy_sample_satisfies_the_constraints():
    x1, x2 = samples(NOISY, 300)
    solutions, valid = essential_5point(x1, x2)
    M = solutions[valid]
    a, b = (to_homogeneous(x)[:, None].expand(-1, 10, -1, -1)[valid] for x in (x1, x2))
    assert float(((a @ M.mT) * b).sum(-1).abs().max()) < 1e-12
    S = torch.linalg.svdvals(M)
    assert torch.allclose(
        S, torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64).expand_as(S), atol=1e-9
    )


def test_all_solutions_of_kornia_are_found():
    x1, x2 = samples(NOISY, 200)
    ours, valid = essential_5point(x1, x2)
    theirs = kornia.geometry.epipolar.find_essential(x1, x2)
    theirs = 2**0.5 * theirs / theirs.flatten(-2).norm(dim=-1)[..., None, None]
    h1, h2 = to_homogeneous(x1)[:, None], to_homogeneous(x2)[:, None]
    fits = ((h1 @ theirs.mT) * h2).sum(-1).abs().amax(
        -1
    ) < 1e-9  # some of the results are NaN or not solutions
    S = torch.linalg.svdvals(theirs.nan_to_num())
    fits &= (S[..., 0] - S[..., 1]).abs() < 1e-7
    gap = torch.where(
        valid[:, None], same_up_to_sign(theirs[:, :, None], ours[:, None]), torch.inf
    ).amin(-1)
    assert int(fits.sum()) > 500
    assert float((gap[fits] < 1e-5).double().mean()) > 0.995


def test_batch_shapes_and_float32():
    x1, x2 = samples(NOISY, 6)
    flat, valid = essential_5point(x1, x2)
    shaped, _ = essential_5point(x1.reshape(2, 3, 5, 2), x2.reshape(2, 3, 5, 2))
    assert torch.equal(shaped.reshape(6, 10, 3, 3), flat)
    for i in range(6):
        alone, alone_valid = essential_5point(x1[i], x2[i])
        assert torch.equal(alone_valid, valid[i])
        assert torch.allclose(alone, flat[i], rtol=0, atol=1e-11)
    single, _ = essential_5point(x1.float(), x2.float())
    assert single.dtype == torch.float32


@pytest.mark.parametrize("kind", ["repeated", "origin"])
def test_degenerate_samples_give_no_solution_or_finite_matrices(kind):
    x = (
        torch.rand(1, 2, dtype=torch.float64).repeat(5, 1)
        if kind == "repeated"
        else torch.zeros(5, 2).double()
    )
    solutions, _ = essential_5point(x, x)
    assert torch.isfinite(solutions).all()


def test_bad_input_is_named():
    n1, n2 = rays(EXACT)
    with pytest.raises(DegenerateGeometryError, match="at least 5"):
        essential_5point(n1[:4], n2[:4])
    with pytest.raises(InputError, match="exactly 5"):
        essential_5point(n1[:6], n2[:6])
    with pytest.raises(InputError, match=r"\(\*B, 3, 3\)"):
        decompose_essential(torch.eye(4).double())


@pytest.mark.grad
@pytest.mark.parametrize("off", [0.0, 0.05])
def test_derivatives_on_and_off_the_manifold(off):
    M = (
        E + off * torch.rand(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    ).requires_grad_()
    assert gradcheck(project_to_essential, (M,))
    assert gradcheck(decompose_essential, (M,))
    F = (1e3 * fundamental_from_essential(M.detach(), EXACT.K1, EXACT.K2)).requires_grad_()
    eye = torch.eye(3).double()
    assert gradcheck(lambda A: essential_from_fundamental(A, eye, eye), (F,))


@pytest.mark.grad
def test_five_point_derivatives_are_implicit_and_work_with_functorch():
    a, b = (x.requires_grad_() for x in samples(NOISY, 3))
    assert gradcheck(lambda a, b: essential_5point(a, b)[0], (a, b))
    single = torch.func.jacrev(lambda a, b: essential_5point(a, b)[0])
    a, b = a.detach(), b.detach()
    batched = torch.func.vmap(single)(a, b)
    forward = torch.func.vmap(torch.func.jacfwd(lambda a, b: essential_5point(a, b)[0]))(a, b)
    assert torch.allclose(batched, forward, rtol=1e-9, atol=1e-9)
    assert torch.allclose(batched[0], single(a[0], b[0]), rtol=1e-6, atol=1e-6)


@pytest.mark.cuda
def test_cuda_agrees_with_cpu():
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    x1, x2 = samples(NOISY, 50)
    here, valid = essential_5point(x1, x2)
    there, there_valid = (a.cpu() for a in essential_5point(x1.cuda(), x2.cuda()))
    assert torch.equal(valid, there_valid)
    assert float(same_up_to_sign(here, there)[valid].max()) < 1e-8


def test_half_turn_decomposes():
    R = so3_exp(torch.tensor([0.0, torch.pi, 0.0], dtype=torch.float64))
    t = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    Rs, ts = decompose_essential(essential_from_pose(R, t))
    assert float(((Rs - R).flatten(1).norm(dim=1) + (ts - t).norm(dim=1)).min()) < 1e-14
