"""Every command that writes checks its output before it reads anything."""

from __future__ import annotations

import sys

import click
import pytest
from click.testing import CliRunner

from sfmkit.cli import main


def commands(group: click.Group = main, words: tuple[str, ...] = ()) -> dict[str, click.Command]:
    """Every command and subcommand by its words."""
    context, found = click.Context(group), {}
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        found[" ".join((*words, name))] = command
        if isinstance(command, click.Group):
            found |= commands(command, (*words, name))
    return found


# Arguments whose inputs do not exist: an error about them would come after the check of --out.
WRITING = {
    "reconstruct": ["no1.png", "no2.png"],
    "demo": [],
    "density": ["no.ply"],
    "compare": ["no1.ply", "no2.ply"],
    "pairs": ["no-photographs"],
    "map": ["no-photographs"],
    "bench oxford": ["--data", "no-data"],
    "bench fountain": ["--data", "no-data"],
    "bench uav": ["--data", "no-data"],
    "bench pairs": ["--data", "no-pairs.json"],
    "bench pose": ["--data", "no-pairs.json"],
    "bench hpatches": ["--data", "no-data"],
    "bench map": ["--data", "no-data"],
    "bench verdict": ["--data", "no-data"],
    "ablate": ["--data", "no-pairs.json"],
    "ablate merge": ["no-shard"],
    "ablate report": ["no-sweep"],
    "report": ["results"],
    "page": ["results"],
}
COMMANDS = {name for name, c in commands().items() if any("--out" in p.opts for p in c.params)}


def test_every_command_with_an_output_is_tested():
    assert set(WRITING) >= COMMANDS


@pytest.mark.parametrize("name", sorted(COMMANDS & set(WRITING)))
def test_outputs_are_checked_before_the_work(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("precious")
    (tmp_path / "results").mkdir()
    (tmp_path / "results/result.json").write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    bad = {
        "file/below": "is not a folder",
        "a" * 256: "at most 255",
        "a/" * 2500: "too long",
        **({"results": "is a folder"} if name in ("report", "page") else {"file": "is a file"}),
        **({"/proc/no/o": "cannot be written"} if sys.platform == "linux" else {}),
    }
    for out, reason in bad.items():
        done = CliRunner().invoke(main, [*name.split(), *WRITING[name], "--out", out])
        assert done.exit_code == 2, (out, done.output)
        assert reason in done.stderr, (out, done.stderr)
    assert sorted(tmp_path.rglob("*")) == before


def test_the_report_of_a_sweep_and_downloads_check_their_folders(tmp_path, monkeypatch):
    from made_up_sweep import made_up_rows

    from sfmkit.ablation.table import TABLE, table_of
    from sfmkit.ablation.table_file import write_table

    write_table(table_of(made_up_rows(pairs=3, seeds=1)), tmp_path / TABLE)
    (tmp_path / "report").write_text("precious")
    done = CliRunner().invoke(main, ["ablate", "report", str(tmp_path)])
    assert done.exit_code == 2
    assert "report is a file" in done.stderr
    (tmp_path / "data").write_text("precious")
    monkeypatch.setattr("sfmkit.datasets.fetch.download", lambda *_: pytest.fail("downloads"))
    done = CliRunner().invoke(main, ["data", "fetch", "oxford", "--data", str(tmp_path / "data")])
    assert done.exit_code == 2
    assert "is not a folder" in done.stderr
