"""Clouds as PLY: ours there and back, and everybody else's."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from sfmkit.errors import InputError, OutputError
from sfmkit.io.ply import read_ply, write_ply
from sfmkit.types import PointCloud


def make_cloud(
    n: int = 50, operators: tuple[str, ...] = ("surf", "orb", "fast-brief"), covariance=True
) -> PointCloud:
    rng = torch.Generator().manual_seed(0)
    A = torch.randn(n, 3, 3, generator=rng, dtype=torch.float64)
    who = torch.randint(0, len(operators), (n,), generator=rng)
    return PointCloud(
        xyz=torch.randn(n, 3, generator=rng, dtype=torch.float64) * 10,
        rgb=torch.randint(0, 256, (n, 3), generator=rng, dtype=torch.uint8),
        operator_id=who,
        operator_mask=(1 << who) | 1,
        operators=operators,
        reprojection_error=torch.rand(n, generator=rng, dtype=torch.float64),
        parallax=torch.rand(n, generator=rng, dtype=torch.float64) * 20,
        match=torch.randperm(n, generator=rng),
        covariance=A @ A.mT if covariance else None,
    )


EXACT = ("rgb", "operator_id", "operator_mask", "match")
ROUNDED = ("xyz", "reprojection_error", "parallax", "covariance")


@pytest.mark.parametrize("covariance", [True, False])
@pytest.mark.parametrize("count", [3, 62])
def test_there_and_back(tmp_path, covariance, count):
    cloud = make_cloud(operators=tuple(f"op{k}" for k in range(count)), covariance=covariance)
    write_ply(tmp_path / "c.ply", cloud)
    back = read_ply(tmp_path / "c.ply")
    assert back.operators == cloud.operators
    for name in EXACT:
        assert torch.equal(getattr(back, name), getattr(cloud, name)), name
    for name in ROUNDED:
        if getattr(cloud, name) is None:
            assert getattr(back, name) is None
        else:
            assert torch.allclose(getattr(back, name), getattr(cloud, name), rtol=1e-6), name
    assert [p.name for p in tmp_path.iterdir()] == ["c.ply"]


def test_what_viewers_see(tmp_path):
    """The names and types that CloudCompare, MeshLab and their like look for."""
    cloud = make_cloud()
    write_ply(tmp_path / "c.ply", cloud, fields={"density": torch.arange(50)})
    ply = PlyData.read(tmp_path / "c.ply")
    assert (ply.text, ply.byte_order) == (False, "<")
    assert [e.name for e in ply.elements] == ["vertex"]
    kinds = {p.name: p.val_dtype for p in ply["vertex"].properties}
    assert [kinds[k] for k in ("x", "y", "z", "red", "green", "blue")] == ["f4"] * 3 + ["u1"] * 3
    assert kinds["operators"] == "u4"
    assert np.array_equal(ply["vertex"]["density"], np.arange(50))
    assert "operator bit 2 = fast-brief" in ply.comments
    bit = {
        c.split(" = ")[1]: int(c.split()[2]) for c in ply.comments if c.startswith("operator bit")
    }
    for name in cloud.operators:
        assert np.array_equal(
            ply["vertex"]["operators"] >> bit[name] & 1, cloud.found_by(name).numpy()
        )


def test_failure_leaves_the_old_file(tmp_path):
    (tmp_path / "c.ply").write_text("old")
    with pytest.raises(ValueError):
        write_ply(tmp_path / "c.ply", make_cloud(), fields={"density": torch.zeros(3)})
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("c.ply", "old")]
    with pytest.raises(OutputError, match="cannot be written"):
        write_ply(tmp_path / "no" / "c.ply", make_cloud())


# --- foreign files

XYZ = np.random.default_rng(0).normal(size=(20, 3))
RGB = np.random.default_rng(1).integers(0, 256, (20, 3))


def foreign(
    path: Path,
    *,
    xyz="f4",
    colours=("red", "green", "blue"),
    rgb="u1",
    scale=1.0,
    text=False,
    order="<",
    faces=0,
    holes=(),
) -> Path:
    """What another program might write."""
    names = [*((k, xyz) for k in "xyz"), *((k, rgb) for k in colours), ("scalar_Density", "f4")]
    data = np.zeros(len(XYZ), dtype=names)
    for k, values in zip("xyz", XYZ.T):
        data[k] = values
    data["y"][list(holes)] = np.nan
    for k, values in zip(colours, RGB.T):
        data[k] = values * scale
    elements = [PlyElement.describe(data, "vertex")]
    if faces:
        triangles = np.array(
            [([0, 1, k],) for k in range(faces)], dtype=[("vertex_indices", "i4", (3,))]
        )
        elements.append(PlyElement.describe(triangles, "face"))
    PlyData(elements, text=text, byte_order=order, comments=["made elsewhere"]).write(path)
    return path


@pytest.mark.parametrize("text,order", [(True, "="), (False, "<"), (False, ">")])
@pytest.mark.parametrize("xyz", ["f4", "f8"])
@pytest.mark.parametrize("faces", [0, 5])
def test_encodings(tmp_path, text, order, xyz, faces):
    cloud = read_ply(foreign(tmp_path / "c.ply", xyz=xyz, text=text, order=order, faces=faces))
    assert np.allclose(cloud.xyz.numpy(), XYZ, rtol=1e-6)
    assert np.array_equal(cloud.rgb.numpy(), RGB)
    assert cloud.operators == ()
    assert not cloud.operator_mask.any()
    assert cloud.reprojection_error.isnan().all()
    assert (cloud.match == -1).all()
    assert cloud.covariance is None


@pytest.mark.parametrize(
    "options",
    [
        {"colours": ("diffuse_red", "diffuse_green", "diffuse_blue")},
        {"colours": ("r", "g", "b")},
        {"colours": ("Red", "Green", "Blue")},
        {"rgb": "f4", "scale": 1 / 255},
        {"rgb": "u2", "scale": 256},
        {"rgb": "i4"},
    ],
)
def test_colours(tmp_path, options):
    assert np.array_equal(read_ply(foreign(tmp_path / "c.ply", **options)).rgb.numpy(), RGB)


def test_no_colours_is_grey(tmp_path):
    assert (read_ply(foreign(tmp_path / "c.ply", colours=())).rgb == 128).all()


def test_foreign_cloud_can_be_written_and_edited(tmp_path):
    cloud = read_ply(foreign(tmp_path / "a.ply", colours=()))
    write_ply(tmp_path / "b.ply", replace(cloud, rgb=torch.from_numpy(RGB.astype(np.uint8))))
    assert np.array_equal(read_ply(tmp_path / "b.ply").rgb.numpy(), RGB)


def test_vertices_without_a_position_are_dropped_and_counted(tmp_path):
    path = foreign(tmp_path / "c.ply", holes=[3, 7])
    with pytest.warns(UserWarning, match="2 of 20 vertices"):
        cloud = read_ply(path)
    assert np.allclose(cloud.xyz.numpy(), np.delete(XYZ, [3, 7], 0), rtol=1e-6)
    assert np.array_equal(cloud.rgb.numpy(), np.delete(RGB, [3, 7], 0))
    with pytest.raises(InputError, match="none of the 20 vertices"):
        read_ply(foreign(tmp_path / "d.ply", holes=list(range(20))))


HEAD = "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float {z}\nend_header\n"


@pytest.mark.parametrize(
    "content,message",
    [
        (b"", "cannot be read as PLY"),
        (b"not a cloud\n", "cannot be read as PLY"),
        (bytes(range(256)), "cannot be read as PLY"),
        (HEAD.format(n=0, z="z").encode(), "holds no vertices"),
        (HEAD.format(n=2, z="z").encode() + b"1 2 3\n", "cannot be read as PLY .*end-of-file"),
        (HEAD.format(n=1, z="z").encode() + b"1 2\n", "cannot be read as PLY .*end-of-line"),
        (HEAD.format(n=1, z="z").encode() + b"1 2 three\n", "cannot be read as PLY .*malformed"),
        (
            HEAD.format(n=1, z="w").encode() + b"1 2 3\n",
            "no x, y, z for its vertices, only x, y, w",
        ),
        (
            b"ply\nformat ascii 1.0\nelement face 1\nproperty float x\nend_header\n1\n",
            "holds no vertices",
        ),
        (HEAD.format(n=10**15, z="z").encode(), "cannot be read as PLY"),
        (
            HEAD.format(n=10**9, z="z").replace("ascii", "binary_little_endian").encode(),
            "early end-of-file",
        ),
    ],
)
def test_files_that_are_no_cloud(tmp_path, content, message):
    (tmp_path / "c.ply").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_ply(tmp_path / "c.ply")


def test_truncated_binary(tmp_path):
    write_ply(tmp_path / "c.ply", make_cloud())
    (tmp_path / "t.ply").write_bytes((tmp_path / "c.ply").read_bytes()[:-1])
    with pytest.raises(InputError, match="truncated"):
        read_ply(tmp_path / "t.ply")


def test_no_file(tmp_path):
    with pytest.raises(InputError, match="there is no file"):
        read_ply(tmp_path / "c.ply")
    with pytest.raises(InputError, match="is a directory"):
        read_ply(tmp_path)


@pytest.mark.slow
def test_ten_million_points_in_bounded_memory(tmp_path):
    """Positions take 240 MB as float64; reading may take three times that beside the libraries, not
    ten."""
    n = 10_000_000
    data = np.zeros(
        n, dtype=[(k, "<f4") for k in "xyz"] + [(k, "u1") for k in ("red", "green", "blue")]
    )
    data["x"] = np.arange(n) % 1000
    head = HEAD.format(n=n, z="z").replace("ascii", "binary_little_endian")
    head = head.replace(
        "end_header", "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header"
    )
    with (tmp_path / "c.ply").open("wb") as file:
        file.write(head.encode())
        data.tofile(file)
    code = (
        "import resource, sys; from sfmkit.io.ply import read_ply;"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        "before = peak(); cloud = read_ply(sys.argv[1]); print(len(cloud), peak() - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "c.ply"], capture_output=True, text=True, check=True
    )
    count, kilobytes = map(int, done.stdout.split())
    assert count == n
    assert kilobytes < 1_000_000
