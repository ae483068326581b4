"""The drone benchmark on made-up photographs with EXIF, and on real ones at a reduced size."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image

from sfmkit.cli.bench import bench
from sfmkit.datasets.synthetic import render
from sfmkit.errors import InputError
from sfmkit.evaluation.paper import UAV
from sfmkit.evaluation.uav import (
    SMALL,
    WIDE,
    bench_uav,
    inside_box,
    open_flight,
    parse_box,
    ply_name,
)
from sfmkit.geometry.reprojection import project
from sfmkit.io.ply import read_ply, write_ply
from sfmkit.reports.result import read_result

SIZE = (480, 360)
BOX = "100,80,300,260"
SETTINGS = {"operators": ("orb",), "presets": ("default",), "box": BOX}


def photograph(path, pixels, focal_35mm=32) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = focal_35mm  # FocalLengthIn35mmFilm
    Image.fromarray(pixels).save(path, exif=exif, quality=95)


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """A flight of three: the courtyard's first photograph, its second, and the second again with
    other noise."""
    root = tmp_path_factory.mktemp("data")
    folder = root / "uav" / "made-up"
    folder.mkdir(parents=True)
    pair, again = (render("courtyard", size_wh=SIZE, noise=0.5, seed=seed) for seed in (0, 1))
    for k, pixels in enumerate((pair.image1, pair.image2, again.image2)):
        photograph(folder / f"{k}.jpg", pixels)
    return root


@pytest.fixture(scope="module")
def run(made_up, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    return out, bench_uav(out, data=made_up, colmap=False, **SETTINGS)


def test_rows_of_both_cases(run):
    out, rows = run
    assert [(r["case"], r["pair"]) for r in rows] == [(SMALL, "0-1"), (SMALL, "1-2"), (WIDE, "0-2")]
    first, second, wide = rows
    for r in (first, wide):
        assert r["verdict"] == "general"
        assert 0 < r["target"] < r["points"] <= r["initial"]
        cloud = read_ply(out / ply_name(r["case"], "default"))
        assert len(cloud) == r["points"]
    assert second["target"] is None, "the box is one in the first photograph"
    assert first["camera"].startswith("exif")


def test_the_box_counts_what_the_photograph_shows_in_it(run, made_up):
    out, rows = run
    camera = open_flight(made_up, None, None).camera
    cloud = read_ply(out / ply_name(SMALL, "default"))
    x = project(cloud.xyz, torch.from_numpy(camera.K.copy()))
    by_hand = sum(100 <= u <= 300 and 80 <= v <= 260 for u, v in x.tolist())
    assert rows[0]["target"] == by_hand == inside_box(cloud, camera, parse_box(BOX, SIZE)).sum()
    behind = replace(cloud, xyz=-cloud.xyz, covariance=None)
    assert inside_box(behind, camera, (-1e9, -1e9, 1e9, 1e9)).sum() == 0


def test_it_resumes(run, made_up):
    out, rows = run
    assert bench_uav(out, data=made_up, colmap=False, **SETTINGS) == rows
    with pytest.raises(InputError, match="was made with"):
        bench_uav(out, data=made_up, colmap=False, **SETTINGS | {"box": None})


def test_anothers_cloud_is_laid_over_ours(run, made_up, tmp_path):
    """Our own cloud, turned, shifted and scaled, comes back to its place: as many points in the
    box."""
    out, rows = run
    ours = read_ply(out / ply_name(SMALL, "default"))
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    write_ply(
        tmp_path / "other.ply",
        replace(ours, xyz=20 * ours.xyz @ turn.T + 3, covariance=None, operators=("orb",)),
    )
    again = bench_uav(out, data=made_up, colmap=False, clouds=[tmp_path / "other.ply"], **SETTINGS)
    given = [r for r in again if r["kind"] == "given"]
    assert [r["case"] for r in given] == [SMALL, WIDE]
    assert given[0]["points"] == len(ours)
    assert given[0]["target"] == pytest.approx(rows[0]["target"], rel=0.02)
    assert "scaled by 0.05" in given[0]["note"]
    moved = read_ply(out / ply_name(SMALL, "given-other"))
    assert float((moved.xyz - ours.xyz).norm(dim=1).median()) < 0.01 * float(
        ours.xyz.norm(dim=1).median()
    )


def test_the_command_and_its_tables(made_up, tmp_path):
    arguments = [
        "uav",
        "--data",
        str(made_up),
        "--out",
        str(tmp_path),
        "--operators",
        "orb",
        "--presets",
        "default",
        "--no-colmap",
        "--box",
        BOX,
    ]
    done = CliRunner().invoke(bench, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    result = read_result(tmp_path)
    assert result.command.endswith(f"uav --box {BOX} --operators orb --presets default --no-colmap")
    assert [t.name for t in result.tables] == ["table-7", "table-8", "pairs"]
    for table, case in zip(result.tables, (SMALL, WIDE)):
        ours, theirs, micmac = table.rows
        assert ours[0] == "sfmkit, default preset"
        assert (micmac[1], micmac[3], micmac[4]) == (
            UAV[case]["MicMac"][0],
            *UAV[case]["MicMac"][2:],
        )
    assert result.tables[1].rows[1][2] == 9.0, "0.15 minutes"
    assert [f.file for f in result.figures] == [
        "target.png",
        "clouds-small-shift.png",
        "clouds-wide-baseline.png",
    ]
    assert np.asarray(Image.open(tmp_path / "clouds-wide-baseline.png").convert("L")).std() > 10


def test_without_pycolmap_the_line_says_so(made_up, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    arguments = [
        "uav",
        "--data",
        str(made_up),
        "--out",
        str(tmp_path),
        "--operators",
        "orb",
        "--presets",
        "default",
    ]
    done = CliRunner().invoke(bench, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "pip install 'sfmkit[peers]'" in " ".join(done.output.split())
    kinds = [
        line for line in (tmp_path / "rows.jsonl").read_text().splitlines() if '"colmap"' in line
    ]
    assert not kinds, "it is tried again next time"


@pytest.mark.peers
def test_colmap_runs_on_the_same_photographs(made_up, tmp_path):
    pytest.importorskip("pycolmap")
    rows = [r for r in bench_uav(tmp_path, data=made_up, **SETTINGS) if r["kind"] == "colmap"]
    assert [(r["case"], r["given"]) for r in rows] == [(SMALL, "2"), (WIDE, "2"), (SMALL, "all")]
    assert [r["images"][1] for r in rows] == [2, 2, 3]
    assert rows[0]["images"][0] == 2
    assert rows[0]["points"] > 30
    # COLMAP's cloud lies where ours does: in the frame of camera 1, in baselines.
    ours, theirs = (read_ply(tmp_path / ply_name(SMALL, what)) for what in ("default", "colmap-2"))
    assert float(theirs.xyz[:, 2].median()) == pytest.approx(
        float(ours.xyz[:, 2].median()), rel=0.2
    )


# -- bad input


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ("1,2,3", "four numbers"),
        ("a,b,c,d", "four numbers"),
        ("", "four numbers"),
        ("10,10,5,20", "is empty"),
        ("10,nan,20,30", "is empty"),
        ("500,0,600,100", "480 x 360"),
        ("-9,-9,-1,-1", "outside"),
    ],
)
def test_bad_boxes(box, message):
    with pytest.raises(InputError, match=message):
        parse_box(box, SIZE)


def test_no_box_is_the_middle():
    assert parse_box(None, (300, 150)) == (100, 50, 200, 100)
    assert parse_box(" 1, 2,3,4.5", (300, 150)) == (1, 2, 3, 4.5)


def test_bad_settings(made_up, tmp_path):
    with pytest.raises(InputError, match="unknown preset"):
        bench_uav(tmp_path, data=made_up, presets=("best",))
    with pytest.raises(InputError, match="unknown operator"):
        bench_uav(tmp_path, data=made_up, operators=("srf",))
    with pytest.raises(InputError, match=r"unknown sequence 'made-pu'\. Did you mean 'made-up'"):
        bench_uav(tmp_path, data=made_up, sequence="made-pu")
    with pytest.raises(InputError, match="take 6"):
        bench_uav(tmp_path, data=made_up, step=5)
    with pytest.raises(InputError, match="at least 2 apart"):
        bench_uav(tmp_path, data=made_up, step=1)
    with pytest.raises(InputError, match="no folder"):
        bench_uav(tmp_path, data=tmp_path / "none")
    empty = tmp_path / "empty.ply"
    empty.write_text(
        "ply\nformat ascii 1.0\nelement vertex 0\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    with pytest.raises(InputError, match="holds no vertices"):
        bench_uav(tmp_path, data=made_up, clouds=[empty])
    with pytest.raises(InputError, match="there is no file"):
        bench_uav(tmp_path, data=made_up, clouds=[tmp_path / "none.ply"])
    assert not (tmp_path / "rows.jsonl").exists(), "nothing was begun"


def test_one_photograph_is_not_a_flight(tmp_path):
    folder = tmp_path / "uav" / "one"
    folder.mkdir(parents=True)
    photograph(folder / "0.jpg", np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match="holds 1 photographs"):
        open_flight(tmp_path, None, None)


# -- the photographs


@pytest.mark.data
def test_the_roofs_at_a_third_of_their_size(data_dir, tmp_path):
    rows = bench_uav(
        tmp_path,
        data=data_dir,
        presets=("default",),
        max_size=800,
        colmap=False,
        box="1290,70,1510,370",
    )
    small = [r for r in rows if r["case"] == SMALL]
    wide = [r for r in rows if r["case"] == WIDE]
    assert len(small) == 4
    assert [r["pair"] for r in wide] == ["1JI_0064-1JI_0068"]
    assert all(r["verdict"] == "general" and r["points"] > 2000 for r in small)
    assert wide[0]["points"] > 500
    assert small[0]["target"] > 20
