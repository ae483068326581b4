"""Every row of docs/kornia.md: sfmkit and kornia on the same input.

Where kornia computes, the results are compared. Where sfmkit computes, the stated reason is
checked, so that a kornia release that removes the reason makes the row's test fail.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable
from pathlib import Path

import kornia.geometry
import numpy as np
import pytest
import torch
from kornia.geometry import calibration, conversions, epipolar, homography, linalg
from kornia.geometry.camera import PinholeCamera, perspective
from kornia.geometry.liegroup import Se3
from made_up_scene import make_scene
from torch import Tensor
from torch.autograd import gradcheck, gradgradcheck
from torch.autograd.gradcheck import GradcheckError

import sfmkit.geometry as G
from sfmkit.types import Camera

D = torch.float64
S = make_scene(60)
PLANE = make_scene(40, planar=True)
N1, N2 = G.normalize(S.x1, S.K1), G.normalize(S.x2, S.K2)
E = G.essential_from_pose(S.R, S.t)
F = G.fundamental_from_pose(S.R, S.t, S.K1, S.K2)
H = G.homography_from_pose(PLANE.R, PLANE.t, PLANE.normal, PLANE.distance, PLANE.K1, PLANE.K2)
SKEW = torch.tensor([[900.0, 30.0, 300.0], [0.0, 890.0, 250.0], [0.0, 0.0, 1.0]], dtype=D)
NEAR = S.x2 + torch.randn(60, 2, generator=torch.Generator().manual_seed(0), dtype=D)
TEXT = (Path(__file__).parents[2] / "docs" / "kornia.md").read_text()
ROWS = {
    m[1]: (m[2], m[3])
    for m in re.finditer(
        r"^\| `(\w+)` \| (`\w+`|missing) \| (kornia|sfmkit) \|", TEXT, re.MULTILINE
    )
}


def close(ours: Tensor, theirs: Tensor, tolerance: float = 1e-10) -> None:
    torch.testing.assert_close(ours, theirs, rtol=tolerance, atol=tolerance)


def fails(check: Callable[[], object]) -> bool:
    """Return whether a check or a transform of kornia's function fails or is not finite."""
    try:
        result = check()
    except (RuntimeError, GradcheckError):
        return True
    return isinstance(result, Tensor) and not bool(result.isfinite().all())


def differs(ours: Tensor, theirs: Tensor, by: float) -> None:
    assert not bool(((ours - theirs).abs() <= by).all())


def distance(A: Tensor, B: Tensor) -> float:
    """Return the largest distance of matrices that are defined up to scale."""
    A, B = (M / M.flatten(-2).norm(dim=-1)[..., None, None] for M in (A, B))
    apart = torch.minimum((A - B).flatten(-2).norm(dim=-1), (A + B).flatten(-2).norm(dim=-1))
    return float(apart.max())


def public_names() -> set[str]:
    """Return all public names of kornia.geometry and its modules."""
    names = set()
    for module in pkgutil.walk_packages(kornia.geometry.__path__, "kornia.geometry."):
        names |= {n for n in dir(importlib.import_module(module.name)) if not n.startswith("_")}
    return {n.lower() for n in names}


def missing(*words: str) -> Callable[[], None]:
    """Return a check that no public name of kornia.geometry contains all of the words."""

    def check() -> None:
        found = [n for n in public_names() if all(w in n for w in words)]
        assert not found, f"kornia may have a counterpart now: {found}"

    return check


def from_homogeneous() -> None:
    point = torch.tensor([[2.0, 4.0, 0.0]], dtype=D)
    assert G.from_homogeneous(point).isinf().all()
    assert conversions.convert_points_from_homogeneous(point).tolist() == [[2.0, 4.0]]


def normalize() -> None:
    close(N1, conversions.normalize_points_with_intrinsics(S.x1, S.K1))
    theirs = conversions.normalize_points_with_intrinsics(S.x1, SKEW)
    differs(G.normalize(S.x1, SKEW), theirs, 1e-3)


def denormalize() -> None:
    close(G.denormalize(N1, S.K1), conversions.denormalize_points_with_intrinsics(N1, S.K1))
    theirs = conversions.denormalize_points_with_intrinsics(N1, SKEW)
    differs(G.denormalize(N1, SKEW), theirs, 1e-3)


