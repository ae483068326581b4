"""Clouds moved by a known similarity and brought back; distances by hand; the command."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from sfmkit.cli import main
from sfmkit.clouds.alignment import align
from sfmkit.clouds.comparison import Distances
from sfmkit.datasets.rendering.raycasting import geometry
from sfmkit.datasets.synthetic import named_scene, relative_pose
from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.io.ply import read_ply

SIZE = (160, 120)
SCALE, TURN, SHIFT = (
    0.037,
    Rotation.from_rotvec([1.9, -0.7, 2.2]).as_matrix(),
    np.array([30.0, -4, 7]),
)


@cache
def surface(view: int) -> np.ndarray:
    """What one camera sees of the courtyard, at random pixels, in metres in its own frame."""
    scene = named_scene("courtyard")
    points = geometry(scene, (scene.pose1, scene.pose2)[view - 1], scene.K(SIZE), SIZE)[1].reshape(
        -1, 3
    )
    points = points[np.isfinite(points[:, 2]) & (points[:, 2] < 40)]
    return np.random.default_rng(view).permutation(points)[:1600]


def moved(xyz: np.ndarray) -> np.ndarray:
    """In another frame and unit: ``xyz = SCALE TURN moved + SHIFT``."""
    return (xyz - SHIFT) @ TURN / SCALE


def errors(found) -> tuple[float, float]:
    """Of the scale (a ratio) and of the rotation (degrees)."""
    cosine = (np.trace(found.similarity.R.numpy().T @ TURN) - 1) / 2
    return abs(float(found.similarity.s) / SCALE - 1), float(
        np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    )


def test_exact():
    found = align(surface(1), moved(surface(1)))
    scale, degrees = errors(found)
    assert scale < 1e-9
    assert degrees < 1e-5
    assert np.allclose(found.similarity.t.numpy(), SHIFT, atol=1e-8)
    assert found.overlap == (1, 1)
    assert found.rivalry < 1e-6


def test_noise_other_density_and_outliers():
    rng = np.random.default_rng(0)
    a, b = surface(1)[:1300], surface(1)[300:] + 0.02 * rng.normal(size=(1300, 3))
    b = np.concatenate([b, rng.uniform(-30, 40, (200, 3))])
    found = align(a, moved(b))
    scale, degrees = errors(found)
    assert scale < 0.005
    assert degrees < 0.2
    assert found.overlap[1] < 0.95
    assert not found.doubtful


def test_two_views_overlap_in_part():
    """Each camera's own surface points: the true similarity is the relative pose."""
    scene = named_scene("courtyard")
    R, t = relative_pose(scene.pose1, scene.pose2)  # X2 = R X1 + t
    found = align(surface(1), surface(2) * 3.0)  # X1 = R^T (X2 - t)
    assert float(found.similarity.s) * 3 == pytest.approx(1, abs=0.02)
    cosine = (np.trace(found.similarity.R.numpy() @ R) - 1) / 2
    assert np.rad2deg(np.arccos(min(1, cosine))) < 1
    back = found.similarity.apply(torch.from_numpy(surface(2) * 3.0)).numpy()
    assert np.median(np.linalg.norm(back - (surface(2) - t) @ R, axis=1)) < 0.15


def test_pairs_help_where_the_overlap_is_small():
    a, order = surface(1), np.argsort(surface(1)[:, 0])
    left, right = a[order[:1050]], a[order[550:]]  # 500 in common
    pairs = np.column_stack([np.arange(550, 1050, 70), np.arange(0, 500, 70)])
    scale, degrees = errors(align(left, moved(right), pairs))
    assert scale < 1e-6
    assert degrees < 1e-4


def test_the_same_seed_gives_the_same_bits():
    b = moved(surface(1)[::6])
    one, other = (align(surface(1)[::4], b, seed=5) for _ in range(2))
    assert all(torch.equal(x, y) for x, y in zip(one.similarity, other.similarity))


def test_a_symmetrical_thing_is_ambiguous():
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 8)] * 3), -1).reshape(-1, 3)
    assert align(grid, moved(grid)).doubtful


