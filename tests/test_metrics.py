"""The measures against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sfmkit.errors import InputError
from sfmkit.metrics import (
    check_point_error,
    corner_error,
    error_auc,
    homography_rmse,
    match_errors,
    matching_score,
    mean_matching_accuracy,
    repeatability,
    trapezoidal_auc,
)
from sfmkit.types import Features, Matches

EYE = np.eye(3)


def shift(x: float, y: float) -> np.ndarray:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])


def features(xy, size=(100, 80)) -> Features:
    xy = np.asarray(xy, dtype=np.float32).reshape(-1, 2)
    one = np.ones(len(xy), np.float32)
    return Features(xy, one, 0 * one, one, np.zeros((len(xy), 4), np.float32), "l2", "toy", size)


def test_rmse_is_over_nine_elements_of_scaled_matrices():
    assert homography_rmse(7 * shift(3, 4), -2 * EYE) == pytest.approx(np.sqrt(25 / 9))
    assert homography_rmse(5 * EYE, EYE) == 0
    with pytest.raises(InputError):
        homography_rmse(np.diag([1, 1, 0]), EYE)
    with pytest.raises(InputError):
        homography_rmse(np.eye(2), EYE)


def test_corner_error_is_the_mean_over_four_corners():
    assert corner_error(shift(3, 4), EYE, (100, 80)) == pytest.approx(5)
    stretched = np.diag([1 + 1 / 99, 1, 1])  # the two right corners move by one pixel
    assert corner_error(stretched, EYE, (100, 80)) == pytest.approx(0.5)
    behind = np.array([[1, 0, 0], [0, 1, 0], [-0.02, 0, 1.0]])  # x > 50 lies behind
    assert corner_error(behind, EYE, (100, 80)) == np.inf


def test_auc_of_a_step_curve():
    assert error_auc([0.5, np.inf], (1.0, 5.0)) == pytest.approx([0.25, 0.45])
    assert error_auc([0.0], (1.0,)) == [1.0]
    with pytest.raises(InputError):
        error_auc([])
    with pytest.raises(InputError):
        error_auc([np.nan])


def test_trapezoidal_auc_is_the_integral_of_the_joined_points():
    # (0, 0), (2, 1/3), (4, 2/3), then constant
    assert trapezoidal_auc([4.0, 2.0, np.inf], (1, 3, 5)) == pytest.approx(
        [0, (1 / 3 + 1 / 3) / 3, (1 / 3 + 1 + 2 / 3) / 5]
    )
    errors = np.random.default_rng(0).exponential(4, 40)
    x = np.linspace(0, 10, 200_001)
    below = np.sort(errors[errors < 10])
    y = np.interp(x, [0, *below], np.arange(len(below) + 1) / 40)
    assert trapezoidal_auc(errors, [10]) == pytest.approx([y.mean()], abs=1e-4)
    assert trapezoidal_auc(errors, [10]) > error_auc(errors, [10])
    for wrong in ([], [np.nan], [-1.0]):
        with pytest.raises(InputError, match="errors"):
            trapezoidal_auc(wrong, [1])
    with pytest.raises(InputError, match="thresholds"):
        trapezoidal_auc([1.0], [0])


def test_repeatability_counts_each_keypoint_once_and_only_where_both_images_look():
    H = shift(10, 0)  # the last ten columns of image 1 leave image 2
    f1 = features([[5, 5], [50, 50], [70, 70], [95, 5]])
    f2 = features(
        [[15, 5], [60, 51], [61, 50], [2, 2]]
    )  # (2, 2) comes from outside image 1; two beside (60, 50)
    share, n = repeatability(f1, f2, H, 3.0)
    assert n == 2
    assert share == pytest.approx(
        2 / 3
    )  # three of image 1's and three of image 2's are in the common part
    assert repeatability(features([]), f2, H) == (0.0, 0)


def test_matching_measures():
    f1, f2 = features([[5, 5], [50, 50], [70, 70]]), features([[5, 5], [50, 52], [20, 20]])
    rows = np.arange(3)
    m = Matches(rows, rows, np.zeros(3, np.float32), np.zeros(3, np.float32))
    np.testing.assert_allclose(match_errors(f1, f2, m, EYE), [0, 2, np.hypot(50, 50)], rtol=1e-6)
    accuracy = mean_matching_accuracy(match_errors(f1, f2, m, EYE))
    np.testing.assert_allclose(accuracy, [1 / 3, *[2 / 3] * 9])
    assert matching_score(f1, f2, m, EYE) == pytest.approx(2 / 3)
    assert mean_matching_accuracy(np.zeros(0)) == [0.0] * 10


def test_check_point_error_is_the_mean_distance_of_the_points():
    H = np.array([[2.0, 0, 1], [0, 2, -1], [0, 0, 1]])
    points = np.array([[1.0, 1, 3, 1], [2, 3, 5, 9]])  # H maps to (3, 1) and (5, 5)
    assert check_point_error(H, points) == pytest.approx(2.0)
    assert check_point_error([[1, 0, 0], [0, 1, 0], [-1, 0, 1]], points) == np.inf
    for bad in (np.zeros((0, 4)), np.zeros((2, 3)), np.full((1, 4), np.nan)):
        with pytest.raises(InputError):
            check_point_error(H, bad)
