"""Unknown focal lengths: known scenes, calibrated deviations, and where nothing determines them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from sfmkit.estimation.focal import estimate_focal, estimate_with_focal, unknown_focal
from sfmkit.geometry.lie import so3_exp
from sfmkit.geometry.reprojection import project
from sfmkit.io.cameras import centred_camera
from sfmkit.options import EstimateOptions
from sfmkit.types import Camera, Correspondences, IntrinsicsSigma, OperatorCounts, Verdict

SIZE, FOCAL = (1000, 750), 900.0
EXACT_POINT = IntrinsicsSigma(0.3, 0.0, 0.1)


def guessed(focal: float = 1200.0, sigma: IntrinsicsSigma = EXACT_POINT) -> Camera:
    camera = centred_camera(focal, SIZE, "guessed")
    return Camera(camera.K, SIZE, source="guessed", sigma=sigma)


def correspondences(x1: torch.Tensor, x2: torch.Tensor) -> Correspondences:
    n = len(x1)
    row, ones = torch.arange(n), torch.ones(n, dtype=torch.int64)
    nan = torch.full((n,), torch.nan, dtype=torch.float64)
    counts = {"made": OperatorCounts((n, n), n)}
    return Correspondences(x1, x2, nan, nan, 0 * ones, ones, row, row, ("made",), counts)


def photograph(
    seed: int = 0,
    *,
    n: int = 600,
    noise: float = 0.3,
    wrong: float = 0.2,
    focals: tuple[float, float] = (FOCAL, FOCAL),
    turn: tuple[float, float, float] = (0.1, -0.25, 0.2),
    t: tuple[float, float, float] = (1.0, 0.3, -0.4),
    surface: str = "cloud",
    k1: float = 0.0,
) -> Correspondences:
    """Matches at depths of 4 to 9 baselines that fill image 1: a cloud, a wave or a plane."""
    g = torch.Generator().manual_seed(seed)
    uniform = torch.rand(n, 3, generator=g, dtype=torch.float64)
    rays = (uniform[:, :2] - 0.5) * torch.tensor([0.9, 0.7]) * 1000 / focals[0]
    depth = {
        "cloud": 4 + 5 * uniform[:, 2:],
        "wave": 6.5 + 2.5 * (9 * rays[:, :1]).sin() * (7 * rays[:, 1:]).cos(),
        "plane": 6 / (1 - 0.3 * rays[:, :1]),
    }[surface]
    X = torch.cat((rays, torch.ones(n, 1)), 1).double() * depth
    R, t = so3_exp(torch.tensor(turn, dtype=torch.float64)), torch.tensor(t, dtype=torch.float64)
    images = []
    for Y, f in ((X, focals[0]), (X @ R.mT + t, focals[1])):
        K = torch.tensor(centred_camera(f, SIZE, "given").K)
        y = Y[:, :2] / Y[:, 2:]
        y = torch.cat((y * (1 + k1 * y.square().sum(1, keepdim=True)), torch.ones(n, 1)), 1)
        images.append(project(y.double(), K) + noise * torch.randn(n, 2, generator=g).double())
    bad = int(wrong * n)
    images[1][:bad] = torch.rand(bad, 2, generator=g).double() * torch.tensor(SIZE)
    return correspondences(*images)


def test_which_focal_lengths_are_unknown():
    known, exif = Camera(guessed().K, SIZE), centred_camera(1000, SIZE, "exif: 26 mm equivalent")
    doubtful = Camera(exif.K, SIZE, source=exif.source, sigma=IntrinsicsSigma(0.2, 10, 0.1))
    turned = centred_camera(1200, SIZE[::-1], "guessed")
    assert unknown_focal(known, known) is None
    assert estimate_focal(photograph(), known, known) is None
    assert unknown_focal(guessed(), known) == "first"
    assert unknown_focal(known, exif) is None
    assert unknown_focal(known, doubtful) == "second"
    assert unknown_focal(guessed(), turned) == "shared"
    assert unknown_focal(guessed(), guessed(1000)) == "separate"


@pytest.mark.parametrize("prior", [600.0, 1800.0])
def test_the_focal_length_is_found_from_any_prior(prior):
    found = estimate_focal(photograph(), guessed(prior), guessed(prior))
    camera = found.cameras[0]
    assert found.determined
    assert found.focal == "shared"
    assert camera.source == "estimated, from guessed"
    assert abs(math.log(camera.K[0, 0] / FOCAL)) < min(3 * camera.uncertainty.focal, 0.05)
    assert np.array_equal(camera.K, found.cameras[1].K)


@pytest.mark.parametrize(
    "focals, unknown", [((FOCAL, 1100.0), "second"), ((1100.0, FOCAL), "first")]
)
def test_one_unknown_focal_length_is_more_certain_than_two(focals, unknown):
    corr = photograph(focals=focals)
    known = [Camera(centred_camera(f, SIZE, "given").K, SIZE) for f in focals]
    pair = [guessed(1500.0) if (k == 1) == (unknown == "second") else known[k] for k in range(2)]
    one = estimate_focal(corr, *pair)
    two = estimate_focal(corr, guessed(1500.0), guessed(1300.0))
    assert (one.focal, two.focal) == (unknown, "separate")
    assert one.determined
    k = ("first", "second").index(unknown)
    camera = one.cameras[k]
    assert abs(math.log(camera.K[0, 0] / focals[k])) < min(3 * camera.uncertainty.focal, 0.05)
    assert one.cameras[1 - k] is pair[1 - k]
    assert one.sigma < two.sigma


def test_standard_deviations_are_those_of_the_errors():
    """The squared normalised errors of 6 scenes add up to chi-square, 1.2 to 14.4 (95 %)."""
    options = EstimateOptions(max_iterations=300)
    squares = []
    for seed in range(6):
        corr = photograph(seed, n=400, noise=0.5, wrong=0.1)
        camera = estimate_focal(corr, guessed(), guessed(), options).cameras[0]
        squares.append((math.log(camera.K[0, 0] / FOCAL) / camera.uncertainty.focal) ** 2)
    assert 0.8 < sum(squares) < 18


def test_distortion_is_estimated_with_the_focal_length():
    found = estimate_focal(photograph(n=2000, k1=-0.05), guessed(), guessed())
    camera = found.cameras[0]
    assert camera.distortion[0] == pytest.approx(-0.05, abs=0.01)
    assert camera.K[0, 0] == pytest.approx(FOCAL, rel=0.02)


@pytest.mark.parametrize(
    "scene",
    [
        {"turn": (0.0, 0.0, 0.0), "t": (1.0, 0.2, 0.0)},
        # the axes meet at the distance 3.5 from both cameras
        {"turn": (0.0, 0.3, 0.0), "t": (-3.5 * math.sin(0.3), 0.0, 3.5 * (1 - math.cos(0.3)))},
    ],
    ids=["parallel axes", "axes that meet"],
)
def test_what_is_not_determined_stays(scene):
    prior = guessed()
    found = estimate_focal(photograph(noise=0.5, **scene), prior, prior)
    assert not found.determined
    assert found.cameras == (prior, prior)
    assert found.sigma > 0.3
    assert "do not determine the focal length" in found.reason


def test_a_plane_determines_no_focal_length():
    corr, prior = photograph(2, noise=0.5, surface="plane"), guessed()
    with pytest.warns(
        UserWarning, match="do not determine the focal length: the verdict is planar"
    ):
        view = estimate_with_focal(corr, prior, prior)
    assert view.verdict is Verdict.PLANAR
    assert view.camera1 is prior


def test_a_rotation_determines_the_focal_length():
    view = estimate_with_focal(photograph(t=(0.0, 0.0, 0.0), surface="wave"), guessed(), guessed())
    assert view.verdict is Verdict.PURE_ROTATION
    assert view.camera1.K[0, 0] == pytest.approx(FOCAL, rel=0.01)


def test_the_option_keeps_the_cameras():
    corr, prior = photograph(surface="wave"), guessed()
    view = estimate_with_focal(corr, prior, prior, EstimateOptions(focal="fixed"))
    assert view.camera1 is prior
    estimated = estimate_with_focal(corr, prior, prior)
    assert estimated.camera1.source.startswith("estimated")
    assert int(estimated.inliers.sum()) > int(view.inliers.sum())


def test_few_matches_and_noise_are_undetermined():
    few = photograph(n=12)
    assert "too few" in estimate_focal(few, guessed(), guessed()).reason
    noise = torch.rand(60, 4, generator=torch.Generator().manual_seed(0)).double() * 700
    assert not estimate_focal(
        correspondences(noise[:, :2], noise[:, 2:]), guessed(), guessed()
    ).determined
