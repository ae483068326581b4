"""Cheirality, the choice of pose and pose errors against OpenCV, triangulation and closed forms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_scene import make_scene
from torch.autograd import gradcheck

from sfmkit.errors import InputError
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.lie import hat, so3_exp
from sfmkit.geometry.pose import (
    cheirality,
    choose_pose,
    pose_auc,
    relative_pose,
    rotation_error,
    translation_error,
)
from sfmkit.geometry.triangulation import triangulate_midpoint

D = torch.float64


def normalised(noise: float = 0.0, seed: int = 0, n: int = 60):
    s = make_scene(n, noise=noise, seed=seed)
    return normalize(s.x1, s.K1), normalize(s.x2, s.K2), s.R, s.t


def candidates(R: torch.Tensor, t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the four poses of the essential matrix of (R, t); the true one is the third."""
    twisted = (2 * torch.outer(t, t) - torch.eye(3, dtype=D)) @ R
    return torch.stack((twisted, twisted, R, R)), torch.stack((t, -t, t, -t))


def test_cheirality_agrees_with_the_signs_of_the_triangulated_depths():
    xn1, xn2, R, t = normalised(noise=2.0)
    R4, t4 = candidates(R, t)
    ours = cheirality(xn1[None], xn2[None], R4, t4)
    for mask, Rk, tk in zip(ours, R4, t4):
        X = triangulate_midpoint(xn1, xn2, Rk, tk)
        c = -Rk.T @ tk
        ray2 = torch.cat((xn2, torch.ones(60, 1)), 1).double() @ Rk
        ray1 = torch.cat((xn1, torch.ones(60, 1)), 1).double()
        # Depths along both rays from a least-squares solution of s1 d1 - s2 d2 = c, one match at a
        # time.
        for k in range(60):
            s = torch.linalg.lstsq(torch.stack((ray1[k], -ray2[k]), 1), c[:, None]).solution[:, 0]
            assert bool((s > 0).all()) == bool(mask[k])
        assert X.isfinite().all()
    assert ours.sum(-1).tolist() == [0, 0, 60, 0]


def test_the_choice_agrees_with_opencv():
    xn1, xn2, R, t = normalised(noise=1.0)
    chosen_R, chosen_t, counts = choose_pose(*candidates(R, t), xn1, xn2)
    n, R_cv, t_cv, _ = cv2.recoverPose((hat(t) @ R).numpy(), xn1.numpy(), xn2.numpy(), np.eye(3))
    assert int(counts.max()) == n
    np.testing.assert_allclose(chosen_R.numpy(), R_cv, atol=1e-12)
    np.testing.assert_allclose(chosen_t.numpy(), t_cv[:, 0], atol=1e-12)


def test_each_item_of_a_batch_has_its_own_choice():
    items = [normalised(seed=s) for s in range(4)]
    poses = [candidates(R, t) for _, _, R, t in items]
    # The true pose has another position in every item.
    poses = [(R4.roll(k, 0), t4.roll(k, 0)) for k, (R4, t4) in enumerate(poses)]
    R, t, counts = choose_pose(
        *(torch.stack(a) for a in zip(*poses)), *(torch.stack(a) for a in list(zip(*items))[:2])
    )
    assert counts.argmax(-1).tolist() == [2, 3, 0, 1]
    torch.testing.assert_close(R, torch.stack([i[2] for i in items]), rtol=0, atol=0)
    torch.testing.assert_close(t, torch.stack([i[3] for i in items]), rtol=0, atol=0)
    mapped = torch.func.vmap(choose_pose)(
        *(torch.stack(a) for a in zip(*poses)), *(torch.stack(a) for a in list(zip(*items))[:2])
    )
    torch.testing.assert_close(mapped[0], R, rtol=0, atol=0)


