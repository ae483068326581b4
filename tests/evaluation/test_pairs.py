"""The benchmark of pairs: a list with all kinds of truth, resuming, plug-ins and bad input."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plugins import MODULE, on_path, write_example
from small_sweep import pairs

import sfmkit.evaluation.pairs as module
from sfmkit import reconstruct, register
from sfmkit.cli.bench import bench
from sfmkit.cli.reconstruct import reconstruct as reconstruct_command
from sfmkit.errors import InputError
from sfmkit.evaluation.pairs import FAILED, RESULT, bench_pairs, find_pairs, pose_error
from sfmkit.evaluation.pairs_tables import pairs_result
from sfmkit.metrics import corner_error
from sfmkit.reports.html import write_report
from sfmkit.reports.result import read_result

OPERATORS = ("orb", "fast-brief")
SETS = (*OPERATORS, "multi")


def entry(pair, **fields) -> dict:
    made = {"image1": pair.image1.name, "image2": pair.image2.name, "name": pair.name}
    if pair.camera1 is not None:
        made["K1"] = pair.camera1.K.tolist()
    for field in ("H", "R", "t"):
        if getattr(pair, field) is not None:
            made[field] = getattr(pair, field).tolist()
    return made | fields


@pytest.fixture
def listed(tmp_path) -> Path:
    """A list of a homography, one with check points that are one pixel off, a two-view pair, and a
    pair whose second image is damaged."""
    folder = tmp_path / "data"
    plane, checked, view = pairs(folder, homographies=2, two_views=1)
    (folder / "damaged.png").write_bytes(b"not an image")
    dx, dy = -checked.H[:2, 2]
    x = np.array([[20, 30], [150, 40], [90, 120]])
    points = np.hstack([x, x - (dx, dy) + (1, 0)]).tolist()
    entries = [
        entry(plane),
        entry(checked, check_points=points),
        entry(view),
        entry(plane, image2="damaged.png", name="damaged"),
    ]
    path = folder / "list.json"
    path.write_text(json.dumps(entries))
    return path


def chosen(rows, **wanted) -> list[dict]:
    return [row for row in rows if all(row[k] == v for k, v in wanted.items())]


@pytest.mark.slow
def test_rows_agree_with_register_and_reconstruct(listed, tmp_path):
    rows = bench_pairs([listed], tmp_path / "out", operators=OPERATORS)
    assert len(rows) == 4 * len(SETS)
    plane, checked, view, _ = find_pairs([listed])
    for name, operators in (("orb", ("orb",)), ("multi", OPERATORS)):
        (row,) = chosen(rows, pair="1-2", operator=name)
        found = register(plane.image1, plane.image2, operators)
        expected = corner_error(found.H.numpy(), plane.H, (200, 160))
        assert row["corner_error_px"] == row["error"] == pytest.approx(expected, abs=1e-9)
        assert row["inliers"] == int(found.inliers.sum())
        (row,) = chosen(rows, pair="1-4", operator=name)
        truth = (view.R, view.t)
        built = reconstruct(view.image1, view.image2, view.camera1, operators, truth=truth)
        assert row["verdict"] == built.two_view.verdict.value
        assert row["points"] == len(built.cloud)
        assert row["rotation_deg"] == pytest.approx(built.errors["rotation_deg"], abs=1e-9)
        assert row["translation_deg"] == pytest.approx(built.errors["translation_deg"], abs=1e-9)
        assert row["error"] == max(row["rotation_deg"], row["translation_deg"])
        assert set(row["seconds"]) >= {"detect", "match", "fuse", "estimate", "triangulate"}
        (row,) = chosen(rows, pair="1-3", operator=name)
        assert row["check_error_px"] == row["error"] == pytest.approx(1, abs=0.1)
        assert row["corner_error_px"] < 0.2
    failed = chosen(rows, kind=FAILED)
    assert [(row["pair"], row["operator"]) for row in failed] == [("damaged", s) for s in SETS]
    assert all("damaged.png" in row["reason"] for row in failed)


def test_a_run_is_resumed_and_changed_pairs_run_again(listed, tmp_path, monkeypatch):
    searched = []
    detect_all = module.detect_all

    def counted(images, operators, *args, **keywords):
        searched.append(Path(images[1].path).name)
        return detect_all(images, operators, *args, **keywords)

    monkeypatch.setattr(module, "detect_all", counted)
    out = tmp_path / "out"
    first = bench_pairs([listed], out, operators=("orb",))
    assert searched == ["img2.png", "img3.png", "img4.png"]
    assert bench_pairs([listed], out, operators=("orb",)) == first
    assert len(searched) == 3
    lines = (out / "rows.jsonl").read_text().splitlines(keepends=True)
    (out / "rows.jsonl").write_text("".join(lines[:-1]) + lines[-1][:40])
    again = bench_pairs([listed], out, operators=("orb",))
    assert searched[3:] == ["img4.png"]
    assert [{**row, "seconds": 0} for row in again] == [{**row, "seconds": 0} for row in first]
    damaged = listed.parent / "damaged.png"
    damaged.write_bytes((listed.parent / "img2.png").read_bytes())
    repaired = bench_pairs([listed], out, operators=("orb",))
    assert searched[4:] == ["damaged.png"]
    assert {row["kind"] for row in repaired} == {RESULT}
    entries = json.loads(listed.read_text())
    entries[0]["H"][0][2] += 5
    listed.write_text(json.dumps(entries))
    (moved,) = chosen(bench_pairs([listed], out, operators=("orb",)), pair="1-2")
    assert searched[5:] == ["img2.png"]
    assert moved["error"] == pytest.approx(5, abs=0.2)
    with pytest.raises(InputError, match=r"was made with .*choose another --out"):
        bench_pairs([listed], out, operators=("orb",), seeds=2)


def test_shards_in_one_folder_are_collected_by_the_command_without_them(
    listed, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    for number in (3, 1, 2, 4):
        bench_pairs([listed], out, operators=("orb",), shard=(number, 4))
    searched = []
    monkeypatch.setattr(module, "detect_all", lambda *args, **keywords: searched.append(args))
    collected = bench_pairs([listed], out, operators=("orb",))
    assert not searched
    monkeypatch.undo()
    whole = bench_pairs([listed], tmp_path / "whole", operators=("orb",))
    assert [{**row, "seconds": 0} for row in collected] == [{**row, "seconds": 0} for row in whole]
    with pytest.raises(InputError, match="4 pairs cannot be split into 5 shards"):
        bench_pairs([listed], out, operators=("orb",), shard=(1, 5))


def test_the_command_writes_tables_that_a_report_takes(listed, tmp_path):
    out = tmp_path / "out"
    command = ["pairs", "--data", str(listed), "--operators", "orb,fast-brief"]
    command += ["--matcher", "orb=nearest", "--max-size", "180", "--out", str(out)]
    done = CliRunner().invoke(bench, command, catch_exceptions=False)
    assert done.exit_code == 0
    result = read_result(out)
    assert result.name == "pairs"
    assert "--data list.json --operators orb,fast-brief --matcher orb=nearest" in result.command
    tables = {table.name: table for table in result.tables}
    assert list(tables) == [
        *("poses", "auc", "pose-pairs", "homographies", "homography-auc", "matching-accuracy"),
        *("homography-pairs", "seconds", "failed"),
    ]
    for name in tables:
        assert (out / f"{name}.csv").read_text().count("\n") == 1 + len(tables[name].rows)
    assert [row[0] for row in tables["poses"].rows] == list(SETS)
    assert "mean of max(0, 1 - e/T)" in done.output
    page = write_report(tmp_path).read_text()
    assert "trapezoidal AUC (SuperGlue)" in page


def made_up(rotation: float | None, translation: float | None, k: int) -> dict:
    error = None if rotation is None else max(rotation, translation)
    return {
        **{"kind": RESULT, "dataset": "d", "sequence": "s", "pair": str(k), "digest": str(k)},
        **{"problem": "two-view", "has_truth": True, "operator": "orb", "seed": 0, "matches": 9},
        **{"rotation_deg": rotation, "translation_deg": translation, "error": error},
        **{"refused": rotation is None, "verdict": "general", "inliers": 9, "points": 7},
        "seconds": {"detect": 1.0},
    }


def test_shares_and_areas_have_their_closed_form():
    """Errors 2, 4, 178 and infinite; the third is 2 when the sign of t is ignored."""
    errors = [(1.0, 2.0), (4.0, 3.0), (1.0, 178.0), (None, None)]
    result = pairs_result([made_up(*e, k) for k, e in enumerate(errors)], "command")
    tables = {table.name: table for table in result.tables}
    poses = tables["poses"]
    (line,) = (dict(zip([c.name for c in poses.columns], row)) for row in poses.rows)
    assert line["refused"] == 1
    assert line["rotation error, degrees"] == 2.5
    assert line["translation error, degrees"] == 90.5
    assert line["solved within 5 degrees"] == line["solved within 10 degrees"] == 0.5
    mean, trapezoidal = (row[2:] for row in tables["auc"].rows)
    assert mean == pytest.approx(
        [0, (3 / 5 + 1 / 5) / 4, (0.8 + 0.6) / 4, (0.9 + 0.8) / 4], abs=1e-12
    )
    # The curve (0, 0), (2, 1/4), (2, 1/2), (4, 3/4), (T, 3/4); no error is below 1.
    areas = [(1 / 4 + (1 / 2 + 3 / 4) + (t - 4) * 3 / 4) / t for t in (5, 10, 20)]
    assert trapezoidal == pytest.approx([0, *areas], abs=1e-12)
    assert pose_error(1.0, math.nan) == math.inf


def test_bad_input_is_refused_before_anything_is_written(listed, tmp_path):
    out = tmp_path / "out"
    for wrong, message in (
        ({"operators": ("no-such",)}, "unknown operator"),
        ({"operators": ()}, "at least one operator"),
        ({"matchers": "no-such"}, "unknown matcher"),
        ({"matchers": {"surf": "nearest"}}, "not used: surf"),
        ({"backend": "no-such"}, "unknown estimator"),
        ({"preset": "no-such"}, "unknown preset"),
        ({"seeds": 0}, "at least 1"),
        ({"data": []}, "no pairs"),
        ({"data": [tmp_path / "none.json"]}, "no file or folder"),
    ):
        with pytest.raises(InputError, match=message):
            bench_pairs(**{"data": [listed], "out": out, "operators": ("orb",)} | wrong)
    entries = json.loads(listed.read_text())
    entries[2]["R"] = [[1, 0], [0, 1]]
    listed.write_text(json.dumps(entries))
    with pytest.raises(InputError, match=r"list.json, pair 3: R: must hold 3 x 3 numbers"):
        bench_pairs([listed], out, operators=("orb",))
    assert not out.exists()


@pytest.mark.slow
def test_all_kinds_of_plugins_run(site, tmp_path):
    root, out = write_example(tmp_path / "images"), tmp_path / "out"
    corners = f"{MODULE}.features:corners"
    with on_path(site):
        command = ["pairs", "--data", "example-pairs", "--root", str(root), "--out", str(out)]
        command += ["--operators", "example-corners,orb", "--backend", "example-estimator"]
        command += ["--matcher", "example-corners=example-matcher"]
        done = CliRunner().invoke(bench, command, catch_exceptions=False)
        assert done.exit_code == 0
        by_path = bench_pairs(
            [f"{MODULE}.data:read_pairs"],
            tmp_path / "out2",
            root=root,
            operators=(corners, "orb"),
            matchers={corners: f"{MODULE}.features:one_way"},
            backend=f"{MODULE}.estimation:estimate",
        )
        command = [str(root / name) for name in ("img1.png", "img2.png")]
        command += ["--intrinsics", "200,200,99.5,79.5", "--operators", f"{corners},orb"]
        command += ["--matcher", f"{corners}=example-matcher", "--backend", "example-estimator"]
        command += ["--no-rrd", "--json", "--out", str(tmp_path / "reconstruction")]
        rebuilt = CliRunner().invoke(reconstruct_command, command, catch_exceptions=False)
    settings, *rows = map(json.loads, (out / "rows.jsonl").read_text().splitlines())
    assert len(rows) == 2 * 3
    assert {row["dataset"] for row in rows} == {"example"}
    assert all(row["matches"] > 50 for row in rows)
    plugins = settings["settings"]["plugins"]
    named = {
        kind: {n for n in used if "sha256:" in plugins[kind][n]} for kind, used in plugins.items()
    }
    assert named == {
        "operators": {"example-corners"},
        "matchers": {"example-matcher"},
        "estimators": {"example-estimator"},
    }
    assert [row["error"] for row in by_path] == [row["error"] for row in rows]
    plugins = json.loads(rebuilt.stdout)["plugins"]
    assert "sha256:" in plugins["operators"][corners]
    assert "sha256:" in plugins["matchers"]["example-matcher"]
    assert "sha256:" in plugins["estimators"]["example-estimator"]


def test_a_plugin_that_fails_fails_its_sets_only(listed, tmp_path, monkeypatch):
    (tmp_path / "broken_operator.py").write_text(
        "def find(image):\n    raise RuntimeError('out of order')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    rows = bench_pairs([listed], tmp_path / "out", operators=("orb", "broken_operator:find"))
    rows = chosen(rows, pair="1-2")
    assert [row["kind"] for row in rows] == [RESULT, FAILED, FAILED]
    assert all("out of order" in row["reason"] for row in rows[1:])
