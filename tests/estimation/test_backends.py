"""Every robust back end on scenes whose answer is known."""

from __future__ import annotations

import sys

import pytest
import torch
from made_up_scene import make_scene, same_up_to_sign

from sfmkit.errors import InputError
from sfmkit.estimation import ESTIMATOR_PLUGINS, opencv, peers, robust, run_estimator
from sfmkit.estimation._agreement import disagreement
from sfmkit.estimation._problems import quick_scores
from sfmkit.estimation.robust import essential_score
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.essential import decompose_essential, essential_from_pose
from sfmkit.geometry.fundamental import fundamental_from_pose, signed_sampson_distance
from sfmkit.geometry.homography import decompose_homography, homography_from_pose, transfer
from sfmkit.geometry.losses import marginal_score
from sfmkit.geometry.pose import choose_pose, rotation_error, translation_error

GENERAL = make_scene(800, noise=0.3, outliers=0.5)
PLANE = make_scene(800, noise=0.3, outliers=0.5, planar=True)
TRUE_E = essential_from_pose(GENERAL.R, GENERAL.t)


def engines():
    return [
        "torch",
        "opencv",
        *(pytest.param(name, id=name, marks=pytest.mark.peers) for name in peers.PEERS),
    ]


def engine(which):
    if which in peers.PEERS:
        pytest.importorskip(which)
    return ESTIMATOR_PLUGINS[which]


def zero_skew(s) -> torch.Tensor:
    """The peers do not support skew: image 2 as a camera without it sees it."""
    K2 = s.K2.clone()
    K2[0, 1] = 0
    return K2


def pose_gap(E: torch.Tensor, s=GENERAL) -> float:
    R, t = decompose_essential(E)
    return float(torch.maximum(rotation_error(R, s.R), translation_error(t, s.t)).min())


@pytest.mark.parametrize("which", engines())
def test_essential_with_two_cameras_and_half_the_matches_wrong(which):
    s, K2 = GENERAL, zero_skew(GENERAL)
    fit = engine(which)(s.x1, s.x2, s.K1, K2, threshold_px=1.0)
    assert pose_gap(fit.model) < 0.3  # skew of one pixel left out: a few hundredths of a degree
    assert int(fit.inliers[400:].sum()) > 330
    assert int(fit.inliers[:400].sum()) < 20
    assert 150 < fit.score < int(fit.inliers.sum())


@pytest.mark.parametrize("which", engines())
def test_fundamental(which):
    s = GENERAL
    fit = engine(which)(s.x1, s.x2, threshold_px=1.0, model="fundamental")
    clean = make_scene(200, seed=5)
    assert float(signed_sampson_distance(fit.model, clean.x1, clean.x2).abs().max()) < 1.0
    assert (
        float(
            signed_sampson_distance(fundamental_from_pose(s.R, s.t, s.K1, s.K2), clean.x1, clean.x2)
            .abs()
            .max()
        )
        < 1e-9
    )
    assert int(fit.inliers[400:].sum()) > 350


@pytest.mark.parametrize("which", engines())
def test_homography(which):
    s = PLANE
    fit = engine(which)(s.x1, s.x2, threshold_px=1.0, model="homography")
    H = homography_from_pose(s.R, s.t, s.normal, s.distance, s.K1, s.K2)
    assert float((transfer(fit.model, s.x1[400:]) - transfer(H, s.x1[400:])).abs().max()) < 0.5
    assert int(fit.inliers[400:].sum()) > 350
    assert int(fit.inliers[:400].sum()) < 5


@pytest.mark.parametrize("which", engines())
def test_hopeless_input_yields_no_model(which):
    e = engine(which)
    K = GENERAL.K1
    few, same = GENERAL.x1[:3], GENERAL.x1[:1].repeat(30, 1)
    assert e(few, few, K, K).model is None
    assert e(few, few, model="fundamental").model is None
    assert e(few, few, model="homography").model is None
    assert not e(few, few, K, K).inliers.any()
    assert e(same, same, model="homography").model is None or which in peers.PEERS
    nan = GENERAL.x1 * torch.nan
    with pytest.raises(InputError, match="NaN"):
        e(nan, GENERAL.x2, GENERAL.K1, GENERAL.K2)
    with pytest.raises(InputError, match="no method 'guess'"):
        e(GENERAL.x1, GENERAL.x2, K, K, method="guess")


