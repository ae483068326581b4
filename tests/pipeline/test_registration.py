"""register(): homographies compared with known ones, and cases without a homography."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import sfmkit.pipeline.registration as registration
from sfmkit.errors import InputError
from sfmkit.estimation.planar import PlanarOptions, estimate_planar
from sfmkit.features import detect
from sfmkit.geometry.homography import squared_homography_sampson_distance, transfer
from sfmkit.geometry.homography_refinement import refine_homography
from sfmkit.matching.guided import match_guided
from sfmkit.metrics import corner_error
from sfmkit.options import PAPER
from sfmkit.pipeline.registration import register
from sfmkit.types import Correspondences, OperatorCounts, Verdict

H_TRUE = np.array([[0.8, 0.15, 12], [-0.1, 0.9, 20], [1e-4, -2e-4, 1.0]])


def textured(seed: int, size=(400, 320)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    layers = [
        cv2.resize(rng.uniform(0, 255, (size[1] // s, size[0] // s)), size) for s in (4, 9, 25)
    ]
    return np.clip(np.mean(layers, axis=0), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def images():
    first = textured(1)
    return first, cv2.warpPerspective(first, H_TRUE, (400, 320))


def correspondences(x1, x2, ratio, operator_id=None) -> Correspondences:
    n = len(x1)
    zero = torch.zeros(n, dtype=torch.int64)
    k = zero if operator_id is None else operator_id
    names = tuple("abc"[: int(k.max()) + 1])
    return Correspondences(
        x1,
        x2,
        ratio,
        ratio,
        k,
        1 << k,
        zero,
        zero,
        names,
        {o: OperatorCounts((n, n), n) for o in names},
    )


def a_few_among_many(right: int, wrong: int, seed=0, noise=0.7):
    """Return correct matches among wrong ones, with ratios as in real images."""
    g = torch.Generator().manual_seed(seed)
    size = torch.tensor([800.0, 640.0], dtype=torch.float64)
    x1 = torch.rand(right + wrong, 2, generator=g, dtype=torch.float64) * size
    x2 = torch.rand(right + wrong, 2, generator=g, dtype=torch.float64) * size
    x2[:right] = transfer(torch.from_numpy(H_TRUE), x1[:right])
    x2[:right] += noise * torch.randn(right, 2, generator=g, dtype=torch.float64)
    ratio = 1 - 0.3 * torch.rand(right + wrong, generator=g, dtype=torch.float64) ** 2
    ratio[: right // 2] = 0.5 + 0.4 * torch.rand(right // 2, generator=g, dtype=torch.float64)
    return correspondences(x1, x2, ratio)


def test_register_finds_a_known_homography(images):
    r = register(*images, operators=("orb", "fast-brief"))
    assert r.verdict is Verdict.PLANAR
    assert corner_error(r.H.numpy(), H_TRUE, (400, 320)) < 0.3
    assert len(r.inliers) == len(r.correspondences)
    assert int(r.inliers.sum()) > 300
    assert r.account["multi"].inliers == int(r.inliers.sum())
    again = register(*images, operators=("orb", "fast-brief"))
    assert torch.equal(r.H, again.H), "the same seed gives the same bits"
    assert set(r.timings_s) == {"read", "detect", "match", "fuse", "estimate", "total"}


def test_paper_options_are_plain_ransac_on_all_matches(images):
    r = register(*images, operators=("orb",), options=PAPER)
    assert r.guided is None
    assert corner_error(r.H.numpy(), H_TRUE, (400, 320)) < 3


def test_different_scenes_are_too_little_evidence():
    r = register(textured(1), textured(2), operators=("orb", "fast-brief"))
    assert r.H is None
    assert r.verdict is Verdict.TOO_LITTLE
    assert not r.inliers.any()
    assert "chance" in r.reason
    blank = register(np.full((100, 120), 90, np.uint8), textured(2), operators=("orb",))
    assert blank.H is None
    assert blank.warnings


@pytest.mark.parametrize("seed", range(3))
def test_three_percent_of_correct_matches_suffice(seed):
    corr = a_few_among_many(150, 5000, seed)
    fit = estimate_planar(corr, seed=seed)
    assert fit.H is not None
    assert corner_error(fit.H.numpy(), H_TRUE, (800, 640)) < 2
    assert fit.inliers[:150].double().mean() > 0.95
    assert fit.inliers[150:].double().mean() < 0.01


@pytest.mark.parametrize("seed", range(5))
def test_chance_alone_gives_no_homography(seed):
    fit = estimate_planar(a_few_among_many(0, 2000, seed), seed=seed)
    assert fit.H is None
    assert fit.evidence["log10_false_alarms"] > -6


def test_a_cluster_of_matches_is_not_evidence_of_a_homography():
    """Fifty matches of one detail agree on many homographies and are evidence of none."""
    corr = a_few_among_many(0, 1000)
    x1, x2 = corr.x1.clone(), corr.x2.clone()
    x1[:50] = torch.tensor([300.0, 200.0]) + torch.rand(50, 2, dtype=torch.float64)
    x2[:50] = torch.tensor([100.0, 400.0]) + torch.rand(50, 2, dtype=torch.float64)
    ratio = corr.ratio.clone()
    ratio[:50] = 0.3
    assert estimate_planar(correspondences(x1, x2, ratio)).H is None


def test_few_matches_and_bad_options():
    assert estimate_planar(a_few_among_many(5, 0)).H is None
    with pytest.raises(InputError):
        PlanarOptions(threshold_px=0)
    with pytest.raises(InputError):
        PlanarOptions(method="magic")


def test_refinement_is_least_squares_for_small_noise():
    """Compare with OpenCV's least-squares solution from a perturbed start.

    Far below the threshold, the loss is almost quadratic.
    """
    corr = a_few_among_many(400, 0, noise=0.05)
    T = torch.from_numpy(H_TRUE.copy())
    start = T + torch.tensor([[1e-3, 0, 0.5], [0, -1e-3, 0.5], [1e-6, 0, 0]], dtype=torch.float64)
    H = refine_homography(start, corr.x1, corr.x2, threshold_px=5.0)
    reference, _ = cv2.findHomography(corr.x1.numpy(), corr.x2.numpy(), 0)
    assert corner_error(H.numpy(), reference, (800, 640)) < 0.01
    assert (
        squared_homography_sampson_distance(H, corr.x1, corr.x2).mean()
        <= squared_homography_sampson_distance(T, corr.x1, corr.x2).mean()
    )
    assert torch.allclose(refine_homography(3 * T, corr.x1[:5], corr.x2[:5]), T), (
        "too few: as given, scaled"
    )


def test_the_weights_determine_which_matches_are_fitted():
    corr = a_few_among_many(200, 0, noise=0.0)
    x2 = corr.x2.clone()
    x2[100:] += 1.0
    weights = torch.ones(200, dtype=torch.float64)
    weights[100:] = 0
    H = refine_homography(torch.from_numpy(H_TRUE.copy()), corr.x1, x2, weights)
    assert corner_error(H.numpy(), H_TRUE, (800, 640)) < 1e-6
    weights[:100], weights[100:] = 0, 1
    H = refine_homography(torch.from_numpy(H_TRUE.copy()), corr.x1, x2, weights)
    assert (
        corner_error(H.numpy(), np.array([[1, 0, 1], [0, 1, 1], [0, 0, 1]]) @ H_TRUE, (800, 640))
        < 1e-6
    )


def test_guided_matches_are_near_their_predicted_positions_and_mutual(images):
    f1, f2 = (detect(image, "orb") for image in images)
    m = match_guided(f1, f2, H_TRUE, radius_px=3.0, max_distance=64)
    predicted = transfer(
        torch.from_numpy(H_TRUE), torch.from_numpy(f1.keypoints[m.index1].astype(float))
    ).numpy()
    assert len(m) > 500
    assert np.linalg.norm(predicted - f2.keypoints[m.index2], axis=1).max() <= 3.0
    assert len(set(m.index1)) == len(set(m.index2)) == len(m)
    assert m.distance.max() <= 64
    assert np.isnan(m.ratio).all()
    bits = np.unpackbits(f1.descriptors[m.index1] ^ f2.descriptors[m.index2], axis=1).sum(1)
    np.testing.assert_array_equal(m.distance, bits)
    with pytest.raises(InputError):
        match_guided(f1, f2, np.zeros((3, 3)))
    with pytest.raises(InputError):
        match_guided(f1, f2, H_TRUE, radius_px=0)


def test_guided_matching_finds_more_matches_of_a_weak_operator(images, monkeypatch):
    """Compare with the nearest neighbours over the whole image.

    More features agree after the two rounds of guided matching.
    """
    r = register(*images, operators=("orb",))
    assert len(r.guided) > int(r.inliers.sum()) * 0.9
    monkeypatch.setattr(registration, "_LEAST_INLIERS", 10**9)
    assert register(*images, operators=("orb",)).guided is None


@pytest.mark.data
def test_real_pair(data_dir):
    folder = data_dir / "oxford/bark"
    H = np.loadtxt(folder / "H1to6p")
    r = register(folder / "img1.png", folder / "img6.png", operators=("surf", "fast-brief"))
    assert corner_error(r.H.numpy(), H, (765, 512)) < 5
    assert r.account["fast-brief"].inliers < 0.05 * r.account["fast-brief"].initial, (
        "no rotation, yet it did no harm"
    )


def test_a_photograph_and_its_copy_shifted_by_whole_pixels_agree_exactly():
    # Most descriptors are equal to the last bit: distances of 0 must not become NaN
    # weights.
    whole = textured(2)
    result = register(whole[:300, :380], whole[10:310, 15:395], ("akaze",))
    assert result.H is not None
    shift = np.array([[1.0, 0, -15], [0, 1, -10], [0, 0, 1]])
    assert corner_error(result.H.numpy(), shift, (380, 300)) < 0.05
