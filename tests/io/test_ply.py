"""Clouds as PLY: written and read back, and files of other programs."""

from __future__ import annotations

import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from sfmkit.errors import InputError, OutputError
from sfmkit.io.ply import needs_double, read_ply, write_ply
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
        {"rgb": "f8", "scale": 1 / 255},
        {"rgb": "f4"},
        {"rgb": "u1", "text": True},
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


HEAD = """ply
format ascii 1.0
element vertex {n}
property float x
property float y
property float {z}
end_header
"""
BODY = "0 1 2\n3 4 5\n"
TWO = HEAD.format(n=2, z="z")


@pytest.mark.parametrize(
    "text",
    [
        TWO + BODY,
        (TWO + BODY).replace("\n", "\r\n"),
        "\ufeff" + TWO + BODY,
        TWO.replace("\n", " \n") + BODY,
        TWO.replace("element", "\nelement") + BODY,
        TWO.replace("property float", "property\tfloat32") + BODY,
        TWO.replace("element", "comment Größe in m\nobj_info num_cols 3\nelement") + BODY,
        TWO + "\n" + BODY,
        TWO + BODY.replace(" ", "\n"),
        TWO + BODY.replace("\n", " "),
        TWO.replace("float x", "int x") + "0e0 1 2\n3.0 4 5\n",
        TWO.replace("end_header", "property uchar red\nend_header") + "0 1 2 9.0\n3 4 5 8.0\n",
        TWO.replace("end_header", "property list uchar uint ids\nend_header")
        + "0 1 2 2 7 7\n3 4 5 0\n",
        TWO.replace("property float x", "property list uchar uint ids\nproperty float x")
        + "2 7 7\n0 1 2\n0 3 4\n5\n",
        TWO.replace("element", "element camera 1\nproperty float f\nelement") + "9\n" + BODY,
        TWO.replace("element", "element face 1\nproperty list uchar int v\nelement", 1)
        + "3 0 1 0\n"
        + BODY,
        TWO.replace("end_header", "element face 1\nproperty list uchar int v\nend_header")
        + BODY
        + "3 0 1 0\n",
    ],
    ids=[
        *("plain", "carriage returns", "byte order mark", "spaces at the end", "blank line"),
        *("tabs and other type names", "not ASCII", "blank line in the body", "a word per line"),
        *("one line", "floats for integers", "float for a byte", "list", "list before x"),
        *("another element first", "faces first", "faces last"),
    ],
)
def test_text_that_other_programs_open(tmp_path, text):
    (tmp_path / "c.ply").write_text(text, encoding="utf-8", newline="")
    assert read_ply(tmp_path / "c.ply").xyz.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "1.#QNAN", "1.#INF", "inf", "-1.#IND00"])
def test_positions_that_are_not_finite_as_c_writes_them(tmp_path, word):
    (tmp_path / "c.ply").write_text(TWO + f"{word} 1 2\n3 4 5\n")
    with pytest.warns(UserWarning, match="1 of 2 vertices"):
        assert read_ply(tmp_path / "c.ply").xyz.tolist() == [[3, 4, 5]]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("mark", ["", "comment Größe\n"])
def test_binary_lists(tmp_path, order, first, mark):
    """Lists of unequal length at the vertices, and faces before or after them."""
    vertices, faces = b"", struct.pack(f"{order}B3i", 3, 0, 1, 2) * 3
    for k, (x, y, z) in enumerate(XYZ):
        views = range(k % 4)
        vertices += struct.pack(f"{order}ddB{len(views)}Id", x, y, len(views), *views, z)
    elements = [
        "element vertex 20\nproperty double x\nproperty double y\n"
        "property list uchar uint views\nproperty double z\n",
        "element face 3\nproperty list uchar int vertex_indices\n",
    ]
    turn = -1 if first else 1
    name = {"<": "little", ">": "big"}[order]
    head = f"ply\nformat binary_{name}_endian 1.0\n{mark}{''.join(elements[::turn])}end_header\n"
    (tmp_path / "c.ply").write_bytes(head.encode() + b"".join([vertices, faces][::turn]))
    assert np.array_equal(read_ply(tmp_path / "c.ply").xyz.numpy(), XYZ)


