"""Even selection compared with its definition and with the strongest keypoints."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfmkit.errors import InputError
from sfmkit.features import select_evenly
from sfmkit.features.selection import suppression_radii

SIZE = (800, 600)


def radii_by_definition(points: np.ndarray, scores: np.ndarray, robustness: float) -> np.ndarray:
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    clear = scores[:, None] < robustness * scores[None]
    if robustness == 1:
        earlier = np.arange(len(points))[None] < np.arange(len(points))[:, None]
        clear |= (scores[:, None] == scores[None]) & earlier
    return np.where(clear, distance, np.inf).min(axis=1)


@settings(max_examples=80, deadline=None)
@given(
    n=st.integers(1, 120),
    levels=st.sampled_from([1, 3, 10**6]),
    grid=st.sampled_from([4, 50, 10**6]),
    robustness=st.sampled_from([1, 0.9, 0.5]),
    seed=st.integers(0, 99),
)
def test_radii_are_the_distance_to_the_nearest_clearly_stronger_one(
    n, levels, grid, robustness, seed
):
    """The keypoints have ties in strength (few levels) and position (a coarse grid)."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, grid, (n, 2)) * (600.0 / grid)
    scores = rng.integers(0, levels, n).astype(float)
    expected = radii_by_definition(points, scores, robustness)
    np.testing.assert_allclose(suppression_radii(points, scores, robustness), expected, rtol=1e-12)


@pytest.mark.parametrize("score", [0.0, 1.0, -3.0])
def test_keypoints_of_equal_strength_are_spread_too(score):
    """A detector without a response (MSER) must not lose the rows that come last."""
    points = np.random.default_rng(0).uniform((0, 0), SIZE, (2000, 2))
    points = points[np.argsort(points[:, 0])]
    chosen = select_evenly(points, np.full(2000, score), 100, SIZE)
    assert np.histogram(points[chosen, 0], bins=4, range=(0, 800))[0].min() >= 15


def crowded(n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return strong keypoints in one corner and weaker ones everywhere."""
    rng = np.random.default_rng(0)
    corner = rng.uniform((0, 0), (150, 150), (n // 2, 2))
    rest = rng.uniform((0, 0), SIZE, (n // 2, 2))
    return np.concatenate([corner, rest]), np.concatenate(
        [rng.uniform(5, 9, n // 2), rng.uniform(1, 5, n // 2)]
    )


def coverage(points: np.ndarray) -> float:
    """Return the share of cells of 40 x 40 pixels that contain a point."""
    cells = (points // 40).astype(int)
    return len(np.unique(cells, axis=0)) / (20 * 15)


def test_the_selection_covers_more_of_the_image_than_the_strongest_keypoints():
    points, scores = crowded()
    even = select_evenly(points, scores, 300, SIZE)
    strongest = np.argsort(-scores)[:300]
    assert coverage(points[strongest]) < 0.1
    assert coverage(points[even]) > 0.5
    assert np.argmax(scores) in even
    away = (
        points[:, 0] > 200
    )  # for scores that are uniform between 1 and 5, strong keypoints are selected
    assert scores[even][away[even]].mean() > scores[away].mean() + 0.5


def test_the_selection_has_the_exact_number_is_ascending_and_reproducible():
    points, scores = crowded()
    chosen = select_evenly(points, scores, 777, SIZE)
    assert len(chosen) == len(set(chosen.tolist())) == 777
    assert (np.diff(chosen) > 0).all()
    np.testing.assert_array_equal(chosen, select_evenly(points, scores, 777, SIZE))
    np.testing.assert_array_equal(select_evenly(points, scores, 4000, SIZE), np.arange(4000))
    assert len(select_evenly(points[:0], scores[:0], 5, SIZE)) == 0


def test_selection_does_not_depend_on_the_order_of_the_input():
    points, scores = crowded(1000)
    shuffle = np.random.default_rng(1).permutation(1000)
    chosen = select_evenly(points, scores, 100, SIZE)
    np.testing.assert_array_equal(
        np.sort(shuffle[select_evenly(points[shuffle], scores[shuffle], 100, SIZE)]), chosen
    )


@pytest.mark.parametrize(
    "points, scores, budget, hint",
    [
        (np.zeros((3, 2)), np.zeros(3), 0, "budget"),
        (np.zeros((3, 2)), np.zeros(3), 1.5, "budget"),
        (np.zeros((3, 2)), np.zeros(2), 1, "expected"),
        (np.zeros((3, 3)), np.zeros(3), 1, "expected"),
        (np.full((3, 2), np.nan), np.zeros(3), 1, "finite"),
        (np.full((3, 2), 900.0), np.zeros(3), 1, "outside"),
    ],
)
def test_bad_input_is_rejected(points, scores, budget, hint):
    with pytest.raises(InputError, match=hint):
        select_evenly(points, scores, budget, SIZE)


@pytest.mark.parametrize("kind", ["random", "constant", "ramp"])
def test_the_time_does_not_depend_on_the_distribution_of_strengths(kind):
    """Measure 50,000 keypoints on a ramp.

    The selection takes a quarter of a second; a search through the neighbours takes 30 s.
    """
    rng = np.random.default_rng(0)
    points = rng.uniform((0, 0), (3072, 2048), (50_000, 2))
    scores = {"random": rng.random(50_000), "constant": np.ones(50_000), "ramp": points[:, 0]}[kind]
    start = time.process_time()
    assert len(select_evenly(points, scores, 5000, (3072, 2048))) == 5000
    assert time.process_time() - start < 1.5