def hartley_normalization() -> None:
    ours = G.hartley_normalization(S.x1)[0]
    theirs = epipolar.normalize_points(S.x1[None])[0][0]
    close(ours / ours.norm(), theirs / theirs.norm())
    batch = S.x1.expand(2, -1, -1)
    assert fails(lambda: torch.func.vmap(lambda x: epipolar.normalize_points(x[None])[0])(batch))
    torch.func.vmap(lambda x: G.hartley_normalization(x)[0])(batch)
    assert float(epipolar.normalize_points(torch.ones(1, 9, 2, dtype=D))[1].max()) > 1e8


def inverse_intrinsics() -> None:
    close(G.inverse_intrinsics(SKEW), torch.linalg.inv(SKEW))
    missing("inverse", "intrinsics")


CAMERA = Camera(S.K1.numpy(), (640, 480))


def pinhole() -> None:
    camera = G.pinhole_from_camera(CAMERA, S.R, S.t)
    assert isinstance(camera, PinholeCamera)
    X = torch.rand(5, 3, dtype=D) + 3
    close(camera.project(X[None])[0], G.project(X, S.K1, S.R, S.t))
    np.testing.assert_array_equal(G.camera_from_pinhole(camera)[0].K, CAMERA.K)


def distort() -> None:
    d = torch.tensor([-0.2, 0.05, 1e-3, -5e-4, 0.01], dtype=D)
    close(G.distort(N1, d), calibration.distort_points(N1, torch.eye(3, dtype=D), d))


def undistort() -> None:
    radii = torch.stack((torch.linspace(0, 0.9, 50, dtype=D), torch.zeros(50, dtype=D)), -1)
    d, eye = torch.tensor([-0.35, 0, 0, 0, 0], dtype=D), torch.eye(3, dtype=D)
    seen = G.distort(radii, d)
    close(G.undistort(seen, d), radii)
    off = (calibration.undistort_points(seen, eye, d) - radii).norm(dim=-1) > 1e-6
    assert float(off.double().mean()) > 0.3


def so3_exp() -> None:
    w = torch.randn(50, 3, dtype=D)
    close(G.so3_exp(w), conversions.axis_angle_to_rotation_matrix(w))
    close(G.so3_exp(w), torch.linalg.matrix_exp(G.hat(w)))


def so3_log() -> None:
    close(G.so3_log(S.R), conversions.rotation_matrix_to_axis_angle(S.R))
    eye = torch.eye(3, dtype=D, requires_grad=True)
    assert gradgradcheck(G.so3_log, (eye,))
    assert fails(lambda: gradgradcheck(conversions.rotation_matrix_to_axis_angle, (eye,)))


def se3() -> None:
    pose = G.se3_from_pose(S.R, S.t)
    assert isinstance(pose, Se3)
    R, t = G.pose_from_se3(pose)
    close(R, S.R)
    close(t, S.t)


def relative_pose() -> None:
    R, t = G.relative_pose(S.R, S.t, S.R @ S.R, 2 * S.t)
    theirs = epipolar.relative_camera_motion(S.R, S.t[:, None], S.R @ S.R, 2 * S.t[:, None])
    close(R, theirs[0])
    close(t, theirs[1][:, 0])


def essential_from_pose() -> None:
    eye, zero = torch.eye(3, dtype=D), torch.zeros(3, 1, dtype=D)
    close(E, epipolar.essential_from_Rt(eye, zero, S.R, S.t[:, None]))
    close(E, torch.linalg.cross(S.t[:, None].expand(3, 3), S.R, dim=0))


def essential_from_fundamental() -> None:
    product = epipolar.essential_from_fundamental(F, S.K1, S.K2)
    assert distance(G.essential_from_fundamental(F, S.K1, S.K2), product) < 1e-9


def finite_at_exact(ours: Callable, theirs: Callable) -> None:
    exact = E.clone().requires_grad_()
    assert gradcheck(ours, (exact,))
    assert fails(lambda: gradcheck(theirs, (exact,)))


def project_to_essential() -> None:
    noisy = E + 0.1 * torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=D)
    assert distance(G.project_to_essential(noisy), epipolar.project_to_essential(noisy)) < 1e-9
    finite_at_exact(G.project_to_essential, epipolar.project_to_essential)


def decompose_essential() -> None:
    ours, theirs = G.decompose_essential(E)[0], epipolar.motion_from_essential(E)[0]
    for R in ours:
        assert float((R - theirs).flatten(1).norm(dim=1).min()) < 1e-9
    finite_at_exact(
        lambda M: G.decompose_essential(M)[0], lambda M: epipolar.motion_from_essential(M)[0]
    )
    no_svd = torch.func.vmap(lambda M: epipolar.decompose_essential_matrix_no_svd(M)[0])
    assert fails(lambda: no_svd(E.expand(2, 3, 3)))
    torch.func.vmap(lambda M: G.decompose_essential(M)[0])(E.expand(2, 3, 3))


