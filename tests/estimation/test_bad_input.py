"""What no estimate can be made of: a clear error, no model, or the verdict that the evidence is too
little."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up_scene import make_scene

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.estimation import ESTIMATOR_PLUGINS, estimate_two_view, peers
from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.essential import decompose_essential, essential_5point
from sfmkit.geometry.fundamental import (
    fundamental_7point,
    fundamental_8point,
    fundamental_from_pose,
    signed_sampson_distance,
)
from sfmkit.geometry.homography import homography_dlt, squared_homography_sampson_distance
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.geometry.refinement import refine_essential
from sfmkit.geometry.triangulation import triangulate
from sfmkit.geometry.uncertainty import covariance
from sfmkit.types import Camera, Correspondences, OperatorCounts, Verdict

S = make_scene(100, noise=0.3)
K = S.K1
SIZE = (640, 480)


def spoilt(value):
    x = S.x1.clone()
    x[3, 0] = value
    return x, S.x2


def copies(n):
    return S.x1[:n].repeat(100, 1)[:100], S.x2[:n].repeat(100, 1)[:100]


def on_a_line():
    s = torch.linspace(0, 1, 100, dtype=torch.float64)[:, None]
    return torch.cat((600 * s + 10, 400 * s + 20), 1), torch.cat((500 * s + 40, 380 * s + 30), 1)


WRONG = {
    "nan": spoilt(float("nan")),
    "infinite": spoilt(float("-inf")),
    "integers": (S.x1.long(), S.x2.long()),
    "half": (S.x1.half(), S.x2.half()),
    "two precisions": (S.x1, S.x2.float()),
    "different counts": (S.x1, S.x2[:50]),
    "different batches": (S.x1[None].repeat(2, 1, 1), S.x2[None].repeat(3, 1, 1)),
    "three columns": (
        torch.ones(100, 3, dtype=torch.float64),
        torch.ones(100, 3, dtype=torch.float64),
    ),
    "one point": (S.x1[0], S.x2[0]),
    "arrays": (S.x1.numpy(), S.x2.numpy()),
}
UNDETERMINED = {
    "none": (S.x1[:0], S.x2[:0]),
    "too few": (S.x1[:3], S.x2[:3]),
    "all equal": copies(1),
    "three, copied": copies(3),
    "on a line": on_a_line(),
    "on a line in one image": (on_a_line()[0], S.x2),
}
ENGINES = [
    "torch",
    "opencv",
    *(pytest.param(name, id=name, marks=pytest.mark.peers) for name in peers.PEERS),
]
FUNCTIONS = {
    "8 points": fundamental_8point,
    "7 points": lambda a, b: fundamental_7point(first(7, a), first(7, b)),
    "5 points": lambda a, b: essential_5point(first(5, a), first(5, b)),
    "homography": homography_dlt,
    "triangulation": lambda a, b: triangulate(a, b, S.R, S.t),
    "refinement": lambda a, b: refine_essential(S.R, S.t, a, b, K, K),
    "bundle": lambda a, b: bundle_adjust(a, b, K, K, S.R, S.t),
}


def first(k, x):
    """The first k of 100 matches, fewer of fewer, so that what is wrong with them stays wrong."""
    return x[..., : k * x.shape[-2] // 100, :] if isinstance(x, torch.Tensor) and x.ndim > 1 else x


def engine(which):
    if which in peers.PEERS:
        pytest.importorskip(which)
    return ESTIMATOR_PLUGINS[which]


def estimates(e, x1, x2, K1=K, K2=K):
    yield lambda: e(x1, x2, K1, K2)
    yield lambda: e(x1, x2, model="fundamental")
    yield lambda: e(x1, x2, model="homography")


@pytest.mark.parametrize("matches", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("which", ENGINES)
def test_estimators_reject_invalid_matches(which, matches):
    for estimate in estimates(engine(which), *matches):
        with pytest.raises(InputError, match=r"must|holds|give|move"):
            estimate()


@pytest.mark.parametrize("matches", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_reject_invalid_matches(name, matches):
    with pytest.raises(InputError, match=r"must|holds|give|move"):
        FUNCTIONS[name](*matches)


@pytest.mark.parametrize("matches", UNDETERMINED.values(), ids=UNDETERMINED)
@pytest.mark.parametrize("which", ENGINES)
def test_no_model_where_the_matches_determine_none(which, matches):
    for estimate in estimates(engine(which), *matches):
        fit = estimate()
        assert fit.model is None
        assert fit.score == 0
        assert fit.inliers.shape == (len(matches[0]),)
        assert not fit.inliers.any()


@pytest.mark.parametrize("matches", UNDETERMINED.values(), ids=UNDETERMINED)
def test_linear_solvers_say_that_the_matches_determine_nothing(matches):
    for solve in (fundamental_8point, homography_dlt):
        with pytest.raises(DegenerateGeometryError, match=r"too few|do not determine"):
            solve(*matches)


@pytest.mark.parametrize("name", ["all equal", "three, copied", "on a line"])
def test_the_covariance_says_what_refinement_cannot_know(name):
    """A minimum among a family of equals is finite, and its covariance is refused."""
    x1, x2 = UNDETERMINED[name]
    bundle = bundle_adjust(x1, x2, K, K, S.R, S.t)
    assert bool(bundle.R.isfinite().all() & bundle.t.isfinite().all())
    with pytest.raises(DegenerateGeometryError, match="do not determine the pose"):
        covariance(bundle)


@pytest.mark.parametrize(
    "broken",
    [torch.zeros(3, 3), torch.diag(torch.tensor([800.0, 0.0, 1.0])), torch.full((3, 3), torch.nan)],
)
@pytest.mark.parametrize("which", ENGINES)
def test_cameras_that_cannot_be(which, broken):
    broken = broken.double()
    with pytest.raises(InputError, match="K2"):
        engine(which)(S.x1, S.x2, K, broken)
    with pytest.raises(InputError, match="K2"):
        refine_essential(S.R, S.t, S.x1, S.x2, K, broken)
    with pytest.raises(InputError, match="K2"):
        bundle_adjust(S.x1, S.x2, K, broken, S.R, S.t)
    with pytest.raises(InputError):
        normalize(S.x1, broken)


@pytest.mark.parametrize("which", ENGINES)
def test_a_million_pixels_from_the_origin_nothing_changes(which):
    """As in a tile of a very large scan: the principal point moves along."""
    s = make_scene(300, noise=0.3, outliers=0.3)
    far = torch.tensor([1e6, -1e6], dtype=torch.float64)
    K1, K2 = s.K1.clone(), s.K2.clone()
    K2[0, 1] = 0
    K1[:2, 2] += far
    K2[:2, 2] -= far
    fit_E, fit_F, _ = (
        estimate() for estimate in estimates(engine(which), s.x1 + far, s.x2 - far, K1, K2)
    )
    R, t = decompose_essential(fit_E.model)
    assert float(torch.maximum(rotation_error(R, s.R), translation_error(t, s.t)).min()) < 0.7
    assert int(fit_E.inliers[90:].sum()) > 190
    assert int(fit_F.inliers[90:].sum()) > 190


@pytest.mark.parametrize("which", ENGINES)
def test_a_homography_a_million_pixels_from_the_origin(which):
    s = make_scene(300, noise=0.3, outliers=0.3, planar=True)
    far = torch.tensor([1e6, -1e6], dtype=torch.float64)
    fit = engine(which)(s.x1 + far, s.x2 - far, model="homography")
    assert int(fit.inliers[90:].sum()) > 190
    assert (
        float(
            squared_homography_sampson_distance(fit.model, s.x1 + far, s.x2 - far)[90:]
            .sqrt()
            .median()
        )
        < 0.5
    )


def test_linear_solvers_and_refinement_a_million_pixels_from_the_origin():
    far = torch.tensor([1e6, -1e6], dtype=torch.float64)
    K1, K2 = S.K1.clone(), S.K2.clone()
    K1[:2, 2] += far
    K2[:2, 2] -= far
    x1, x2 = S.x1 + far, S.x2 - far
    assert float(signed_sampson_distance(fundamental_8point(x1, x2), x1, x2).abs().median()) < 0.4
    near = refine_essential(S.R, S.t, S.x1, S.x2, S.K1, S.K2)
    for found in (
        refine_essential(S.R, S.t, x1, x2, K1, K2),
        bundle_adjust(x1, x2, K1, K2, S.R, S.t, loss="cauchy", loss_scale=0.5),
    ):
        assert float(rotation_error(found.R, near.R)) < 0.1
        assert float(translation_error(found.t, near.t)) < 0.3
        e = signed_sampson_distance(fundamental_from_pose(found.R, found.t, K1, K2), x1, x2)
        assert float(e.abs().median()) < 0.4


def correspondences(x1, x2):
    n = len(x1)
    zeros = torch.zeros(n, dtype=torch.int64)
    nan = torch.full((n,), float("nan"), dtype=torch.float64)
    return Correspondences(
        x1,
        x2,
        nan,
        nan,
        zeros,
        zeros + 1,
        torch.arange(n),
        torch.arange(n),
        ("known",),
        {"known": OperatorCounts((n, n), n)},
    )


@pytest.mark.parametrize(
    "matches", [*UNDETERMINED.values(), copies(6)], ids=[*UNDETERMINED, "six, copied"]
)
def test_the_verdict_is_too_little(matches):
    camera = Camera(K.numpy(), SIZE)
    view = estimate_two_view(correspondences(*matches), camera, camera)
    assert view.verdict is Verdict.TOO_LITTLE
    assert view.R is view.t is view.E is None
    assert not view.inliers.any()
    assert view.reason


def test_one_photograph_twice_is_a_rotation_by_nothing():
    camera = Camera(K.numpy(), SIZE)
    view = estimate_two_view(correspondences(S.x1, S.x1), camera, camera)
    assert view.verdict is Verdict.PURE_ROTATION
    assert view.t is None
    np.testing.assert_allclose(view.R, np.eye(3), atol=1e-9)


def test_nan_cannot_become_correspondences():
    with pytest.raises(InputError, match="finite"):
        correspondences(*WRONG["nan"])


@pytest.mark.cuda
def test_matches_on_two_devices():
    for estimate in estimates(ESTIMATOR_PLUGINS["torch"], S.x1, S.x2.cuda()):
        with pytest.raises(InputError, match="one device"):
            estimate()