@pytest.mark.parametrize(
    "b,pairs,error,message",
    [
        (
            np.outer(np.arange(9.0), [1, 2, 3]),
            None,
            DegenerateGeometryError,
            "second cloud's points lie on a line",
        ),
        (np.zeros((50, 3)), None, DegenerateGeometryError, "at one place"),
        (np.eye(3)[:2], None, DegenerateGeometryError, "line"),
        (np.zeros((0, 3)), None, InputError, "no points"),
        (np.eye(3), np.array([[0, 0], [1, 1]]), DegenerateGeometryError, "three pairs"),
        (
            np.eye(3),
            np.array([[0, 0], [1, 1], [2, 3]]),
            InputError,
            "second cloud of 3 does not have",
        ),
        (np.eye(3), np.zeros((3, 2)), InputError, "whole numbers"),
    ],
)
def test_bad_input(b, pairs, error, message):
    with pytest.raises(error, match=message):
        align(surface(1), b, pairs)


def test_distances():
    d = Distances.of(np.array([0.0, 1, 2, 3, 94]))
    assert d.median == 2
    assert d.rms == pytest.approx(np.sqrt((1 + 4 + 9 + 94**2) / 5))
    assert d.p95 == pytest.approx(np.percentile([0, 1, 2, 3, 94], 95))


# --- the command


def write(path: Path, xyz: np.ndarray) -> Path:
    vertices = np.empty(len(xyz), dtype=[(k, "f8") for k in "xyz"])
    for k, values in zip("xyz", xyz.T):
        vertices[k] = values
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order=">").write(path)
    return path


def run(*arguments: object):
    return CliRunner().invoke(main, ["compare", *map(str, arguments)])


def test_command(tmp_path):
    """The second cloud is a part of the first: every distance is known."""
    a = surface(1)[:900]
    first, second = write(tmp_path / "a.ply", a), write(tmp_path / "b.ply", moved(a[:600]))
    out = tmp_path / "c"
    result = run(first, second, "--radius", 0.5, "--out", out)
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in out.iterdir()) == ["compare.json", "compare.png", "second.ply"]
    numbers = json.loads((out / "compare.json").read_text())
    assert numbers["alignment"]["scale"] == pytest.approx(SCALE, rel=1e-6)
    assert (numbers["first"]["points"], numbers["second"]["points"]) == (900, 600)
    assert numbers["second"]["distance"]["p95"] < 1e-6
    gap = np.linalg.norm(a[600:, None] - a[None, :600], axis=2).min(1)
    assert numbers["first"]["distance"]["rms"] == pytest.approx(
        np.sqrt((gap**2).sum() / 900), rel=1e-4
    )
    within = (np.linalg.norm(a[:600, None] - a[None, :600], axis=2) <= 0.5).sum(1)
    assert numbers["second"]["neighbours"]["mean"] == pytest.approx(within.mean(), rel=1e-3)
    assert numbers["first"]["distance_over_extent"]["rms"] * numbers["extent"] == pytest.approx(
        numbers["first"]["distance"]["rms"]
    )
    assert np.allclose(read_ply(out / "second.ply").xyz.numpy(), a[:600], atol=1e-4)
    assert "exists" in run(first, second, "--out", out).output


def test_command_with_pairs_and_an_ambiguous_thing(tmp_path):
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 6)] * 3), -1).reshape(-1, 3)
    first, second = write(tmp_path / "a.ply", grid), write(tmp_path / "b.ply", moved(grid))
    result = run(first, second, "--out", tmp_path / "c")
    assert result.exit_code == 1
    assert "give --pairs" in result.output
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("".join(f"{k} {k}\n" for k in (0, 7, 100, 200)))
    result = run(first, second, "--pairs", pairs, "--out", tmp_path / "d")
    assert result.exit_code == 0, result.output
    assert np.allclose(read_ply(tmp_path / "d" / "second.ply").xyz.numpy(), grid, atol=1e-5)


@pytest.mark.parametrize("text", ["", "1 2 3\n", "a b\n", "1\n", "1 2\n3\n"])
def test_bad_pairs_file(tmp_path, text):
    first = write(tmp_path / "a.ply", surface(1)[:50])
    pairs = tmp_path / "pairs.txt"
    pairs.write_text(text)
    result = run(first, first, "--pairs", pairs, "--out", tmp_path / "c")
    assert result.exit_code == 2
    assert "two whole numbers" in result.output
    assert not (tmp_path / "c").exists()


def test_missing_and_empty_clouds(tmp_path):
    first = write(tmp_path / "a.ply", surface(1)[:50])
    for second, message in (
        (tmp_path / "no.ply", "there is no file"),
        (write(tmp_path / "e.ply", np.zeros((0, 3))), "no vertices"),
    ):
        result = run(first, second, "--out", tmp_path / "c")
        assert result.exit_code == 2
        assert message in result.output