def missed(candidates: Tensor, truth: Tensor, tolerance: float) -> int:
    """Count the samples without a candidate within the tolerance of the true matrix."""
    C = candidates.nan_to_num()
    C = C / C.flatten(-2).norm(dim=-1)[..., None, None].clamp(min=1e-300)
    T = (truth / truth.flatten(-2).norm(dim=-1)[..., None, None])[:, None]
    apart = torch.minimum((C - T).flatten(-2).norm(dim=-1), (C + T).flatten(-2).norm(dim=-1))
    return int((apart.amin(-1) > tolerance).sum())


def samples(n: int, size: int, forward: bool) -> tuple[Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(3)
    X = torch.rand(n, size, 3, generator=g, dtype=D) * torch.tensor([4.0, 3, 4]).double()
    X = X + torch.tensor([-2.0, -1.5, 4.0], dtype=D)
    R = G.so3_exp(0.2 * torch.randn(n, 3, generator=g, dtype=D))
    t = 0.1 * torch.randn(n, 3, generator=g, dtype=D)
    t[:, 2 if forward else 0] += 1
    Y = X @ R.mT + t[:, None]
    return X[..., :2] / X[..., 2:], Y[..., :2] / Y[..., 2:], G.essential_from_pose(R, t)


def essential_5point() -> None:
    x1, x2, truth = samples(1500, 5, forward=True)
    ours = missed(G.essential_5point(x1, x2)[0], truth, 1e-6)
    assert ours < missed(epipolar.find_essential(x1, x2), truth, 1e-6)


def fundamental_7point() -> None:
    ours, valid = G.fundamental_7point(S.x1[:7], S.x2[:7])
    theirs = epipolar.find_fundamental(S.x1[None, :7], S.x2[None, :7], method="7POINT")[0]
    for M in ours[valid]:
        assert min(distance(M, C) for C in theirs if C.abs().max() > 0) < 1e-8


def fundamental_8point() -> None:
    x1, x2, truth = samples(50, 20, forward=False)
    ours, theirs = G.fundamental_8point(x1, x2), epipolar.find_fundamental(x1, x2)
    assert distance(ours, theirs) < 1e-6
    assert 5 * distance(ours, truth) < distance(theirs, truth)


def fundamental_from_projections() -> None:
    P1 = torch.cat((S.K1, torch.zeros(3, 1, dtype=D)), 1)
    P2 = S.K2 @ torch.cat((S.R, S.t[:, None]), 1)
    close(G.fundamental_from_projections(P1, P2), epipolar.fundamental_from_projections(P1, P2))
    assert distance(G.fundamental_from_projections(P1, P2), F) < 1e-9


def signed_sampson_distance() -> None:
    ours = G.signed_sampson_distance(F, S.x1, NEAR)
    assert bool((ours < 0).any())
    close(ours.abs(), epipolar.sampson_epipolar_distance(S.x1, NEAR, F, squared=False), 1e-8)
    assert bool((epipolar.sampson_epipolar_distance(S.x1, NEAR, F, squared=False) >= 0).all())


def kornia_dlt(x1: Tensor, x2: Tensor) -> Tensor:
    M = homography.find_homography_dlt(x1[None], x2[None])[0]
    return M / M.norm()


def homography_dlt() -> None:
    x1, x2 = (x[:12] / 100 for x in (PLANE.x1, PLANE.x2))
    assert distance(G.homography_dlt(x1, x2), kornia_dlt(x1, x2)) < 1e-9
    a, b = x1.clone().requires_grad_(), x2.clone().requires_grad_()
    assert gradcheck(G.homography_dlt, (a, b))
    assert fails(lambda: gradcheck(kornia_dlt, (a, b)))
    assert fails(lambda: torch.func.vmap(kornia_dlt)(x1.expand(2, 12, 2), x2.expand(2, 12, 2)))


def homography_4point() -> None:
    x1, x2 = PLANE.x1[:4], PLANE.x2[:4]
    theirs = kornia.geometry.get_perspective_transform(x1[None], x2[None])
    assert distance(G.homography_4point(x1, x2), theirs[0]) < 1e-9
    repeated = torch.stack((x1, x1[[0, 0, 2, 3]])), torch.stack((x2, x2[[0, 0, 2, 3]]))
    assert G.homography_4point(*repeated).isfinite().all()
    assert fails(lambda: kornia.geometry.get_perspective_transform(*repeated))


def transfer() -> None:
    close(G.transfer(H, S.x1), linalg.transform_points(H[None], S.x1[None])[0])
    far = torch.tensor([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]], dtype=D)
    x = torch.tensor([[1e-9, 2.0]], dtype=D)
    close(G.transfer(far, x), torch.tensor([[1.0, 2e9]], dtype=D))
    differs(linalg.transform_points(far[None], x[None])[0], G.transfer(far, x), 1.0)


