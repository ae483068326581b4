"""Cameras: stored distortion, checks and uncertainty."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from sfmkit.errors import CameraError
from sfmkit.types import Camera, IntrinsicsSigma

K = np.array([[500.0, 0.5, 320.0], [0, 510, 240], [0, 0, 1]])
SIZE = (640, 480)


@pytest.mark.parametrize(
    ("given", "stored"),
    [(0, 5), (1, 5), (4, 5), (5, 5), (8, 8), (12, 12), (14, 14)],
)
def test_opencv_distortion_is_stored_in_the_shortest_length_of_opencv(given, stored):
    d = np.arange(1, given + 1) / 100
    camera = Camera(K, SIZE, d)
    assert camera.distortion.shape == (stored,)
    np.testing.assert_array_equal(camera.distortion[:given], d)
    assert not camera.distortion[given:].any()
    padded = Camera(K, SIZE, np.pad(d, (0, 14 - given)))
    np.testing.assert_array_equal(padded.distortion, camera.distortion)


def test_a_fisheye_is_never_an_ideal_pinhole():
    camera = Camera(K, SIZE, np.zeros(4), model="fisheye")
    assert camera.has_distortion
    assert not Camera(K, SIZE).has_distortion
    assert camera.tensors()[1].shape == (4,)
    assert Camera(K, SIZE).tensors()[1] is None


@pytest.mark.parametrize(
    ("distortion", "model", "message"),
    [
        (np.zeros(6), "opencv", "up to 5, or 8"),
        (np.zeros(15), "opencv", "up to 5, or 8"),
        ([np.nan], "opencv", "up to 5, or 8"),
        (np.zeros((2, 5)), "opencv", "up to 5, or 8"),
        ([0.1, 0.2], "fisheye", "four finite"),
        ([0.1, 0.2, 0.3, np.inf], "fisheye", "four finite"),
        ([0.1], "division", "'opencv' or 'fisheye'"),
    ],
)
def test_distortion_that_does_not_fit_the_model_is_refused(distortion, model, message):
    with pytest.raises(CameraError, match=message):
        Camera(K, SIZE, distortion, model=model)


def test_a_resized_camera_keeps_everything_but_the_pixels():
    sigma = IntrinsicsSigma(0.01, 4.0, 0.02)
    camera = Camera(K, SIZE, [0.1, 0, 0, 0], "exif: x", "fisheye", sigma)
    half = camera.scaled((320, 240))
    assert (half.model, half.source) == ("fisheye", "exif: x")
    np.testing.assert_array_equal(half.distortion, camera.distortion)
    assert half.sigma == IntrinsicsSigma(0.01, 2.0, 0.02)
    assert half.K[0, 2] == (320 + 0.5) / 2 - 0.5
    assert Camera(K, SIZE).scaled((320, 240)).sigma is None


def test_uncertainty_follows_the_source_unless_it_is_given():
    by_source = [
        Camera(K, SIZE, source=s).uncertainty
        for s in ("given", "exif: focal plane resolution", "exif: 26 mm equivalent", "guessed")
    ]
    assert [u.focal for u in by_source] == sorted({u.focal for u in by_source})
    assert by_source[0].principal_point < by_source[1].principal_point
    sigma = IntrinsicsSigma(0.02, 3.0, 0.0)
    assert Camera(K, SIZE, source="guessed", sigma=sigma).uncertainty == sigma
    with pytest.raises(CameraError, match="focal must be non-negative"):
        IntrinsicsSigma(-0.1, 1.0, 0.1)


def test_copies_are_read_only():
    camera = Camera(K, SIZE, [0.1, 0, 0, 0], model="fisheye")
    for other in (pickle.loads(pickle.dumps(camera)), copy.copy(camera), copy.deepcopy(camera)):
        np.testing.assert_array_equal(other.K, camera.K)
        assert other.model == "fisheye"
        assert not other.K.flags.writeable
    assert replace(camera, source="guessed").model == "fisheye"
