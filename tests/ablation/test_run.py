"""A sweep in one process: its rows against the pipeline, and what it does when things go wrong."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from small_sweep import InlineEngine, pairs

from sfmkit.ablation import ablate, engine_choice, read_sweep, read_table, worker
from sfmkit.ablation.folder import SweepFolder, write_sweep
from sfmkit.errors import InputError, OutputError
from sfmkit.pipeline.reconstruction import reconstruct
from sfmkit.pipeline.registration import register

OPERATORS = ("orb", "akaze")
ROWS = 2 * 3  # pairs, combinations
STAGES = {"features": 2 * 3, "matches": 2 * 2}


@pytest.fixture
def engines(monkeypatch) -> list[InlineEngine]:
    """Work is done in this process; the engines that were started."""
    started: list[InlineEngine] = []

    def start(*args) -> InlineEngine:
        started.append(InlineEngine(*args))
        return started[-1]

    monkeypatch.setattr(engine_choice, "LocalEngine", start)
    worker._kept.clear()
    return started


@pytest.fixture
def sweep(tmp_path, engines):
    """ablate(...) on small pairs, in a folder and with a cache of its own."""

    def start(out: str = "out", cache: str = "cache", data=None, **options):
        worker._kept.clear()
        return ablate(
            pairs(tmp_path / "images", 2, 0) if data is None else data,
            options.pop("operators", OPERATORS),
            out=tmp_path / out,
            cache=tmp_path / cache,
            **options,
        )

    return start


def test_rows_are_what_register_and_reconstruct_say(sweep, tmp_path):
    table = sweep(combos="orb,orb/akaze", seeds=2, data=pairs(tmp_path / "images", 1, 1))
    found = {(r["pair"], r["combination"], r["seed"]): r for r in table}
    assert len(found) == len(table) == 2 * 2 * 2
    images = [tmp_path / "images" / f"img{k}.png" for k in (1, 2, 3)]
    direct = register(images[0], images[1], ["akaze", "orb"], seed=1)
    row = found["1-2", "orb/akaze", 1]
    np.testing.assert_array_equal(np.array(row["H"]).reshape(3, 3), direct.H)
    assert row["inliers"] == int(direct.inliers.sum())
    assert row["correspondences"] == len(direct.correspondences)
    assert row["error"] < 1
    camera = pairs(tmp_path / "images", 1, 1)[1].camera1
    view = reconstruct(images[0], images[2], camera, ["orb"], seed=1).two_view
    row = found["1-3", "orb", 1]
    assert row["verdict"] == view.verdict
    assert row["inliers"] == int(view.inliers.sum())
    if view.R is not None:
        torch.testing.assert_close(
            torch.tensor(row["R"], dtype=torch.float64).reshape(3, 3), view.R, rtol=0, atol=0
        )


def test_a_second_run_computes_nothing_and_a_second_folder_neither(sweep, engines):
    first = sweep()
    assert len(engines) == 1
    assert sweep().results() == first.results()
    assert sweep(out="elsewhere").results() == first.results()
    assert len(engines) == 1


def test_more_seeds_compute_only_what_is_new(sweep, engines):
    first = sweep()
    more = sweep(out="more", seeds=2)
    tasks = [t for t, _ in engines[1].done]
    assert {t.kind for t in tasks} == {"estimates"}
    assert {job.seed for t in tasks for job in t.jobs} == {1}
    of_old = more.results().filter(pa.compute.less(more.data["seed"], 1))
    assert of_old.to_pylist() == first.results().to_pylist()


def test_each_image_is_searched_once_and_each_pair_matched_once(sweep, engines):
    sweep()
    kinds = [t.kind for t, _ in engines[0].done]
    assert {kind: kinds.count(kind) for kind in STAGES} == STAGES


def test_without_a_folder_the_table_is_in_memory(sweep, tmp_path, engines):
    table = ablate(pairs(tmp_path / "i", 1, 0), ["orb"], cache=tmp_path / "c")
    assert table.path is None
    assert len(table) == 1


def test_progress_counts_rows_to_the_end(sweep):
    seen = []
    sweep(progress=seen.append)
    ran = [p for p in seen if p.stage == "run"]
    assert [p.done for p in ran] == sorted(p.done for p in ran)
    assert (ran[-1].done, ran[-1].total) == (ROWS, ROWS)
    assert ran[-1].seconds_left == pytest.approx(0, abs=1e-9)
    assert any(p.seconds_left for p in ran)


def test_images_given_as_arrays(tmp_path, engines):
    from dataclasses import replace

    from sfmkit.io.images import read_image

    (pair,) = pairs(tmp_path / "images", 1, 0)
    arrays = replace(pair, image1=read_image(pair.image1).grey, image2=read_image(pair.image2).rgb)
    one, two = (
        ablate([p], ["orb"], out=tmp_path / o, cache=tmp_path / "c")
        for p, o in ((pair, "a"), (arrays, "b"))
    )
    assert one.results() == two.results()
    assert all(Path(i["path"]).is_file() for i in read_sweep(tmp_path / "b")["pairs"][0]["images"])


def test_the_cache_and_the_folder_hold_no_pickle(sweep, tmp_path):
    sweep()
    for file in tmp_path.rglob("*"):
        if file.is_file():
            assert (
                file.suffix in (".npz", ".parquet", ".json", ".png", ".lock", "")
                or file.name == ".lock"
            ), file


# ---- what goes wrong


def test_an_unreadable_image_is_rows_with_the_reason_and_the_others_go_on(sweep, tmp_path):
    whole = sweep(out="whole")
    data = pairs(tmp_path / "images", 2, 0)
    bytes_ = (tmp_path / "images" / "img3.png").read_bytes()
    (tmp_path / "images" / "img3.png").write_bytes(
        bytes_[: len(bytes_) // 2]
    )  # the header is sound
    table = sweep(data=data, out="cut", cache="other")
    bad = [r for r in table if r["status"] == "failed"]
    assert {r["pair"] for r in bad} == {"1-3"}
    assert len(bad) == 3
    assert all("truncated" in r["failure"] for r in bad)
    rest = [r for r in table.results().to_pylist() if r["pair"] != "1-3"]
    assert rest == [r for r in whole.results().to_pylist() if r["pair"] != "1-3"]


def test_an_operator_that_breaks_costs_only_its_combinations(sweep, monkeypatch):
    import sfmkit.ablation.stages as stages

    detect = stages.detect

    def breaks(image, operator, **options):
        if operator == "akaze" and image.path.name == "img3.png":
            raise RuntimeError("akaze\n  broke")
        return detect(image, operator, **options)

    monkeypatch.setattr(stages, "detect", breaks)
    table = sweep()
    bad = [r for r in table if r["status"] == "failed"]
    assert {(r["pair"], "akaze" in r["operators"]) for r in bad} == {("1-3", True)}
    assert {r["failure"] for r in bad} == {"akaze: RuntimeError: akaze broke"}
    assert len(bad) == 2


def test_an_estimate_that_breaks_is_a_row(sweep, monkeypatch):
    import sfmkit.ablation.stages as stages

    register_matches = stages.register_matches

    def breaks(features, *args, **options):
        if set(features) == {"orb", "akaze"} and options["seed"] == 0:
            raise ZeroDivisionError("division by zero")
        return register_matches(features, *args, **options)

    monkeypatch.setattr(stages, "register_matches", breaks)
    table = sweep()
    bad = [(r["pair"], r["combination"], r["seed"]) for r in table if r["status"] == "failed"]
    assert bad == [(pair, "orb/akaze", 0) for pair in ("1-2", "1-3")]


def test_failures_are_not_remembered(sweep, monkeypatch, tmp_path):
    import sfmkit.ablation.stages as stages

    with monkeypatch.context() as broken:
        broken.setattr(stages, "run_matcher", lambda *a, **k: 1 / 0)
        assert {r["status"] for r in sweep(out="bad")} == {"failed"}
    assert {r["status"] for r in sweep(out="good")} == {"ok"}


def test_a_corrupt_cache_entry_is_computed_again_and_reported(sweep, tmp_path):
    first = sweep()
    for kind in ("features", "matches", "estimates"):
        file = sorted((tmp_path / "cache" / kind).glob("*/*.npz"))[0]
        file.write_bytes(file.read_bytes()[:100])
    for file in (tmp_path / "cache" / "estimates").glob("*/*.npz"):
        if file.stat().st_size > 100:
            file.unlink()
    seen = []
    again = sweep(out="again", progress=seen.append)
    assert again.results() == first.results()
    notes = [note for p in seen for note in p.notes]
    assert {note.split()[2].split("/")[0] for note in notes} == {"features", "matches", "estimates"}
    assert all("computed again" in note for note in notes)


def test_a_full_disk_ends_the_sweep_with_a_message_and_what_was_done_stays(
    sweep, tmp_path, monkeypatch, engines
):
    write = Path.write_bytes
    room = [6]

    def write_bytes(self: Path, data: bytes) -> int:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(self, data)

    with monkeypatch.context() as full:
        full.setattr(Path, "write_bytes", write_bytes)
        with pytest.raises(OutputError, match="No space left on device"):
            sweep()
    done = len(list((tmp_path / "cache").rglob("*.npz")))
    assert done == 6
    made = sum(1 for kind in STAGES for _ in (tmp_path / "cache" / kind).rglob("*.npz"))
    table = sweep()
    kinds = [t.kind for t, _ in engines[1].done]
    assert kinds.count("features") + kinds.count("matches") == sum(STAGES.values()) - made
    assert {r["status"] for r in table} == {"ok"}


def test_a_full_disk_under_the_shards(sweep, monkeypatch):
    from sfmkit.ablation import table_file

    def full(*args, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(table_file.pq.ParquetWriter, "write_table", full)
        with pytest.raises(OutputError, match="No space left on device"):
            sweep()
    assert len(sweep()) == ROWS


def test_a_folder_that_holds_another_sweep_is_refused(sweep):
    sweep()
    with pytest.raises(InputError, match="seeds"):
        sweep(seeds=2)
    with pytest.raises(InputError, match="operators"):
        sweep(operators=("orb",))
    with pytest.raises(InputError, match="variants"):
        sweep(preset="paper")


def test_images_that_changed_are_refused(sweep, tmp_path):
    sweep()
    data = pairs(tmp_path / "images", 2, 0)
    (tmp_path / "images" / "img2.png").write_bytes((tmp_path / "images" / "img3.png").read_bytes())
    with pytest.raises(InputError, match="changed"):
        sweep(data=data)


def test_another_version_of_the_code_is_refused(sweep, tmp_path):
    sweep()
    out = tmp_path / "out"
    write_sweep(out, read_sweep(out) | {"engine": "sfmkit 0.0.1", "identity": "x"})
    with pytest.raises(InputError, match=r"made by sfmkit 0\.0\.1"):
        sweep()


def test_a_worker_of_another_version_is_refused(sweep, monkeypatch):
    monkeypatch.setattr(worker, "engine_version", lambda: "sfmkit 0.0.1")
    with pytest.raises(InputError, match=r"runs sfmkit 0\.0\.1.*same version"):
        sweep()


def test_a_second_sweep_in_the_folder_is_refused_while_the_first_runs(sweep, tmp_path):
    with (
        SweepFolder(tmp_path / "out").locked(),
        pytest.raises(InputError, match=f"process {os.getpid()} on"),
    ):
        sweep()
    assert len(sweep()) == ROWS


def test_bad_arguments(sweep, tmp_path):
    with pytest.raises(InputError, match="ship"):
        sweep(ship="pigeon")
    with pytest.raises(InputError, match="cluster"):
        sweep(ship="bytes")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        sweep(out="file")


def test_the_parquet_file_is_the_table(sweep, tmp_path):
    table = sweep()
    assert pq.read_table(tmp_path / "out" / "ablation.parquet") == table.data
    assert read_table(tmp_path / "out").results() == table.results()
