"""Figures: what they count, sample and name, and whether lines stand out from the photograph."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from made_up_result import make_result
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sfmkit.types import Features
from sfmkit.viz.figures import cloud_figure, feature_figure, match_figure, match_picture

RESULT = make_result()


def pixels(figure) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(int)


def labels(figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_the_counts_of_the_match_picture_are_those_of_the_account():
    figure = match_picture(RESULT)
    counts = {}
    for label in labels(figure):
        if found := re.fullmatch(r"(.+): ([\d,]+) inliers", label):
            counts[found[1]] = int(found[2].replace(",", ""))
    assert counts == {n: a.inliers for n, a in RESULT.account.items() if n != "multi"}
    outliers = int((~RESULT.two_view.inliers).sum())
    assert f"{outliers:,} outliers" in labels(figure)
    assert figure.axes[0].get_title().startswith(f"{RESULT.account['multi'].inliers} of ")


@pytest.mark.parametrize("level", [0, 128, 255])
@pytest.mark.parametrize("right", [True, False])
def test_lines_are_visible_on_a_photograph_of_any_brightness(level, right):
    ground = np.full((300, 400, 3), level, dtype=np.uint8)
    x1, x2 = np.array([[50.0, 60]]), np.array([[300.0, 200]])
    drawn = pixels(match_figure(ground, ground, x1, x2, np.array([right])))
    empty = pixels(match_figure(ground, ground, x1, x2, np.array([right]), most=0))
    differs = np.abs(drawn - empty).max(-1) > 100
    differs[: len(differs) // 8] = False  # the title
    assert differs.sum() > 300


def test_the_title_says_what_the_share_is_of():
    ground = np.zeros((30, 40, 3), dtype=np.uint8)
    x = np.zeros((4, 2))
    title = match_figure(ground, ground, x, x, np.array([1, 1, 1, 0], bool)).axes[0].get_title()
    assert title == "4 of 4 matches shown; 75% of all agree with the geometry"


def test_keypoints_are_sampled_over_the_whole_image():
    g = np.random.default_rng(0)
    n = 1000
    x = np.concatenate([g.normal(60, 4, (n, 2)), g.uniform(0, 300, (n, 2))]).astype(np.float32)
    one = np.ones(2 * n, dtype=np.float32)
    scores = np.repeat(np.float32([2, 1]), n)  # the strongest lie in one place
    f = Features(
        x, 9 * one, 0 * one, scores, np.zeros((2 * n, 4), np.uint8), "hamming", "orb", (300, 300)
    )
    figure = feature_figure(np.zeros((300, 300, 3), np.uint8), f, most=100)
    (circles,) = figure.axes[0].collections
    offsets = np.asarray(circles.get_offsets())
    assert len(offsets) == 100
    assert len({(bool(a), bool(b)) for a, b in offsets > 150}) == 4


def test_views_of_a_cloud_are_named_by_their_direction_and_have_units():
    for cloud, unit in ((RESULT.cloud, " (baselines)"), (replace(RESULT.cloud, operators=()), "")):
        axes = cloud_figure(cloud).axes
        assert [ax.get_xlabel() for ax in axes] == [f"x{unit}"] * 2
        assert all(ax.get_ylabel().endswith(unit) for ax in axes)
        assert not any("above" in ax.get_title() for ax in axes)
