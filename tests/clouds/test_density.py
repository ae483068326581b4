"""Neighbour counts against direct distances, scipy's lists and CloudCompare; bad input; memory."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from plyfile import PlyData, PlyElement
from scipy.spatial import KDTree

from sfmkit.clouds import density as module
from sfmkit.clouds.density import (
    automatic_radius,
    count_neighbours,
    default_classes,
    density,
    histogram,
)
from sfmkit.errors import InputError

# Quarters, so that distances and radii are exact and many fall on the very border; few values, so
# that points coincide.
QUARTERS = arrays(
    np.float64,
    st.tuples(st.integers(1, 60), st.just(3)),
    elements=st.integers(-6, 6).map(lambda k: k / 4),
)


@settings(deadline=None, max_examples=100)
@given(QUARTERS, st.integers(1, 12).map(lambda k: k / 4), st.integers(1, 25))
def test_equals_direct_distances_and_scipys_lists(xyz, radius, block):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BLOCK", block)
        counts = count_neighbours(xyz, radius)
    squared = ((xyz[:, None] - xyz) ** 2).sum(-1)
    assert np.array_equal(counts, (squared <= radius**2).sum(1))
    assert counts.tolist() == [len(some) for some in KDTree(xyz).query_ball_point(xyz, radius)]


def test_equals_scipys_ball_query_on_a_large_cloud():
    rng = np.random.default_rng(0)
    xyz = np.concatenate(
        [rng.normal(size=(20_000, 3)), 0.01 * rng.normal(size=(2000, 3)), np.ones((50, 3))]
    )
    lists = KDTree(xyz).query_ball_point(xyz, 0.08)
    assert np.array_equal(count_neighbours(xyz, 0.08), np.array([len(some) for some in lists]))


def test_the_point_itself_and_the_border_are_counted():
    assert count_neighbours(np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2.5]]), 1.0).tolist() == [
        2,
        2,
        1,
    ]


def test_densities():
    grid = np.stack(np.meshgrid(*[np.arange(-2.0, 3)] * 3), -1).reshape(-1, 3)
    d = density(grid, 1.0)
    centre = np.flatnonzero(~grid.any(1))[0]
    assert d.neighbours[centre] == 7
    assert d.surface[centre] == pytest.approx(7 / pi)
    assert d.volume[centre] == pytest.approx(7 / (4 / 3 * pi))


@pytest.mark.parametrize("copies", [1, 2, 300])
def test_automatic_radius_is_ten_spacings_whatever_the_copies(copies):
    grid = np.stack(np.meshgrid(*[0.5 * np.arange(6)] * 3), -1).reshape(-1, 3)
    assert automatic_radius(np.repeat(grid, copies, axis=0)) == pytest.approx(5.0)


@pytest.mark.parametrize("radius", [0, -1, float("nan"), float("inf")])
def test_radius_must_be_a_positive_number(radius):
    with pytest.raises(InputError, match="radius must be a positive number"):
        count_neighbours(np.zeros((3, 3)), radius)


@pytest.mark.parametrize(
    "xyz,message",
    [
        (np.zeros((0, 3)), "no points"),
        (np.zeros((4, 2)), "shape"),
        (np.array([[0, 0, np.nan]]), "NaN"),
        (np.zeros((1, 3)), "one place"),
        (np.zeros((500, 3)), "one place"),
    ],
)
def test_unusable_points(xyz, message):
    with pytest.raises(InputError, match=message):
        density(xyz)


def test_one_point_and_copies_with_a_radius():
    assert count_neighbours(np.zeros((1, 3)), 2.0).tolist() == [1]
    assert count_neighbours(np.zeros((500, 3)), 2.0).tolist() == [500] * 500


def test_exploding_radius_is_refused_at_once():
    xyz = np.random.default_rng(0).random((300_000, 3))
    with pytest.raises(InputError, match=r"about 300,000 others within 5.* take a smaller radius"):
        count_neighbours(xyz, 5.0)
    assert (
        count_neighbours(xyz[:2000], 5.0).tolist() == [2000] * 2000
    )  # not many points, so it may be any radius


def test_the_paper_s_classes():
    """Figure 17 has 99 and 451 classes; Table 8's clouds have 9,666 and 203,122 points."""
    assert (default_classes(9666), default_classes(203_122)) == (99, 451)


