"""The recording of an ablation's worst cases: the right ones, run again as they were, and drawn
where the arrays say."""

from __future__ import annotations

import shutil

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner

from sfmkit.ablation import ablate, read_sweep, read_table
from sfmkit.ablation.folder import write_sweep
from sfmkit.ablation.report.findings import analyse
from sfmkit.ablation.report.scores import score
from sfmkit.ablation.report.worst import Case, choose_worst, describe, run_again
from sfmkit.ablation.report.worst_recording import save_worst
from sfmkit.ablation.table_file import write_table
from sfmkit.cli import main
from sfmkit.datasets import pairs
from sfmkit.errors import InputError
from sfmkit.recording.read import read_recording

SMALL = (320, 240)


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Two planes and a scene, two operators, by one local worker."""
    out = tmp_path_factory.mktemp("sweep")
    chosen = [*list(pairs("planes", size_wh=SMALL, sequences=["viewpoint"]))[:2]]
    chosen += pairs("synthetic", size_wh=SMALL, sequences=["courtyard"])
    ablate(chosen, ["orb", "fast-brief"], seeds=1, out=out / "out", cache=out / "cache", workers=1)
    return out / "out"


@pytest.fixture(scope="module")
def findings(sweep):
    return [analyse(block) for block in score(read_table(sweep)).blocks]


def test_the_worst_come_first_and_the_best_run_of_their_pair_goes_with_them(sweep, findings):
    cases = choose_worst([sweep], findings, 9, "fast-brief")
    assert len(cases) == 3
    shares = [case.row["error"] / 5 for case in cases]
    assert shares == sorted(shares, reverse=True)
    for case in cases:
        assert case.row["operators"] == ["fast-brief"]
        mine = [
            r
            for r in read_table(sweep)
            if (r["sequence"], r["pair"]) == (case.row["sequence"], case.row["pair"])
        ]
        least = min(r["error"] for r in mine)
        assert case.better is None or case.better["error"] == least
        assert (case.better is None) == (least >= 0.9 * case.row["error"])
    (one,) = choose_worst([sweep], findings, 1)
    best = {f.scores.setups[f.best].operators for f in findings}
    assert tuple(one.row["operators"]) in best


def test_other_combinations_are_refused_by_name(sweep, findings):
    with pytest.raises(
        InputError,
        match=r"no run of this sweep has the combination 'sift'; it has orb, fast-brief, orb/fast",
    ):
        choose_worst([sweep], findings, 1, "sift")
    assert choose_worst([sweep], findings, 1, "fast-brief / orb")[0].row["n_operators"] == 2


def test_a_run_made_again_is_the_same_and_another_is_noticed(sweep, findings):
    for case in choose_worst([sweep], findings, 9, "orb/fast-brief"):
        again = run_again(case, case.row)
        assert again.same
        assert "differs from that of the sweep" not in describe(case, again)
        name = "H" if case.row["H"] is not None else "R"
        moved = dict(case.row) | {name: [v + 0.01 for v in case.row[name]]}
        again = run_again(case, moved)
        assert not again.same
        assert "differs from that of the sweep" in describe(Case(moved, None, case.pair), again)


def test_the_recording_holds_images_matches_and_outlines(sweep, findings, tmp_path):
    cases = choose_worst([sweep], findings, 3, "fast-brief")
    save_worst(tmp_path / "worst.rrd", cases)
    recording = read_recording(tmp_path / "worst.rrd")
    for number, case in enumerate(cases, start=1):
        for run, name in enumerate(("worst", "best")[: len(case.runs)]):
            at = f"/case{number}/{name}"
            assert case.runs[run]["combination"] in recording.text(f"{at}/about")
            assert {f"{at}/matches/photo1", f"{at}/matches/photo2"} <= set(recording.entities)
            (inliers,) = (
                i
                for i in recording.logged(f"{at}/matches/inliers/{case.runs[run]['operators'][-1]}")
                if i.component.endswith("strips")
            )
            assert inliers.times["run"] == run
            assert 0 < len(inliers.values) <= 80
            if case.pair["kind"] == "homography":
                strip = np.array(
                    recording.latest(f"{at}/image2/outline/truth")["LineStrips2D:strips"][0]
                )
                w, h = case.pair["images"][0]["size_wh"]
                corner = np.array(case.pair["H"]) @ [w - 1, h - 1, 1]
                assert np.abs(strip - corner[:2] / corner[2]).sum(1).min() < 1e-2
                assert f"{at}/image2/outline/estimate" in recording
            else:
                assert f"{at}/world/points/operator" in recording


def test_the_command_writes_it_and_says_which_image_is_missing(sweep, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(sweep, copy)
    done = CliRunner().invoke(main, ["ablate", "report", str(copy), "--worst", "1", "--quiet"])
    assert done.exit_code == 0, done.output
    assert 1e4 < (copy / "worst.rrd").stat().st_size < 3e6
    (copy / "worst.rrd").unlink()
    told = read_sweep(copy)
    for pair in told["pairs"]:
        for image in pair["images"]:
            image["path"] = str(tmp_path / "gone.png")
    write_sweep(copy, told)
    done = CliRunner().invoke(main, ["ablate", "report", str(copy), "--worst", "1"])
    assert done.exit_code == 2
    assert "gone.png" in done.output
    assert not (copy / "worst.rrd").exists()


def test_runs_that_broke_cannot_be_shown(sweep, findings, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(sweep, copy)
    table = read_table(copy).data
    column = table.schema.get_field_index("status")
    broken = table.set_column(column, "status", pa.array(["failed"] * len(table)))
    write_table(broken, copy / "ablation.parquet")
    with pytest.raises(InputError, match="no run to show"):
        choose_worst([copy], findings, 1)
