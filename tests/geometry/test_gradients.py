"""Derivatives of the small functions compared with finite differences.

The derivatives of the solvers are tested in the modules of the solvers.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.errors import InputError
from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.coordinates import (
    denormalize,
    from_homogeneous,
    hartley_normalization,
    inverse_intrinsics,
    normalize,
    to_homogeneous,
)
from sfmkit.geometry.essential import essential_from_pose
from sfmkit.geometry.fundamental import squared_sampson_distance
from sfmkit.geometry.homography import homography_from_pose, transfer
from sfmkit.geometry.homography_refinement import refine_homography
from sfmkit.geometry.lie import hat, so3_exp
from sfmkit.geometry.losses import loss_terms, marginal_score, marginal_weight
from sfmkit.geometry.pose import relative_pose, se3_from_pose
from sfmkit.geometry.refinement import refine_essential
from sfmkit.geometry.reprojection import reprojection_residuals
from sfmkit.geometry.triangulation import (
    corrected_matches,
    triangulate,
    triangulate_dlt,
    triangulate_midpoint,
    triangulate_optimal,
)

# The first forward-mode derivative makes torch (2.15) script its decompositions.
TORCH_SCRIPTS = r"ignore:`torch\.jit\.script` is deprecated:FutureWarning"

S = make_scene(6, noise=0.5)
P = make_scene(14, noise=0.4, planar=True)
N1, N2 = normalize(S.x1, S.K1), normalize(S.x2, S.K2)
E = essential_from_pose(S.R, S.t)
X = triangulate(N1, N2, S.R, S.t)
K5 = torch.tensor([800.0, 810.0, 320.0, 240.0, 1.0], dtype=torch.float64)
SQUARES = torch.tensor([0.0, 0.1, 0.7, 0.95, 1.5], dtype=torch.float64)
AXIS = torch.tensor([0.1, -0.4, 0.3], dtype=torch.float64)


def camera(k):
    """Return K of (fx, fy, cx, cy, skew); the entries below the diagonal are not unknowns."""
    zero, one = torch.zeros_like(k[..., 0]), torch.ones_like(k[..., 0])
    fx, fy, cx, cy, skew = k.unbind(-1)
    return torch.stack((fx, skew, cx, zero, fy, cy, zero, zero, one), -1).unflatten(-1, (3, 3))


def residuals(X, x1, x2, k, R, t):
    return reprojection_residuals(X, x1, x2, camera(k), camera(k), R, t)


def corrected(xn1, xn2, R, t):
    return tuple(c for x in corrected_matches(xn1, xn2, R, t) for c in x)


FUNCTIONS = {
    "to_homogeneous": (to_homogeneous, (S.x1,)),
    "from_homogeneous": (from_homogeneous, (X,)),
    "normalize": (lambda x, k: normalize(x, camera(k)), (S.x1, K5)),
    "denormalize": (lambda x, k: denormalize(x, camera(k)), (N1, K5)),
    "hartley_normalization": (hartley_normalization, (S.x1,)),
    "inverse_intrinsics": (lambda k: inverse_intrinsics(camera(k)), (K5,)),
    "hat": (hat, (AXIS,)),
    "relative_pose": (relative_pose, (S.R, S.t, so3_exp(AXIS), AXIS)),
    "squared_sampson_distance": (squared_sampson_distance, (E, N1, N2)),
    "reprojection_residuals": (residuals, (X, S.x1, S.x2, K5, S.R, S.t)),
    "corrected_matches": (corrected, (N1, N2, S.R, S.t)),
    "triangulate_optimal": (triangulate_optimal, (N1, N2, S.R, S.t)),
    "triangulate_midpoint": (triangulate_midpoint, (N1, N2, S.R, S.t)),
    "triangulate_dlt": (triangulate_dlt, (N1, N2, S.R, S.t)),
    "marginal_weight": (lambda s: marginal_weight(s, 1.0), (SQUARES[1:],)),
    "marginal_score": (lambda s: marginal_score(s, 1.0), (SQUARES[1:],)),
    **{
        f"loss_terms {loss}": (lambda s, loss=loss: loss_terms(loss, s, 0.8).value, (SQUARES[1:],))
        for loss in ("squared", "huber", "cauchy", "marginal")
    },
}


@pytest.mark.grad
@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_agree_with_finite_differences(name):
    function, values = FUNCTIONS[name]
    assert torch.autograd.gradcheck(
        function, tuple(v.clone().requires_grad_() for v in values), atol=1e-5
    )


@pytest.mark.grad
@pytest.mark.parametrize("loss", ["squared", "huber", "cauchy", "marginal"])
def test_slope_and_curvature_are_the_derivatives_of_the_loss(loss):
    s = SQUARES[1:].clone().requires_grad_()
    value, slope, curvature = loss_terms(loss, s, 0.8)
    (first,) = torch.autograd.grad(value.sum(), s, create_graph=True)
    torch.testing.assert_close(slope, first)
    h = 1e-6
    numeric = (
        loss_terms(loss, s.detach() + h, 0.8).slope - loss_terms(loss, s.detach() - h, 0.8).slope
    ) / (2 * h)
    torch.testing.assert_close(curvature, numeric, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("name", [n for n in FUNCTIONS if not n.startswith(("loss", "marginal"))])
def test_a_batch_agrees_with_its_items_and_float32_with_float64(name):
    function, values = FUNCTIONS[name]
    single = function(*values)
    batch = function(*(torch.stack((v, v)) for v in values))
    for one, many in zip(*((r if isinstance(r, tuple) else (r,)) for r in (single, batch))):
        torch.testing.assert_close(many, torch.stack((one, one)), rtol=1e-12, atol=1e-12)
    low = function(*(v.float() for v in values))
    for one, rough in zip(*((r if isinstance(r, tuple) else (r,)) for r in (single, low))):
        assert rough.dtype == torch.float32
        torch.testing.assert_close(
            rough.double(), one, rtol=1e-3, atol=1e-3 * float(one.abs().max())
        )


def essential(x1):
    return torch.cat([a.flatten() for a in refine_essential(S.R, S.t, x1, S.x2, S.K1, S.K2).pose])


def bundle(x1, loss):
    b = bundle_adjust(x1, S.x2, S.K1, S.K2, S.R, S.t, loss=loss)
    return torch.cat((b.R.flatten(), b.t, b.inverse_depth.flatten()))


def corners(x1):
    H = homography_from_pose(P.R, P.t, P.normal, P.distance, P.K1, P.K2)
    return transfer(refine_homography(H, x1, P.x2, threshold_px=5.0), P.x1[:4])


MINIMA = {
    "refine_essential": (essential, S.x1),
    "bundle_adjust squared": (lambda x: bundle(x, "squared"), S.x1),
    "bundle_adjust cauchy": (lambda x: bundle(x, "cauchy"), S.x1),
    "refine_homography": (corners, P.x1),
}


@pytest.mark.filterwarnings(TORCH_SCRIPTS)
@pytest.mark.grad
@pytest.mark.parametrize("name", MINIMA)
def test_forward_mode_at_a_minimum_agrees_with_reverse_mode(name):
    function, x1 = MINIMA[name]
    forward = torch.func.jacfwd(function)(x1)
    reverse = torch.func.jacrev(function)(x1)
    torch.testing.assert_close(forward, reverse, rtol=1e-8, atol=1e-8 * float(reverse.abs().max()))


@pytest.mark.grad
@pytest.mark.parametrize("name", MINIMA)
def test_second_derivatives_at_a_minimum_agree_with_finite_differences(name):
    function, x1 = MINIMA[name]
    assert torch.autograd.gradgradcheck(
        lambda x: function(x).sum(),
        x1.clone().requires_grad_(),
        eps=1e-4,
        atol=1e-5,
        rtol=1e-3,
        fast_mode=True,
    )


ONE_GRADIENT = {
    "refine_essential": "refine_essential(s.R, s.t, x1, s.x2, s.K1, s.K2).t",
    "bundle_adjust": "bundle_adjust(x1, s.x2, s.K1, s.K2, s.R, s.t).t",
    "refine_homography": (
        "refine_homography("
        "homography_from_pose(s.R, s.t, s.normal, s.distance, s.K1, s.K2), x1, s.x2)"
    ),
}


@pytest.mark.grad
@pytest.mark.parametrize("call", ONE_GRADIENT.values(), ids=ONE_GRADIENT)
def test_a_first_gradient_gives_no_warning(call):
    """Run in a new process: torch warns only at its first forward-mode derivative."""
    lines = (
        "from made_up_scene import make_scene",
        "from sfmkit.geometry.bundle import bundle_adjust",
        "from sfmkit.geometry.homography import homography_from_pose",
        "from sfmkit.geometry.homography_refinement import refine_homography",
        "from sfmkit.geometry.refinement import refine_essential",
        "s = make_scene(20, noise=0.4, planar=True)",
        "x1 = s.x1.clone().requires_grad_()",
        f"{call}.sum().backward()",
        "assert x1.grad.isfinite().all()",
    )
    made = subprocess.run(
        [sys.executable, "-W", "error::FutureWarning", "-c", "\n".join(lines)],
        cwd=Path(__file__).parent,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    assert made.returncode == 0, made.stderr[-2000:]
    assert made.stderr == ""


def derivatives():
    path = Path(__file__).parents[2] / "benchmarks" / "derivatives.py"
    spec = importlib.util.spec_from_file_location("derivatives", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def documented():
    """Return the rows of docs/derivatives.md as {function: {check: entry}}."""
    page = (Path(__file__).parents[2] / "docs" / "derivatives.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip(" `") for cell in line.strip("|").split("|")]
        for line in page.splitlines()
        if line.startswith("|") and not line.startswith("|---")
    ]
    return {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[1:]}


def test_the_table_of_derivatives_lists_every_public_function():
    module, rows = derivatives(), documented()
    assert sorted(rows) == sorted(module.public_functions()) == sorted(module.cases())
    assert "wrong" not in {entry for row in rows.values() for entry in row.values()}


@pytest.mark.grad
@pytest.mark.parametrize(
    "name", ["camera_from_pinhole", "cheirality", "epipoles", "hat", "transfer", "triangulate"]
)
def test_the_entries_of_the_table_are_reproduced(name):
    module, row = derivatives(), documented()[name]
    check = module.Check(module.cases()[name])
    assert {c: module.entry(check, c).text for c in module.CHECKS} == {
        c: row[c] for c in module.CHECKS
    }


@pytest.mark.filterwarnings(TORCH_SCRIPTS)
def test_se3_raises_in_forward_mode_where_kornia_loses_the_derivative_of_t():
    def moved(t):
        return se3_from_pose(S.R, t).matrix()

    with pytest.raises(InputError, match="forward mode"):
        torch.func.jacfwd(moved)(S.t)
    assert torch.func.jacrev(moved)(S.t)[:3, 3].equal(torch.eye(3, dtype=torch.float64))


def test_a_wrong_derivative_is_reported_as_wrong():
    class Doubled(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            return x.clone()

        @staticmethod
        def backward(ctx, grad):
            return 2 * grad

    module = derivatives()
    check = module.Check(module.Case(Doubled.apply, (AXIS,)))
    assert module.entry(check, "gradcheck").text == "wrong"
