"""Features of shapes whose answer is known, and that they do not vary with the density alone."""

from __future__ import annotations

import numpy as np
import pytest

from sfmkit.clouds.density import count_neighbours
from sfmkit.clouds.local_shape import NEIGHBOURS, local_shape
from sfmkit.errors import InputError

RNG = np.random.default_rng(0)


def shape_at_origin(xyz: np.ndarray, radius: float = 1.0):
    """The features of the first point of (N, 3) points around it, the mean of 30 draws."""
    xyz = np.concatenate([np.zeros((1, 3)), xyz])
    counts = count_neighbours(xyz, radius)
    drawn = [local_shape(xyz, radius, counts, most=1, seed=k) for k in range(30)]
    return {name: np.mean([s.features()[name][0] for s in drawn]) for name in drawn[0].features()}


def disc(n=2000):
    xyz = np.zeros((4 * n, 3))
    xyz[:, :2] = RNG.uniform(-1, 1, (4 * n, 2))
    return xyz[np.linalg.norm(xyz, axis=1) < 0.999]


def test_line_plane_and_ball():
    line = np.zeros((500, 3))
    line[:, 0] = RNG.uniform(-1, 1, 500)
    f = shape_at_origin(line)
    assert f["linearity"] == pytest.approx(1)
    assert f["planarity"] == pytest.approx(0, abs=1e-9)
    f = shape_at_origin(disc())
    assert f["sphericity"] == pytest.approx(0, abs=1e-9)
    assert f["linearity"] + f["planarity"] == pytest.approx(1)
    assert f["planarity"] > 0.6
    ball = RNG.uniform(-1, 1, (8000, 3))
    f = shape_at_origin(ball)
    assert f["sphericity"] > 0.4
    assert f["surface_variation"] > 0.18


def test_crease_and_border():
    plain = disc()
    folded = plain.copy()
    folded[:, 2], folded[:, 0] = (
        np.abs(plain[:, 0]) / np.sqrt(2),
        plain[:, 0] / np.sqrt(2),
    )  # a right angle
    assert shape_at_origin(folded)["surface_variation"] > 0.05
    assert shape_at_origin(plain)["surface_variation"] < 1e-9
    half = plain[plain[:, 0] > 0]
    assert shape_at_origin(half)["border"] == pytest.approx(4 / (3 * np.pi), abs=0.04)
    assert shape_at_origin(plain)["border"] < 0.2  # the mean of 20 points is not the middle


def test_features_do_not_depend_on_the_density():
    """Noise on a plane, ten times denser on one side: the same shape on both."""
    xyz = np.concatenate([RNG.random((1000, 3)), RNG.random((10_000, 3)) + [3, 0, 0]])
    xyz[:, 2] = 0.02 * RNG.normal(size=len(xyz))
    counts = count_neighbours(xyz, 0.15)
    s = local_shape(xyz, 0.15, counts)
    dense = xyz[s.index, 0] > 2
    assert counts[dense].mean() > 8 * counts[~dense].mean()
    for name, values in s.features().items():
        few, many = (np.median(values[s.known & side]) for side in (~dense, dense))
        assert many == pytest.approx(few, rel=0.08), name


def test_lonely_points_and_copies_are_unknown():
    xyz = np.concatenate(
        [RNG.random((NEIGHBOURS - 1, 3)), [[50, 0, 0]] * 40, RNG.random((60, 3)) + 100]
    )
    s = local_shape(xyz, 3.0, count_neighbours(xyz, 3.0))
    assert s.known.tolist() == [False] * (NEIGHBOURS + 39) + [True] * 60


def test_a_large_cloud_is_judged_at_some_points_and_blocks_change_nothing(monkeypatch):
    xyz = RNG.random((5000, 3))
    counts = count_neighbours(xyz, 0.2)
    whole = local_shape(xyz, 0.2, counts)
    some = local_shape(xyz, 0.2, counts, most=1200)
    assert some.index.tolist() == list(range(0, 5000, 5))
    assert np.array_equal(some.linearity, whole.linearity[::5])
    monkeypatch.setattr("sfmkit.clouds.local_shape._PAIRS", 500)
    assert np.array_equal(local_shape(xyz, 0.2, counts).border, whole.border)


@pytest.mark.parametrize("radius", [0, -1, float("nan")])
def test_bad_radius(radius):
    with pytest.raises(InputError, match="radius"):
        local_shape(np.zeros((3, 3)), radius, np.ones(3, dtype=int))