def test_other_programs_columns_with_names_of_ours_are_ignored(tmp_path):
    text = TWO.replace("end_header", "property float operator\nproperty float match\nend_header")
    (tmp_path / "c.ply").write_text(text + "0 1 2 nan 7\n3 4 5 99 nan\n")
    cloud = read_ply(tmp_path / "c.ply")
    assert cloud.match.tolist() == [-1, -1]
    assert cloud.operator_id.tolist() == [0, 0]


def test_an_operator_that_the_header_does_not_name(tmp_path):
    write_ply(tmp_path / "c.ply", make_cloud())
    data = (tmp_path / "c.ply").read_bytes().replace(b"comment operator bit 2 = fast-brief\n", b"")
    (tmp_path / "c.ply").write_bytes(data)
    with pytest.raises(InputError, match="an operator that the header does not name"):
        read_ply(tmp_path / "c.ply")


# --- precision


def utm(n: int = 500) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.array([403000.0, 5604900.0, 120.0]) + rng.random((n, 3)) * [20, 20, 2]


@pytest.mark.parametrize("text", [True, False])
def test_a_cloud_in_utm_stays_double(tmp_path, text):
    xyz = utm()
    data = np.zeros(len(xyz), dtype=[(k, "f8") for k in "xyz"])
    for k, values in zip("xyz", xyz.T):
        data[k] = values
    PlyData([PlyElement.describe(data, "vertex")], text=text).write(tmp_path / "a.ply")
    write_ply(tmp_path / "b.ply", read_ply(tmp_path / "a.ply"))
    for name in ("a.ply", "b.ply"):
        assert np.abs(read_ply(tmp_path / name).xyz.numpy() - xyz).max() < 1e-9
    assert PlyData.read(tmp_path / "b.ply")["vertex"]["x"].dtype == np.float64


def test_double_where_the_numbers_need_it(tmp_path):
    ours = make_cloud()
    moved = replace(ours, xyz=torch.from_numpy(utm(50)))
    foreign = replace(ours, operators=())
    single = replace(foreign, xyz=foreign.xyz.float().double())
    none = make_cloud(n=0)
    assert [needs_double(c) for c in (ours, moved, foreign, single)] == [False, True, True, False]
    assert not needs_double(none)
    write_ply(tmp_path / "c.ply", moved)
    assert torch.equal(read_ply(tmp_path / "c.ply").xyz, moved.xyz)
    write_ply(tmp_path / "d.ply", ours)
    assert PlyData.read(tmp_path / "d.ply")["vertex"]["x"].dtype == np.float32


@pytest.mark.parametrize(
    "content,message",
    [
        (b"", "cannot be read as PLY"),
        (b"not a cloud\n", "cannot be read as PLY"),
        (bytes(range(256)), "cannot be read as PLY"),
        (HEAD.format(n=0, z="z").encode(), "holds no vertices"),
        (HEAD.format(n=2, z="z").encode() + b"1 2 3\n", "cannot be read as PLY .*end-of-file"),
        (HEAD.format(n=1, z="z").encode() + b"1 2\n", "cannot be read as PLY .*end-of-file"),
        (
            HEAD.format(n=1, z="z").encode() + b"1      2\n",
            "cannot be read as PLY .*element 'vertex': row 0: property 'z': early end-of-line",
        ),
        (HEAD.replace("float x", "float128 x").format(n=1, z="z").encode(), "header line 4"),
        (HEAD.replace("element", "elephant").format(n=1, z="z").encode(), "header line 3"),
        (HEAD.replace("format ascii 1.0", "").format(n=1, z="z").encode(), "no format"),
        (TWO.encode() + b"0,5 1 2\n3 4 5\n", "element 'vertex': row 0: property 'x'"),
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
def test_files_that_are_not_clouds(tmp_path, content, message):
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