@pytest.mark.parametrize("method", sorted(opencv.METHODS))
def test_every_method_of_opencv(method):
    s = make_scene(300, noise=0.2, outliers=0.2)
    assert pose_gap(opencv.estimate(s.x1, s.x2, s.K1, s.K2, method=method).model) < 1.5


@pytest.mark.parametrize("which", engines())
def test_same_seed_same_bits(which):
    s, K2 = GENERAL, zero_skew(GENERAL)
    a, b = (engine(which)(s.x1, s.x2, s.K1, K2, seed=7) for _ in range(2))
    assert torch.equal(a.model, b.model)
    assert torch.equal(a.inliers, b.inliers)


def test_missing_peer_says_which_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "poselib", None)
    with pytest.raises(InputError, match=r"sfmkit\[peers\]"):
        run_estimator("poselib", GENERAL.x1, GENERAL.x2, GENERAL.K1, GENERAL.K2)
    with pytest.raises(InputError, match="unknown estimator 'matlab'"):
        run_estimator("matlab", GENERAL.x1, GENERAL.x2, GENERAL.K1, GENERAL.K2)


def test_torch_history_rises_and_ends_in_the_result():
    s = GENERAL
    fit = robust.estimate(s.x1, s.x2, s.K1, s.K2)
    search = [h.score for h in fit.history[:-1]]
    assert search == sorted(search)
    assert fit.history[-1].stage == "refinement"
    assert torch.equal(fit.history[-1].model, fit.model)
    assert fit.history[-1].inliers == int(fit.inliers.sum())
    assert fit.score == pytest.approx(
        float(essential_score(fit.model, s.x1, s.x2, s.K1, s.K2, 1.0)), rel=1e-9
    )


def test_torch_uses_ratios_and_operators_to_need_fewer_samples():
    s = make_scene(2000, noise=0.3, outliers=0.9)
    g = torch.Generator().manual_seed(0)
    wrong = torch.arange(2000) < 1800
    ratio = torch.where(
        wrong, 0.6 + 0.4 * torch.rand(2000, generator=g), 0.3 + 0.6 * torch.rand(2000, generator=g)
    ).double()
    plain = robust.estimate(s.x1, s.x2, s.K1, s.K2)
    guided = robust.estimate(s.x1, s.x2, s.K1, s.K2, ratio=ratio, groups=wrong.long())
    assert guided.iterations < plain.iterations / 3
    assert pose_gap(guided.model, s) < 0.2


@pytest.mark.parametrize("seed", range(8))
def test_torch_finds_the_pose_behind_a_bare_plane(seed):
    """Other essential matrices fit the matches of a plane as well, but leave many of its points
    behind a camera."""
    s = make_scene(350, noise=0.5, seed=seed, planar=True)
    fit = robust.estimate(s.x1, s.x2, s.K1, s.K2, seed=seed)
    xn1, xn2 = normalize(s.x1, s.K1)[fit.inliers], normalize(s.x2, s.K2)[fit.inliers]
    R, t, counts = choose_pose(*decompose_essential(fit.model), xn1, xn2)
    assert int(counts.max()) > 0.95 * len(xn1)
    second = decompose_homography(fit_plane(s), s.K1, s.K2)  # a plane allows two motions
    allowed = [(s.R, s.t), *zip(*second[:2])]
    assert (
        min(float(torch.maximum(rotation_error(R, Q), translation_error(t, u))) for Q, u in allowed)
        < 3
    )


def fit_plane(s):
    return homography_from_pose(s.R, s.t, s.normal, s.distance, s.K1, s.K2)


