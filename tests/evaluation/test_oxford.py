"""The Oxford benchmark on a made-up set, and on a few real pairs."""

from __future__ import annotations

import json
import warnings

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from sfmkit.cli.bench import bench
from sfmkit.errors import InputError
from sfmkit.evaluation.oxford import OURS, bench_oxford
from sfmkit.evaluation.oxford_tables import estimates, sequence_rmse, solved, tables
from sfmkit.evaluation.rows import RowStore
from sfmkit.pipeline.account import ALL
from sfmkit.reports.result import read_result

KEYS = {
    "sequence",
    "pair",
    "operator",
    "recipe",
    "seed",
    "rmse",
    "corner_error_px",
    "matches",
    "inliers",
    "seconds",
}


def textured(seed: int, size=(360, 300)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    layers = [
        cv2.resize(rng.uniform(0, 255, (size[1] // s, size[0] // s)), size) for s in (4, 9, 25)
    ]
    return np.clip(np.mean(layers, axis=0), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def small_set(tmp_path_factory):
    """One sequence of a plane under known homographies; the last image shows something else."""
    root = tmp_path_factory.mktemp("set")
    folder = root / "oxford" / "graf"
    folder.mkdir(parents=True)
    first = textured(0)
    cv2.imwrite(str(folder / "img1.png"), first)
    for k in range(2, 7):
        H = np.array([[1 - 0.02 * k, 0.01 * k, 3], [-0.01 * k, 1, 2], [0, 2e-5 * k, 1]])
        np.savetxt(folder / f"H1to{k}p", H)
        image = textured(9) if k == 6 else cv2.warpPerspective(first, H, (360, 300))
        cv2.imwrite(str(folder / f"img{k}.png"), image)
    return root


def test_rows_are_complete_resumable_and_right(small_set, tmp_path):
    seen = []
    settings = {"data": small_set, "operators": ("orb", "fast-brief"), "seeds": 2, "workers": 1}
    rows = bench_oxford(
        tmp_path, **settings, progress=lambda *a, **k: seen.append((*a, k["fraction"]))
    )
    assert seen[0] == ("oxford", 0.0)
    assert seen[-1] == ("oxford", "graf 1-6", 1.0)
    mine = estimates(rows)
    assert len(mine) == 5 * 3 * 2 * 2  # pairs, operators and all, recipes, seeds
    assert all(row.keys() >= KEYS for row in mine)
    ours = estimates(rows, operator=ALL, recipe=OURS)
    assert all(solved(r) and r["corner_error_px"] < 0.3 for r in ours if r["pair"] != "1-6")
    assert all(r["rmse"] is None and r["inliers"] == 0 for r in ours if r["pair"] == "1-6"), (
        "another scene"
    )
    *_, every, of = sequence_rmse(ours, only_solved=True)
    assert (every, of) == (4, 5)
    assert [row[1] for row in tables(rows)[0].rows] == [
        "floor of the ground truth",
        "multi",
        "orb",
        "fast-brief",
    ]

    # An interrupted run: the last pair is half-written.
    file = tmp_path / "rows.jsonl"
    lines = file.read_text().splitlines(keepends=True)
    keep = [line for line in lines if '"1-6"' not in line]
    file.write_text("".join(keep) + '{"kind": "estim')
    seen.clear()
    again = bench_oxford(
        tmp_path, **settings, progress=lambda *a, **k: seen.append((*a, k["fraction"]))
    )
    assert [s[-1] for s in seen] == [0.8, 1.0]

    def timeless(row):
        return {k: v for k, v in row.items() if not k.endswith("seconds")}

    assert [timeless(r) for r in again] == [timeless(r) for r in rows], (
        "the same seeds give the same rows"
    )
    with pytest.raises(InputError, match="was made with"):
        bench_oxford(tmp_path, **{**settings, "seeds": 3})


def test_bad_settings(small_set, tmp_path):
    with pytest.raises(InputError, match="seeds"):
        bench_oxford(tmp_path, data=small_set, seeds=0)
    with pytest.raises(InputError, match="operator"):
        bench_oxford(tmp_path, data=small_set, operators=())
    with pytest.raises(InputError, match="unknown operator"):
        bench_oxford(tmp_path, data=small_set, operators=("srf",))
    with pytest.raises(InputError, match="no folder"):
        bench_oxford(tmp_path, data=tmp_path / "none")
    (tmp_path / "rows.jsonl").write_text("not json\n")
    with pytest.raises(InputError, match="damaged"):
        RowStore(tmp_path / "rows.jsonl", {}).read()


def test_command_prints_tables_and_draws_figures(small_set, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = CliRunner().invoke(
            bench,
            [
                "oxford",
                "--data",
                str(small_set),
                "--out",
                str(tmp_path),
                "--operators",
                "orb",
                "--seeds",
                "1",
                "--workers",
                "1",
                "--sequences",
                "graf",
            ],
            catch_exceptions=False,
        )
    assert done.exit_code == 0, done.output
    assert "Table 4" in done.output
    assert "14.84" in done.output, "the paper's value for ORB on graf"
    result = read_result(tmp_path)
    assert result.command.endswith("oxford --sequences graf --operators orb --seeds 1 --workers 1")
    assert [table.name for table in result.tables] == ["table-4", "corners", "operators"]
    (figure,) = result.figures
    picture = cv2.imread(str(tmp_path / figure.file))
    assert picture.std() > 10
    assert json.loads((tmp_path / "rows.jsonl").read_text().splitlines()[0])["settings"][
        "operators"
    ] == ["orb"]


@pytest.mark.data
@pytest.mark.slow
def test_fused_solves_what_drowns_plain_ransac(data_dir, tmp_path):
    """Zoom with rotation, twice, and viewpoint: in every seed, and close to the best single
    operator."""
    rows = bench_oxford(tmp_path, data=data_dir, sequences=["bark", "boat", "graf"], seeds=2)
    pairs = {(r["sequence"], r["pair"]) for r in estimates(rows)}
    for sequence, pair in pairs:
        fused = estimates(rows, sequence=sequence, pair=pair, operator=ALL, recipe=OURS)
        if (sequence, pair) == ("graf", "1-6"):
            assert all(r["rmse"] is None for r in fused)
            continue
        assert all(solved(r) for r in fused), (sequence, pair)
        singles = [
            np.median(
                [
                    r["corner_error_px"] or np.inf
                    for r in estimates(rows, sequence=sequence, pair=pair, operator=o, recipe=OURS)
                ]
            )
            for o in ("surf", "orb", "fast-brief")
        ]
        assert np.median([r["corner_error_px"] for r in fused]) <= 1.1 * min(singles) + 0.2, (
            sequence,
            pair,
        )
