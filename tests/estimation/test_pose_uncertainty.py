"""Uncertainty of adjusted poses: its parts, the cameras' share, and what falls back."""

from __future__ import annotations

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.estimation.pose_uncertainty import CAMERAS, PIXELS, REGIONS, pose_uncertainty
from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.uncertainty import covariance, sigma_degrees
from sfmkit.types import Camera
from sfmkit.types.camera import IntrinsicsSigma

EXACT = IntrinsicsSigma(0.0, 0.0, 0.0)


def cameras(scene, sigma):
    return tuple(Camera(K.numpy(), (640, 480), sigma=sigma) for K in (scene.K1, scene.K2))


def adjusted(scene, sigma):
    bundle = bundle_adjust(scene.x1, scene.x2, scene.K1, scene.K2, scene.R, scene.t, loss="cauchy")
    independent = covariance(bundle)
    found = pose_uncertainty(
        bundle.R,
        bundle.t,
        scene.x1,
        scene.x2,
        cameras(scene, sigma),
        independent,
        loss="cauchy",
        loss_scale=1.0,
    )
    return independent, found


def test_exact_cameras_and_independent_noise_leave_what_the_pixels_say():
    independent, found = adjusted(make_scene(2000, noise=0.3), EXACT)
    assert found.parts_deg[CAMERAS] == (0, 0)
    for of_pixels, of_regions in zip(found.parts_deg[PIXELS], found.parts_deg[REGIONS]):
        assert 0.7 < of_regions / of_pixels < 1.5
    assert sigma_degrees(found.pose).tolist() == pytest.approx(found.parts_deg[REGIONS])
    before = independent.points.diagonal(dim1=1, dim2=2).sum(1)
    after = found.points.diagonal(dim1=1, dim2=2).sum(1)
    assert 0.6 < float((after / before).median()) < 1.6


def test_a_guessed_focal_length_dominates():
    scene = make_scene(500, noise=0.3)
    _, exact = adjusted(scene, EXACT)
    _, guessed = adjusted(scene, IntrinsicsSigma.of_source("guessed", (640, 480)))
    assert min(guessed.parts_deg[CAMERAS]) > 10 * max(exact.parts_deg[REGIONS])
    assert float(sigma_degrees(guessed.pose)[0]) > 1
    assert bool((torch.linalg.eigvalsh(guessed.points) > 0).all())


def test_matches_in_one_tile_fall_back_to_single_matches():
    scene = make_scene(300, noise=0.3)
    # tiles of 1,000 pixels
    big = tuple(Camera(K.numpy(), (12_000, 9_000), sigma=EXACT) for K in (scene.K1, scene.K2))
    bundle = bundle_adjust(scene.x1, scene.x2, scene.K1, scene.K2, scene.R, scene.t)
    independent = covariance(bundle)
    found = pose_uncertainty(
        bundle.R, bundle.t, scene.x1, scene.x2, big, independent, loss="squared", loss_scale=1.0
    )
    assert found.parts_deg[REGIONS] == found.parts_deg[PIXELS]
