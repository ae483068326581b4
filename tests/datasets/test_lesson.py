"""The pair of the notebooks is posed and scaled consistently, with and without the real
photographs."""

from __future__ import annotations

import numpy as np
import pytest

from sfmkit.datasets.lesson import lesson_hard_pair, lesson_pair, lesson_planes
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.errors import InputError
from sfmkit.pipeline.reconstruction import reconstruct


def test_without_data_it_is_the_bundled_pair_and_its_pose_is_found(monkeypatch, tmp_path):
    monkeypatch.delenv("SFMKIT_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    pair = lesson_pair(640)
    assert demo_pair()[0].exists()
    assert pair.dataset == "synthetic"
    assert pair.image1.shape == pair.image2.shape == (480, 640, 3)
    assert pair.camera1.size_wh == (640, 480)
    result = reconstruct(pair.image1, pair.image2, pair.camera1, ("orb",), truth=(pair.R, pair.t))
    assert max(result.errors.values()) < 1.0


def test_the_real_pair_where_it_is(data_dir, monkeypatch):
    monkeypatch.setenv("SFMKIT_DATA", str(data_dir))
    pair = lesson_pair(768)
    assert pair.dataset == "strecha"
    assert max(pair.image1.shape) == 768 == max(pair.camera1.size_wh)
    assert np.isclose(np.linalg.det(pair.R), 1, atol=1e-6)


def test_rendered_planes_without_data(monkeypatch, tmp_path):
    monkeypatch.delenv("SFMKIT_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    (pair,) = lesson_planes("light", 1, size_wh=(160, 128))
    assert pair.dataset == "planes"
    assert pair.image2.shape == (128, 160, 3)
    assert pair.image2.mean() < 0.8 * pair.image1.mean()
    with pytest.raises(InputError, match="viewpoint, zoom_rotation"):
        lesson_planes("weather")


def test_real_planes_where_they_are(data_dir, monkeypatch):
    monkeypatch.setenv("SFMKIT_DATA", str(data_dir))
    pairs = lesson_planes("blur", 2)
    assert [str(p) for p in pairs] == ["oxford/bikes 1-2", "oxford/bikes 1-3"]
    assert pairs[0].image1.ndim == 3


def test_the_hard_pair_is_rendered_without_data(monkeypatch, tmp_path):
    monkeypatch.delenv("SFMKIT_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    pair = lesson_hard_pair((48, 36))
    assert pair.dataset == "synthetic"
    assert pair.image1.shape == pair.image2.shape == (36, 48, 3)
    between_the_optical_axes = np.rad2deg(np.arccos(pair.R[2, 2]))
    assert between_the_optical_axes > 50


def test_the_real_hard_pair_where_it_is(data_dir, monkeypatch):
    monkeypatch.setenv("SFMKIT_DATA", str(data_dir))
    pair = lesson_hard_pair()
    assert pair.name == "templeSR0003-templeSR0002"
    assert pair.camera2.size_wh == (pair.image2.shape[1], pair.image2.shape[0])
    between_the_optical_axes = np.rad2deg(np.arccos(pair.R[2, 2]))
    assert 50 < between_the_optical_axes < 56