def squared_symmetric_transfer_error() -> None:
    x1, x2 = PLANE.x1, PLANE.x2 + 1
    theirs = homography.symmetric_transfer_error(x1[None], x2[None], H[None])[0]
    close(G.squared_symmetric_transfer_error(H, x1, x2), theirs)
    singular = torch.zeros(1, 3, 3, dtype=D)
    largest = homography.symmetric_transfer_error(x1[None], x2[None], singular)
    assert bool((largest == torch.finfo(D).max).all())


def choose_pose() -> None:
    """Test that kornia triangulates; the benchmark measures the time."""
    R, _, _ = G.choose_pose(*G.decompose_essential(E), N1, N2)
    theirs = epipolar.motion_from_essential_choose_solution(E, S.K1, S.K2, S.x1, S.x2)
    close(R, theirs[0], 1e-8)
    assert theirs[2].shape == (60, 3)


def project() -> None:
    X = torch.rand(9, 3, dtype=D) + torch.tensor([0.0, 0, 3], dtype=D)
    close(G.project(X, S.K1), perspective.project_points(X, S.K1.expand(9, 3, 3)))
    differs(G.project(X, SKEW), perspective.project_points(X, SKEW.expand(9, 3, 3)), 0.1)


def triangulate() -> None:
    P1, P2 = torch.eye(3, 4, dtype=D), torch.cat((S.R, S.t[:, None]), 1)
    theirs = epipolar.triangulate_points(P1[None], P2[None], N1[None], N2[None])[0]
    close(G.triangulate(N1, N2, S.R, S.t, "dlt"), theirs, 1e-7)
    ray = torch.tensor([[0.1, 0.2]], dtype=D)
    far = G.from_homogeneous(G.to_homogeneous(ray) @ S.R.mT)  # the same direction in camera 2
    infinite = epipolar.triangulate_points(P1[None], P2[None], ray[None], far[None])
    assert infinite.isnan().all()
    assert not G.triangulate(ray, far, S.R, S.t, homogeneous=True).isnan().any()


def kornia_distance(ours: Callable, theirs: Callable, M: Tensor) -> Callable[[], None]:
    return lambda: close(
        ours(M, S.x1, NEAR), theirs(S.x1[None], NEAR[None], M[None], squared=True)[0]
    )


