"""Simulated viewpoints: positions, and a strong tilt that plain SIFT cannot match."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from sfmkit.errors import InputError, OperatorError
from sfmkit.features import detect
from sfmkit.features.affine import tilted, views
from sfmkit.matching.nearest import match
from sfmkit.metrics import match_errors


def textured(seed: int, size=(400, 320)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    layers = [
        cv2.resize(rng.uniform(0, 255, (size[1] // s, size[0] // s)), size) for s in (4, 9, 25)
    ]
    return np.clip(np.mean(layers, axis=0), 0, 255).astype(np.uint8)


def test_views_and_their_maps():
    assert [len(list(views(k))) for k in range(3)] == [1, 5, 10]
    grey = textured(0)
    for t, phi in views(2):
        image, A, mask = tilted(grey, t, phi)
        assert np.linalg.det(A[:, :2]) == pytest.approx(1 / t)
        centre = A @ [199.5, 159.5, 1]
        np.testing.assert_allclose(centre, (np.array(image.shape[::-1]) - 1) / 2, atol=1)
        assert mask[tuple(np.rint(centre).astype(int)[::-1])] == 255
        assert mask.mean() / 255 == pytest.approx(400 * 320 / t / image.size, abs=0.03)


def test_the_position_of_a_blob_is_correct_in_every_view():
    grey = np.full((200, 240), 60, np.uint8)
    cv2.circle(grey, (130, 90), 9, 220, -1, cv2.LINE_AA)
    grey = cv2.GaussianBlur(grey, (0, 0), 1.5)
    f = detect(grey, "affine-sift", contrastThreshold=0.03)
    near = np.linalg.norm(f.keypoints - (130, 90), axis=1)
    assert (near < 1.0).sum() >= 8, "found in nearly all of the ten views"
    assert f.operator == "affine-sift"
    assert f.size_wh == (240, 200)


def test_a_strong_tilt_is_matched():
    first = textured(3, (240, 200))
    H = np.array([[0.30, 0.05, 80], [-0.05, 0.9, 12], [0, 0, 1.0]])  # a view about 70 degrees off
    second = cv2.warpPerspective(
        cv2.GaussianBlur(first, (0, 0), sigmaX=2.5, sigmaY=0.01), H, (240, 200)
    )
    right = {}
    for name in ("sift", "affine-sift"):
        f1, f2 = (detect(image, name, contrastThreshold=0.02) for image in (first, second))
        m = match(f1, f2, max_ratio=0.85)
        right[name] = int((match_errors(f1, f2, m, H) < 3).sum())
    assert right["affine-sift"] > 5 * max(right["sift"], 4)


def test_options_mask_and_budget():
    grey = textured(1)
    mask = np.zeros_like(grey)
    mask[:, :200] = 1
    f = detect(grey, "affine-orb", mask=mask, budget=100, tilts=1, nfeatures=500)
    assert len(f) == 100
    assert f.keypoints[:, 0].max() < 200.5
    assert len(detect(np.full((80, 90), 7, np.uint8), "affine-orb")) == 0
    with pytest.raises(InputError, match="tilts"):
        detect(grey, "affine-orb", tilts=7)
    with pytest.raises(OperatorError):
        detect(grey, "affine-none")
