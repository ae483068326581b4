"""The density of a cloud as a report, and as a command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plyfile import PlyData, PlyElement

from sfmkit.cli import main
from sfmkit.clouds.density import count_neighbours
from sfmkit.evaluation.density_by_operator import density_report
from sfmkit.io.ply import read_ply

RNG = np.random.default_rng(0)


def write(path: Path, xyz: np.ndarray, kind: str = "f4", order: str = "<") -> Path:
    vertices = np.empty(len(xyz), dtype=[(k, kind) for k in "xyz"])
    for k, values in zip("xyz", xyz.T):
        vertices[k] = values
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order=order).write(path)
    return path


def box(n: int) -> np.ndarray:
    """Points spread evenly over the six faces of a unit cube."""
    xyz, face = RNG.random((n, 3)), RNG.integers(6, size=n)
    xyz[np.arange(n), face % 3] = face // 3
    return xyz


def run(*arguments: object):
    return CliRunner().invoke(main, ["density", *map(str, arguments)])


@pytest.fixture
def wall(tmp_path) -> Path:
    """A plane, three times denser along a ridge that stands out of it."""
    plain, ridge = RNG.random((3000, 3)), RNG.random((1500, 3)) * [1, 0.1, 1] + [0, 0.45, 0]
    for part in (plain, ridge):
        part[:, 2] = 0.1 * np.maximum(0, 1 - np.abs(part[:, 1] - 0.5) / 0.05)
    return write(tmp_path / "wall.ply", np.concatenate([plain, ridge]))


def test_points_put_on_an_edge_are_found_there(wall):
    effects = density_report(read_ply(wall), 0.05).effects
    assert effects["surface_variation"].low > 0.5
    assert effects["planarity"].high < 0


def test_an_evenly_covered_box_has_more_within_a_sphere_near_its_edges(tmp_path):
    """What geometry alone does to the comparison: the docs quote it."""
    e = density_report(read_ply(write(tmp_path / "box.ply", box(20_000))), 0.08).effects[
        "surface_variation"
    ]
    assert 0.35 < e.delta < 0.55
    assert e.low < e.delta < e.high


def test_command(tmp_path, wall):
    out = tmp_path / "d"
    result = run(wall, "--radius", 0.05, "--out", out)
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in out.iterdir()) == [
        "density.json",
        "density.ply",
        "density.png",
        "histogram.png",
    ]
    numbers = json.loads((out / "density.json").read_text())
    expected = count_neighbours(read_ply(wall).xyz.numpy(), 0.05)
    assert numbers["neighbours"]["mean"] == pytest.approx(expected.mean())
    assert sum(numbers["histogram"]["counts"]) == numbers["points"] == 4500
    vertices = PlyData.read(out / "density.ply")["vertex"]
    assert np.array_equal(vertices["neighbours"], expected)
    assert np.allclose(vertices["surface_density"], expected / (np.pi * 0.05**2))
    few, many = (np.flatnonzero(expected == n)[0] for n in (expected.min(), expected.max()))
    assert int(vertices["red"][few]) < int(vertices["red"][many])
    assert f"mean {expected.mean():.2f}" in result.output
    again = run(wall, "--radius", 0.05, "--out", out)
    assert again.exit_code == 2
    assert "exists" in again.output
    assert (
        json.loads(run(wall, "--radius", 0.05, "--out", out, "--overwrite", "--json").stdout)
        == numbers
    )


@pytest.mark.parametrize("kind,order", [("f4", ">"), ("f8", ">"), ("f8", "<")])
def test_foreign_encodings(tmp_path, kind, order):
    xyz = np.rint(RNG.random((300, 3)) * 8) / 8
    result = run(
        write(tmp_path / "c.ply", xyz, kind, order),
        "--radius",
        0.25,
        "--out",
        tmp_path / "d",
        "--json",
    )
    assert json.loads(result.stdout)["neighbours"]["mean"] == count_neighbours(xyz, 0.25).mean()


def test_points_that_are_left_out_are_counted(tmp_path):
    xyz = RNG.random((300, 3))
    xyz[[3, 7], 1] = np.nan, np.inf
    result = run(write(tmp_path / "c.ply", xyz), "--out", tmp_path / "d", "--json")
    assert result.exit_code == 0
    assert "2 of 300 vertices" in result.stderr
    assert "UserWarning" not in result.stderr
    assert json.loads(result.stdout)["points"] == 298


@pytest.mark.parametrize(
    "xyz,arguments,message",
    [
        (np.zeros((0, 3)), (), "no vertices"),
        (np.full((3, 3), np.nan), (), "none of the 3 vertices"),
        (np.zeros((1, 3)), (), "give --radius"),
        (np.zeros((70, 3)), (), "give --radius"),
        (np.eye(3), ("--radius", 0), "0.0 is not in the range x>0"),
        (np.eye(3), ("--radius", -0.5), "-0.5 is not in the range x>0"),
        (np.eye(3), ("--radius", "nan"), "nan is not a finite number"),
        (np.eye(3), ("--radius", "inf"), "inf is not a finite number"),
        (np.eye(3), ("--radius", "wide"), "not a valid number"),
        (None, (), "cannot be read as PLY"),
    ],
)
def test_bad_input_is_reported_and_leaves_nothing(tmp_path, xyz, arguments, message):
    path = tmp_path / "c.ply"
    if xyz is None:
        path.write_text("not a cloud")
    else:
        write(path, xyz)
    result = run(path, *arguments, "--out", tmp_path / "d")
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output
    assert [p.name for p in tmp_path.iterdir()] == ["c.ply"]


@pytest.mark.parametrize("n", [1, 2, 70])
def test_few_points_with_a_radius(tmp_path, n):
    result = run(
        write(tmp_path / "c.ply", np.zeros((n, 3))), "--radius", 1, "--out", tmp_path / "d"
    )
    assert result.exit_code == 0, result.output
    assert "not compared" in result.output
