"""Shards of a sweep, merged: the rows of the sweep without shards."""

from __future__ import annotations

import shutil
import weakref

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from small_sweep import InlineEngine, pairs

from sfmkit.ablation import ablate, engine_choice, merge, read_sweep, read_table, worker
from sfmkit.ablation.merge import merge_shards
from sfmkit.cli import main
from sfmkit.errors import InputError


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    """The sweep on five pairs, whole and in four shards, with a cache for each."""
    home = tmp_path_factory.mktemp("shards")
    found = pairs(home / "images", 4, 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_choice, "LocalEngine", InlineEngine)
        for name, shard in (("whole", None), *((f"{k}", (k, 4)) for k in (1, 2, 3, 4))):
            worker._kept.clear()
            ablate(
                found,
                ["orb", "akaze"],
                seeds=2,
                out=home / name,
                cache=home / f"cache-{name}",
                shard=shard,
            )
    return home


def test_the_merged_shards_equal_the_whole_row_for_row(shards, tmp_path):
    whole = read_table(shards / "whole")
    assert merge_shards([shards / k for k in "3142"], tmp_path / "o") == len(whole)
    assert read_table(tmp_path / "o").results() == whole.results()
    assert pq.ParquetFile(tmp_path / "o/ablation.parquet").num_row_groups == 4
    sweep = read_sweep(tmp_path / "o")
    assert sweep["pairs"] == read_sweep(shards / "whole")["pairs"]
    assert [len(read_sweep(shards / k)["pairs"]) for k in "1234"] == [1, 1, 1, 2]


def test_a_shard_that_is_run_again_changes_nothing(shards, tmp_path, monkeypatch):
    monkeypatch.setattr(engine_choice, "LocalEngine", InlineEngine)
    worker._kept.clear()
    again = tmp_path / "again"
    ablate(
        pairs(shards / "images", 4, 1),
        ["orb", "akaze"],
        seeds=2,
        out=again,
        cache=shards / "cache-2",
        shard=(2, 4),
    )
    merge_shards([shards / "1", again, shards / "3", shards / "4"], tmp_path / "o")
    assert read_table(tmp_path / "o").results() == read_table(shards / "whole").results()


def test_a_shard_that_was_killed_resumes_with_equal_rows(shards, tmp_path, monkeypatch):
    """The first run ends after its first estimate."""
    monkeypatch.setattr(engine_choice, "LocalEngine", InlineEngine)
    worker._kept.clear()

    def stop(state):
        if state.stage == "run" and "estimates" in state.what:
            raise KeyboardInterrupt

    sweep = {"seeds": 2, "out": tmp_path / "4", "cache": tmp_path / "cache", "shard": (4, 4)}
    found = pairs(shards / "images", 4, 1)
    with pytest.raises(KeyboardInterrupt):
        ablate(found, ["orb", "akaze"], **sweep, progress=stop)
    assert not (tmp_path / "4/ablation.parquet").exists()
    ablate(found, ["orb", "akaze"], **sweep)
    merge_shards([*(shards / k for k in "123"), tmp_path / "4"], tmp_path / "o")
    assert read_table(tmp_path / "o").results() == read_table(shards / "whole").results()


def test_merging_holds_the_rows_of_one_shard_at_a_time(shards, tmp_path, monkeypatch):
    held = []

    def read(path):
        table = read_table(path)
        held.append(weakref.ref(table.data))
        alive = [ref for ref in held[:-2] if ref() is not None]  # the writer has the one before
        assert not alive
        return table

    monkeypatch.setattr(merge, "read_table", read)
    merge_shards([shards / k for k in "1234"], tmp_path / "o")
    assert len(held) == 4


def test_missing_doubled_and_unfinished_shards_are_refused(shards, tmp_path):
    with pytest.raises(InputError, match="these are missing: 2, 4"):
        merge_shards([shards / "1", shards / "3"], tmp_path / "o")
    with pytest.raises(InputError, match="are both shard 1 of 4"):
        merge_shards([shards / "1", shards / "1"], tmp_path / "o")
    with pytest.raises(InputError, match="is not a shard"):
        merge_shards([shards / "whole"], tmp_path / "o")
    shutil.copytree(shards / "2", tmp_path / "2")
    (tmp_path / "2/ablation.parquet").unlink()
    done = CliRunner().invoke(
        main,
        [
            "ablate",
            "merge",
            *(str(p) for p in (shards / "1", tmp_path / "2", shards / "3", shards / "4")),
        ]
        + ["--out", str(tmp_path / "o")],
    )
    assert done.exit_code == 2
    assert "completes an interrupted sweep" in done.output
    assert not (tmp_path / "o").exists()