def test_weights_determine_the_choice():
    xn1, xn2, R, t = normalised()
    wrong = -xn2  # matches that support other poses
    both1, both2 = torch.cat((xn1, xn1)), torch.cat((xn2, wrong))
    weights = torch.cat((torch.ones(60, dtype=D), torch.zeros(60, dtype=D)))
    chosen, _, counts = choose_pose(*candidates(R, t), both1, both2, weights)
    torch.testing.assert_close(chosen, R)
    assert counts.tolist() == [0, 0, 60, 0]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 1000))
def test_swapping_the_images_does_not_change_cheirality(seed):
    xn1, xn2, R, t = normalised(noise=50.0, seed=seed)
    swapped = cheirality(xn2, xn1, R.T, -R.T @ t)
    assert torch.equal(cheirality(xn1, xn2, R, t), swapped)


@pytest.mark.parametrize("degrees", [0.0, 1e-10, 1e-6, 0.01, 1.0, 90.0, 179.999999, 180.0])
def test_angles_are_accurate_near_zero_and_180_degrees(degrees):
    angle = torch.deg2rad(torch.tensor(degrees, dtype=D))
    axis = torch.nn.functional.normalize(torch.tensor([1.0, -2.0, 0.5], dtype=D), dim=0)
    R0 = so3_exp(torch.tensor([0.3, -0.2, 1.0], dtype=D))
    assert float(rotation_error(R0, R0 @ so3_exp(angle * axis))) == pytest.approx(
        degrees, abs=1e-13, rel=1e-12
    )
    a = torch.tensor([0.0, 3.0, 0.0], dtype=D)
    b = torch.stack((0 * angle, angle.cos(), angle.sin()))
    assert float(translation_error(a, b)) == pytest.approx(degrees, abs=1e-13, rel=1e-12)
    assert float(translation_error(a, b, sign_invariant=True)) == pytest.approx(
        min(degrees, 180 - degrees), abs=1e-13, rel=1e-6
    )


def test_relative_pose_from_the_world():
    g = torch.Generator().manual_seed(0)
    (w1, w2, t1, t2), X = (
        torch.randn(4, 3, generator=g, dtype=D),
        torch.randn(3, generator=g, dtype=D),
    )
    R1, R2 = so3_exp(w1), so3_exp(w2)
    R, t = relative_pose(R1, t1, R2, t2)
    torch.testing.assert_close(R @ (R1 @ X + t1) + t, R2 @ X + t2)


def test_auc_is_the_area_under_the_recall_curve():
    errors = torch.tensor([0.1, 0.4, 0.4, 1.7, 3.0, torch.nan, torch.inf], dtype=D)
    thresholds = [0.25, 0.5, 2.0, 10.0]
    for area, top in zip(pose_auc(errors, thresholds), thresholds):
        e = torch.linspace(0, top, 200_001, dtype=D)
        recall = (torch.nan_to_num(errors, nan=torch.inf)[:, None] <= e).double().mean(0)
        assert float(area) == pytest.approx(float(recall.mean()), abs=1e-5)
    assert pose_auc(torch.zeros(3), [1.0]).tolist() == [1.0]


@pytest.mark.grad
def test_derivatives():
    g = torch.Generator().manual_seed(0)
    a, b = torch.randn(2, 3, generator=g, dtype=D, requires_grad=True)
    assert gradcheck(lambda a, b: rotation_error(so3_exp(a), so3_exp(b)), (a, b))
    assert gradcheck(translation_error, (a, b))
    assert gradcheck(lambda e: pose_auc(e, [1.0, 5.0]), (a.abs(),))
    for error, x in ((rotation_error, so3_exp(a)), (translation_error, a)):
        (grad,) = torch.autograd.grad(error(x, x), a, allow_unused=False)
        assert grad.isfinite().all()


def test_bad_input_is_named():
    xn1, xn2, R, t = normalised()
    with pytest.raises(InputError, match="baseline"):
        cheirality(xn1, xn2, R, torch.zeros(3, dtype=D))
    with pytest.raises(InputError, match="R"):
        cheirality(xn1, xn2, R[:2], t)
    with pytest.raises(InputError, match="weights"):
        choose_pose(*candidates(R, t), xn1, xn2, torch.ones(3, dtype=D))