@pytest.mark.parametrize("seed", range(5))
def test_torch_solves_what_chance_samples_would_not(seed):
    """6 % right: 10,000 samples hold one of four right matches with a probability of 12 %;
    neighbours tell."""
    s = make_scene(4000, noise=0.3, outliers=0.94, planar=True, seed=seed)
    fit = robust.estimate(s.x1, s.x2, seed=seed, model="homography")
    true = homography_from_pose(s.R, s.t, s.normal, s.distance, s.K1, s.K2)
    assert (
        float((transfer(fit.model, s.x1[-240:]) - transfer(true, s.x1[-240:])).norm(dim=-1).mean())
        < 0.3
    )


def test_right_matches_agree_with_their_neighbours():
    s = make_scene(2000, noise=0.3, outliers=0.8)
    d = disagreement(s.x1, s.x2, 1.0)
    wrong, right = d[:1600], d[1600:]
    assert float((right[:, None] < wrong).double().mean()) > 0.85  # 0.5 by chance
    torch.testing.assert_close(d, disagreement(s.x2, s.x1, 1.0))


def test_copies_do_not_count_as_evidence():
    s = make_scene(500, noise=0.3, outliers=0.8)
    plain = disagreement(s.x1, s.x2, 1.0)
    x1, x2 = (torch.cat((x, x[:1] + 0.1, x[:1] - 0.1)) for x in (s.x1, s.x2))
    assert float(disagreement(x1, x2, 1.0)[0]) >= float(plain[0])
    assert disagreement(s.x1[:2], s.x2[:2], 1.0).isinf().all()


def test_torch_weight_zero_is_as_good_as_absent():
    s = GENERAL
    w = torch.ones(800, dtype=torch.float64)
    w[:400] = 0
    fit = robust.estimate(s.x1, s.x2, s.K1, s.K2, weights=w)
    alone = robust.estimate(s.x1[400:], s.x2[400:], s.K1, s.K2)
    assert float(same_up_to_sign(fit.model, alone.model)) < 1e-6
    assert fit.score == pytest.approx(alone.score, rel=1e-6)


def test_torch_takes_float32_and_permuted_matches():
    s = GENERAL
    order = torch.randperm(800, generator=torch.Generator().manual_seed(1))
    a = robust.estimate(s.x1.float(), s.x2.float(), s.K1.float(), s.K2.float())
    b = robust.estimate(s.x1[order], s.x2[order], s.K1, s.K2)
    assert pose_gap(a.model.double()) < 0.1
    assert float(same_up_to_sign(a.model.double(), b.model)) < 1e-4
    assert int((a.inliers[order] != b.inliers).sum()) <= 2


def test_swapping_the_images_transposes_the_model():
    s = GENERAL
    a = robust.estimate(s.x1, s.x2, s.K1, s.K2)
    b = robust.estimate(s.x2, s.x1, s.K2, s.K1)
    assert float(same_up_to_sign(a.model, b.model.mT)) < 1e-5


@pytest.mark.grad
def test_score_is_differentiable_in_the_weights_and_everything_else():
    s = make_scene(15, noise=0.4)
    E = essential_from_pose(s.R, s.t).requires_grad_()
    w = torch.linspace(0.2, 1, 15, dtype=torch.float64).requires_grad_()
    x1 = s.x1.clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda E, x1, w: essential_score(E, x1, s.x2, s.K1, s.K2, 3.0, w), (E, x1, w)
    )


@pytest.mark.cuda
def test_cuda_finds_the_same_pose():
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    s = GENERAL
    fit = robust.estimate(*(a.cuda() for a in (s.x1, s.x2, s.K1, s.K2)))
    assert fit.model.is_cuda
    assert pose_gap(fit.model.cpu()) < 0.1


def test_true_essential_matrix_scores_high():
    score = essential_score(TRUE_E, GENERAL.x1, GENERAL.x2, GENERAL.K1, GENERAL.K2, 1.0)
    assert 200 < float(score) < 420


def test_quick_score_follows_the_marginal_score():
    v = torch.linspace(0, 1.5, 301)[:, None]
    assert (
        float((quick_scores(v, None) - marginal_score(v.double(), 1.0)[:, 0]).abs().max()) < 0.012
    )
    assert torch.allclose(quick_scores(v.T, torch.ones(301)), quick_scores(v.T, None))
