"""`sfmkit map`, ended by signals and resumed: the files of an undisturbed run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet
import pytest
from click.testing import CliRunner
from photograph_folder import K, scene
from small_sweep import InlineEngine

from sfmkit.cli import main

pytest.importorskip("pycolmap")
pytestmark = [
    pytest.mark.peers,
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix", reason="signals of POSIX"),
]

TIMES = ["seconds_match", "seconds_estimate"]
LONGEST_S = 120


def command(folder: Path, cache: Path, out: Path) -> list[str]:
    return [
        *("map", str(folder), "--intrinsics", K, "--operators", "orb,fast-brief"),
        *("--workers", "1", "--cache", str(cache), "--out", str(out), "--quiet"),
    ]


def stopped(arguments: list[str], by: signal.Signals, when) -> int:
    """Start the command, send a signal as soon as a condition holds, and return its status."""
    process = subprocess.Popen([sys.executable, "-m", "sfmkit.cli", *arguments])
    try:
        until = time.monotonic() + LONGEST_S
        while not when() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.005)
        assert process.poll() is None, "it ended before the signal"
        process.send_signal(by)
        return process.wait(LONGEST_S)
    finally:
        process.kill()


def test_a_map_that_was_ended_twice_equals_an_undisturbed_one(tmp_path, monkeypatch):
    """SIGTERM after the first detection, then SIGKILL while the model is written."""
    folder, cache, out = scene(tmp_path / "p"), tmp_path / "cache", tmp_path / "out/map"
    arguments = command(folder, cache, out)
    assert stopped(arguments, signal.SIGTERM, lambda: any(cache.rglob("features/*/*.npz"))) == 143
    assert not out.parent.exists()
    done = len(list(cache.rglob("*.npz")))
    assert 0 < done < 6 + 3  # detections and pairs
    status = stopped(arguments, signal.SIGKILL, lambda: any(out.parent.glob(".*/database.db")))
    assert status == -signal.SIGKILL
    assert not out.exists()
    assert any(out.parent.iterdir())  # hidden, and removed by the next run

    monkeypatch.setattr("sfmkit.ablation.engine_choice.LocalEngine", InlineEngine)
    whole = tmp_path / "whole"
    for wanted in (arguments, command(folder, tmp_path / "other", whole)):
        result = CliRunner().invoke(main, wanted)
        assert result.exit_code == 0, result.output
    assert list(out.parent.iterdir()) == [out]
    names = {p.relative_to(whole) for p in whole.rglob("*") if p.is_file()}
    assert {p.relative_to(out) for p in out.rglob("*") if p.is_file()} == names
    tables = [
        pyarrow.parquet.read_table(f / "pairs.parquet").drop_columns(TIMES) for f in (out, whole)
    ]
    assert tables[0] == tables[1]
    for name in ("sparse/0/points3D.bin", "sparse/0/images.bin", "cloud.ply", "graph.png"):
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