CHECKS: dict[str, Callable[[], None]] = {
    "to_homogeneous": lambda: close(
        G.to_homogeneous(S.x1), conversions.convert_points_to_homogeneous(S.x1)
    ),
    "from_homogeneous": from_homogeneous,
    "normalize": normalize,
    "denormalize": denormalize,
    "hartley_normalization": hartley_normalization,
    "inverse_intrinsics": inverse_intrinsics,
    "pinhole_from_camera": pinhole,
    "camera_from_pinhole": pinhole,
    "distort": distort,
    "distort_pixels": distort,
    "undistort": undistort,
    "undistort_pixels": undistort,
    "hat": lambda: close(G.hat(S.t), epipolar.cross_product_matrix(S.t)),
    "so3_exp": so3_exp,
    "so3_log": so3_log,
    "tangent_basis": missing("tangent"),
    "sphere_exp": missing("sphere", "exp"),
    "se3_from_pose": se3,
    "pose_from_se3": se3,
    "relative_pose": relative_pose,
    "essential_from_pose": essential_from_pose,
    "essential_from_fundamental": essential_from_fundamental,
    "project_to_essential": project_to_essential,
    "decompose_essential": decompose_essential,
    "essential_5point": essential_5point,
    "fundamental_7point": fundamental_7point,
    "fundamental_8point": fundamental_8point,
    "fundamental_from_essential": lambda: close(
        G.fundamental_from_essential(E, S.K1, S.K2),
        epipolar.fundamental_from_essential(E, S.K1, S.K2),
    ),
    "fundamental_from_pose": lambda: close(F, epipolar.fundamental_from_essential(E, S.K1, S.K2)),
    "fundamental_from_projections": fundamental_from_projections,
    "epipolar_lines": lambda: close(
        G.epipolar_lines(F, S.x1), epipolar.compute_correspond_epilines(S.x1, F)
    ),
    "clip_lines": missing("clip"),
    "epipoles": missing("epipole"),
    "signed_sampson_distance": signed_sampson_distance,
    "squared_sampson_distance": kornia_distance(
        G.squared_sampson_distance, epipolar.sampson_epipolar_distance, F
    ),
    "squared_symmetric_epipolar_distance": kornia_distance(
        G.squared_symmetric_epipolar_distance, epipolar.symmetrical_epipolar_distance, F
    ),
    "homography_dlt": homography_dlt,
    "homography_4point": homography_4point,
    "transfer": transfer,
    "squared_transfer_error": kornia_distance(
        G.squared_transfer_error, homography.oneway_transfer_error, H
    ),
    "squared_symmetric_transfer_error": squared_symmetric_transfer_error,
    "squared_homography_sampson_distance": kornia_distance(
        G.squared_homography_sampson_distance, homography.sampson_homography_distance, H
    ),
    "homography_from_pose": missing("homography", "pose"),
    "decompose_homography": missing("decompose", "homography"),
    "refine_homography": missing("refine", "homography"),
    "refine_essential": missing("refine", "essential"),
    "refine_focal": missing("refine", "focal"),
    "shared_focal": missing("shared", "focal"),
    "one_focal": missing("one", "focal"),
    "two_focals": missing("focal", "fundamental"),
    "bundle_adjust": missing("bundle"),
    "covariance": missing("covariance"),
    "sigma_degrees": missing("sigma", "degree"),
    "linearise_pose": missing("linearise"),
    "jackknife_covariance": missing("jackknife"),
    "camera_covariance": missing("covariance"),
    "point_derivatives": missing("derivatives"),
    "point_covariances": missing("covariance"),
    "image_blocks": missing("image", "block"),
    "pose_sensitivity": missing("sensitivity"),
    "influence": missing("influence"),
    "cheirality": missing("cheirality"),
    "choose_pose": choose_pose,
    "check_pose": missing("check", "pose"),
    "rotation_error": missing("rotation", "error"),
    "translation_error": missing("translation", "error"),
    "pose_auc": missing("auc"),
    "project": project,
    "reprojection_residuals": missing("residual"),
    "reprojection_error": missing("reprojection"),
    "triangulate": triangulate,
    "triangulate_dlt": triangulate,
    "triangulate_midpoint": missing("midpoint"),
    "triangulate_optimal": missing("triangulat", "optimal"),
    "corrected_matches": missing("correct", "matches"),
    "parallax": missing("parallax"),
    "fit_similarity": missing("umeyama"),
    "loss_terms": missing("loss", "term"),
    "marginal_weight": missing("marginal"),
    "marginal_score": missing("magsac"),
}


@pytest.mark.parametrize("function", CHECKS)
def test_row(function):
    CHECKS[function]()


def test_the_table_has_one_row_per_public_function():
    public = {n for n in G.__all__ if not isinstance(getattr(G, n), type)}
    assert set(ROWS) == public
    assert set(CHECKS) == public


def test_every_public_function_of_the_modules_is_exported():
    """The checks and the unchecked kernels are exceptions."""
    kernels = {"bearings", "minimise", "focal_unknowns"}  # of the refinements
    for module in pkgutil.iter_modules(G.__path__, "sfmkit.geometry."):
        name = module.name.rpartition(".")[2]
        if name in ("checks", "kernels") or name.startswith("_"):
            continue
        loaded = importlib.import_module(module.name)
        own = {
            n
            for n, f in vars(loaded).items()
            if inspect.isfunction(f) and f.__module__ == module.name and not n.startswith("_")
        }
        assert own - kernels <= set(G.__all__), name


def test_counterparts_exist_in_kornia():
    names = public_names() | {n.lower() for n in dir(kornia.geometry)}
    for function, (counterpart, _) in ROWS.items():
        assert counterpart == "missing" or counterpart.strip("`").lower() in names, function


def test_kornia_computes_at_least_fifteen_functions():
    assert sum(who == "kornia" for _, who in ROWS.values()) >= 15


def test_the_figures_belong_to_the_installed_version():
    assert kornia.__version__ in TEXT
