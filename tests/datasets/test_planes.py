"""The painted planes: their homographies against pinhole cameras in space, and the pictures against
the homographies."""

from __future__ import annotations

from itertools import islice

import cv2
import numpy as np
import pytest

from sfmkit.datasets.planes import FOCAL, SEQUENCES, View, homography, photograph_plane, planes
from sfmkit.errors import InputError

SIZE = (200, 160)


def apply(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    y = np.column_stack([x, np.ones(len(x))]) @ H.T
    return y[:, :2] / y[:, 2:]


@pytest.mark.parametrize("name", SEQUENCES)
def test_homographies_carry_points_of_the_plane_between_cameras(name):
    rng = np.random.default_rng(0)
    X = np.column_stack([rng.uniform(-1, 1, (50, 2)), np.zeros(50)])
    f, centre = FOCAL * SIZE[0], (np.array(SIZE) - 1) / 2
    # view 1 looks at the origin squarely from 4.4 m
    x1 = f * X[:, :2] / 4.4 + centre
    for view in SEQUENCES[name][1]:
        turns = [
            cv2.Rodrigues(np.deg2rad(a) * np.eye(3)[k])[0]
            for k, a in ((2, view.roll), (1, view.yaw), (0, view.pitch))
        ]
        R = turns[0] @ turns[1] @ turns[2]
        X2 = (X - [*view.shift, 0]) @ R.T + [0, 0, 4.4 / view.zoom]
        x2 = f * X2[:, :2] / X2[:, 2:] + centre
        np.testing.assert_allclose(apply(homography(View(), view, SIZE), x1), x2, atol=1e-9)


@pytest.mark.parametrize("name", ["zoom_rotation", "viewpoint"])
def test_first_image_warped_is_the_other_image(name):
    material, views = SEQUENCES[name]
    one = photograph_plane(material, View(), size_wh=SIZE, noise=0)
    for view in views[1:3]:
        two = photograph_plane(material, view, size_wh=SIZE, noise=0)
        H = homography(View(), view, SIZE)
        # both made coarser, so that the difference in resolution does not matter
        blur = [
            cv2.GaussianBlur(a.astype(np.float32), (0, 0), s)
            for a, s in ((one, 2.5 / view.zoom), (two, 2.5))
        ]

        def difference(M, one=blur[0], two=blur[1]):
            warped = cv2.warpPerspective(one, M, SIZE, borderValue=(-1e4,) * 3)
            good = cv2.erode((warped.min(axis=2) >= 0).astype(np.uint8), np.ones((9, 9))) > 0
            return np.abs(warped - two)[good].mean()

        best = difference(H)
        for shift in (
            (1, 0),
            (-1, 0),
            (0, 1),
            (0, -1),
        ):  # a shift by one pixel in any direction is worse
            assert (
                difference(np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1.0]]) @ H)
                > 1.3 * best
            )


@pytest.mark.parametrize("name", SEQUENCES)
def test_the_change_grows(name):
    sift, size = cv2.SIFT_create(), (320, 256)
    material, views = SEQUENCES[name]

    def features(view, seed):
        k, d = sift.detectAndCompute(
            photograph_plane(material, view, size_wh=size, seed=seed), None
        )
        return np.array([p.pt for p in k]), d

    x1, d1 = features(View(), 0)
    counts = []
    for view in (views[0], views[-1]):
        x2, d2 = features(view, 1)
        i, j = np.array(
            [(m.queryIdx, m.trainIdx) for m in cv2.BFMatcher(crossCheck=True).match(d1, d2)]
        ).T
        counts.append(
            (np.linalg.norm(apply(homography(View(), view, size), x1[i]) - x2[j], axis=1) < 2).sum()
        )
    assert counts[0] > 150
    assert counts[0] > 1.8 * counts[1] > 0


def test_jpeg_sequence_does_not_move():
    for pair in planes(sequences=["jpeg"], size_wh=(48, 32)):
        np.testing.assert_allclose(pair.H, np.eye(3), atol=1e-12)


def test_same_seed_same_bits():
    a, b, c = (next(planes(sequences=["light"], size_wh=(48, 32), seed=s)) for s in (4, 4, 5))
    np.testing.assert_array_equal(a.image2, b.image2)
    assert (a.image2 != c.image2).any()


def test_pairs_come_one_by_one_and_are_named():
    names = [f"{p}" for p in islice(planes(sequences=["blur"], size_wh=(32, 32)), 2)]
    assert names == ["planes/blur 1-2", "planes/blur 1-3"]


def test_an_unknown_sequence_suggests_the_nearest_name():
    with pytest.raises(InputError, match="'viewpoint'"):
        next(planes(sequences=["viewpoints"]))


def test_a_size_that_is_none_is_refused():
    with pytest.raises(InputError, match="size_wh"):
        next(planes(sequences=["blur"], size_wh=(8, 100)))