def test_histogram_and_gaussian():
    rng = np.random.default_rng(0)
    n = np.rint(rng.normal(114.64, 25, 20_000)).astype(int)
    for h in (histogram(n), histogram(n, 99)):
        assert h.counts.sum() == len(n)
        assert h.mean == n.mean()
        assert h.std == n.std()
        middle = (h.edges[1:] + h.edges[:-1]) / 2
        assert np.abs(h.gaussian(middle) - h.counts).max() < 0.1 * h.counts.max() + 60 * (
            h.classes == 99
        )
        assert h.gaussian(middle).sum() == pytest.approx(len(n), rel=0.01)
    assert histogram(n, 99).classes == 99


def test_own_classes_hold_whole_numbers_where_narrow_ones_leave_a_comb():
    n = np.repeat(np.arange(1, 51), 90)  # as many points of every count: nothing to see
    assert len(set(histogram(n).counts.tolist())) == 1
    comb = histogram(n, default_classes(len(n)))
    assert comb.classes == 68
    assert (comb.counts == 0).sum() == 68 - 50


@pytest.mark.parametrize("n", [[7], [7, 7, 7]])
def test_histogram_of_equal_counts(n):
    h = histogram(np.array(n))
    assert h.counts.tolist() == [len(n)]
    assert h.std == 0


@pytest.mark.slow
def test_three_million_points_in_bounded_memory():
    """Counting adds less than 150 bytes a point to the points themselves."""
    code = """
import resource, numpy as np
from sfmkit.clouds.density import density
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
xyz = np.random.default_rng(0).random((3_000_000, 3)) * [1, 1, 0.001]
before = peak()
n = density(xyz, 0.0018).neighbours
assert n.min() >= 1 and 25 < n.mean() < 45, n.mean()
assert peak() - before < 150 * len(xyz), peak() - before
"""
    subprocess.run([sys.executable, "-c", code], check=True)


# --- CloudCompare


def cloudcompare_counts(folder: Path, xyz: np.ndarray, radius: float) -> np.ndarray:
    """CloudCompare's "Number of neighbors" of float32 points."""
    program = shutil.which("CloudCompare")
    if program is None:
        if os.environ.get("CI"):
            pytest.fail("CloudCompare is missing; its test must not skip in CI")
        pytest.skip("CloudCompare is missing: apt-get install cloudcompare")
    vertices = np.empty(len(xyz), dtype=[(k, "<f4") for k in "xyz"])
    for k, values in zip("xyz", xyz.T):
        vertices[k] = values
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(folder / "in.ply")
    command = f"{program} -SILENT -NO_TIMESTAMP -C_EXPORT_FMT PLY -PLY_EXPORT_FMT BINARY_LE"
    command += " -AUTO_SAVE OFF"
    command += f" -O in.ply -DENSITY {radius:g} -TYPE KNN -SAVE_CLOUDS FILE out.ply"
    home = {"HOME": str(folder), "QT_QPA_PLATFORM": "offscreen", "XDG_RUNTIME_DIR": str(folder)}
    subprocess.run(
        command.split(),
        cwd=folder,
        env={**os.environ, **home},
        check=True,
        timeout=300,
        capture_output=True,
    )
    out = PlyData.read(folder / "out.ply")["vertex"]
    name = next(p.name for p in out.properties if "neighbors" in p.name)
    assert np.array_equal(
        np.stack([out[k] for k in "xyz"], 1), xyz.astype(np.float32)
    )  # in the same order
    return out[name].astype(np.int64)


@pytest.mark.cloudcompare
@pytest.mark.parametrize("kind", ["lattice and copies", "cloud", "surface"])
def test_same_as_cloudcompare(tmp_path, kind):
    rng = np.random.default_rng(0)
    if kind == "cloud":
        xyz, radius = rng.normal(size=(20_000, 3)), 0.1
    elif kind == "surface":
        u = rng.random((30_000, 2))
        xyz, radius = (
            np.column_stack([u, np.sin(6 * u[:, 0]) + 0.01 * rng.normal(size=len(u))]),
            0.05,
        )
    # distances of exactly 1, four copies of one point, a lonely one, pairs just within and just
    # beyond
    else:
        grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), -1).reshape(-1, 3)
        xyz = np.concatenate(
            [
                grid,
                [[20, 20, 20]] * 4,
                [[30, 0, 0], [40, 0, 0], [40, 0, 0.999], [50, 0, 0], [50, 0, 1.001]],
            ]
        )
        radius = 1
    xyz = xyz.astype(np.float32)
    assert np.array_equal(count_neighbours(xyz, radius), cloudcompare_counts(tmp_path, xyz, radius))
