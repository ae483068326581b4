"""Orientation of triangles between matches: real motions keep it, mirrors and chance do not."""

from __future__ import annotations

import math

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.estimation.handedness import Handedness, handedness


def surface(n: int, seed: int = 0):
    """Pixels of a smooth curved surface seen from two places, with half a pixel of noise."""
    g = torch.Generator().manual_seed(seed)
    xy = torch.rand(n, 2, generator=g, dtype=torch.float64) * 4 - 2
    X = torch.cat((xy, 6 + 0.3 * xy.square().sum(1, keepdim=True)), 1)
    s = make_scene(4)

    def seen(Y, K):
        y = Y @ K.T
        return y[:, :2] / y[:, 2:] + 0.5 * torch.randn(n, 2, generator=g, dtype=torch.float64)

    return seen(X, s.K1), seen(X @ s.R.T + s.t, s.K2)


def test_a_surface_seen_twice_keeps_its_triangles():
    found = handedness(*surface(500))
    assert found.kept > 800
    assert found.share_kept > 0.97
    assert not found.inconsistent


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_photograph_reverses_them(axis):
    x1, x2 = surface(500)
    x2 = x2.clone()
    x2[:, axis] = 640 - x2[:, axis]
    found = handedness(x1, x2)
    assert found.share_kept < 0.03
    assert found.mirrored


def test_a_turned_photograph_keeps_them():
    x1, x2 = surface(500)
    assert handedness(x1, 640 - x2).share_kept > 0.97  # half a turn


def test_unrelated_points_reverse_half():
    x1, x2 = surface(400)
    found = handedness(x1, x2[torch.randperm(400, generator=torch.Generator().manual_seed(1))])
    assert 0.4 < found.share_kept < 0.6
    assert found.inconsistent


def test_a_third_of_wrong_matches_does_not_condemn_a_pair():
    x1, x2 = surface(200)
    x2 = x2.clone()
    x2[:15] = x2[:15].flip(0)
    assert not handedness(x1, x2).inconsistent


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_points_say_nothing(n):
    x1, x2 = surface(10)
    found = handedness(x1[:n], x2[:n])
    assert found == Handedness(0, 0)
    assert math.isnan(found.share_kept)
    assert not found.inconsistent


def test_points_on_a_line_say_nothing():
    x = torch.arange(20, dtype=torch.float64)[:, None] * torch.tensor([10.0, 5.0])
    assert handedness(x, x) == Handedness(0, 0)
