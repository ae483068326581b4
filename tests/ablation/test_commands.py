"""`sfmkit ablate` and `sfmkit cache` as a user meets them."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from small_sweep import InlineEngine, pairs

from sfmkit.ablation import engine_choice, worker
from sfmkit.cli import main
from sfmkit.datasets import DATASETS


@pytest.fixture
def cli(tmp_path, monkeypatch):
    """The command on two small pairs, which go under the name of a data set."""
    monkeypatch.setattr(engine_choice, "LocalEngine", InlineEngine)
    monkeypatch.setitem(
        DATASETS._registered,
        "oxford",
        lambda root, sequences=None: pairs(tmp_path / "images", 2, 0),
    )
    monkeypatch.setenv("SFMKIT_CACHE", str(tmp_path / "cache"))
    worker._kept.clear()
    runner = CliRunner()

    def call(*args: str):
        return runner.invoke(main, [*args], catch_exceptions=False)

    return call


SWEEP = ("ablate", "--data", "oxford", "--operators", "orb,akaze")


def test_dry_run_then_run_then_dry_run(cli, tmp_path):
    before = cli(*SWEEP, "--dry-run", "--seeds", "2")
    assert before.exit_code == 0
    words = before.output.split()
    assert words[words.index("detections") + 2] == "6"  # three images, two operators
    assert "12 rows" in before.output
    assert not (tmp_path / "out").exists()
    done = cli(*SWEEP, "--seeds", "2", "--out", str(tmp_path / "out"))
    assert done.exit_code == 0, done.output
    assert "12 rows in" in done.output
    assert "orb/akaze" in done.output
    after = cli(*SWEEP, "--dry-run", "--seeds", "2").output.split()
    assert after[after.index("estimates") + 2 : after.index("estimates") + 7 : 2] == [
        "12",
        "12",
        "0",
    ]


def test_cache_stats_verify_clear(cli, tmp_path):
    cli(*SWEEP, "--out", str(tmp_path / "out"), "--quiet")
    stats = cli("cache", "stats").output
    assert [line.split()[:2] for line in stats.splitlines() if "matches" in line] == [
        ["matches", "4"]
    ]
    assert cli("cache", "verify").exit_code == 0
    next((tmp_path / "cache" / "matches").rglob("*.npz")).write_bytes(b"x")
    damaged = cli("cache", "verify")
    assert damaged.exit_code == 2
    assert "1 of 16 results were damaged" in damaged.output
    assert cli("cache", "clear", "--yes").output.startswith("removed 15 results")
    assert "0" in cli("cache", "stats").output.splitlines()[-1].split()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("ablate",), "name the data sets"),
        ((*SWEEP, "--combos", "orb/surf"), "not among --operators"),
        ((*SWEEP, "--vary", "hesian=3", "--dry-run"), "hesian"),
        ((*SWEEP, "--preset", "best"), "unknown preset"),
        (("ablate", "--data", "oxford", "--operators", "orbs"), "Did you mean 'orb'"),
        ((*SWEEP, "--cache-size", "much"), "is not a size"),
        ((*SWEEP, "--ship", "bytes"), "cluster"),
    ],
)
def test_bad_input_ends_with_a_message_and_status_2(cli, tmp_path, args, words):
    result = cli(*args, *(() if args == ("ablate",) else ("--out", str(tmp_path / "out"))))
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())
    assert "Traceback" not in result.output


def test_a_failing_pair_is_said_and_the_status_is_still_0(cli, tmp_path, monkeypatch):
    found = pairs(tmp_path / "images", 2, 0)
    (tmp_path / "images" / "img3.png").write_text("no picture")
    monkeypatch.setitem(DATASETS._registered, "oxford", lambda root, sequences=None: found)
    result = cli(*SWEEP, "--out", str(tmp_path / "out"))
    assert result.exit_code == 0
    assert "text file" in " ".join(result.output.split())
    assert "1 pairs cannot be run" in cli(*SWEEP, "--dry-run").output


def test_ctrl_c_says_how_to_go_on(cli, tmp_path, monkeypatch):
    def interrupt(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(InlineEngine, "next", interrupt)
        result = cli(*SWEEP, "--out", str(tmp_path / "out"))
    assert result.exit_code == 130
    assert "run the same command again to resume" in result.output
    assert cli(*SWEEP, "--out", str(tmp_path / "out"), "--quiet").exit_code == 0
