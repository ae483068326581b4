"""A class of three made-up students: `sfmkit lab --class`, hints, marks files and their table."""

from __future__ import annotations

import ast
import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sfmkit.cli import lab, main
from sfmkit.errors import InputError
from sfmkit.teaching import check, marks
from sfmkit.teaching.exercises import EXERCISES
from sfmkit.teaching.hints import HINTS

GOOD = {
    "student": "Ada",
    "exercise": "04.1",
    "right": True,
    "answered": True,
    "hint": 0,
    "time": "2026-01-01T10:00:00+00:00",
}


@pytest.fixture
def notebooks(tmp_path) -> Path:
    folder = tmp_path / "notebooks"
    (folder / "solutions").mkdir(parents=True)
    (folder / "00_first.ipynb").write_text("{}")
    return folder


@pytest.fixture
def seat(monkeypatch, notebooks):
    """Start `sfmkit lab --class NAME` and continue with the environment of its kernels."""
    commands = []

    class Ended:
        def wait(self):
            return 0

        def end(self):
            pass

    def start(command, env):
        commands.append(command)
        for name in (marks.STUDENT, marks.FILE):
            if name in env:
                monkeypatch.setenv(name, env[name])
        return Ended()

    monkeypatch.setattr(lab.tether, "start", start)

    def sit(*arguments: str) -> list[str]:
        done = CliRunner().invoke(main, ["lab", str(notebooks), *arguments])
        assert done.exit_code == 0, done.output
        return commands[-1]

    return sit


def line(F, x1):
    return F @ np.append(x1, 1)


def transposed(F, x1):
    return F.T @ np.append(x1, 1)


def test_a_class_of_three_is_merged_to_a_table(seat, notebooks, tmp_path, capsys):
    seat("--class", "Ada Example")
    check("04.1", line)
    check("04.4", 7)
    seat("--class", "Ben")
    check("04.1", transposed)
    check("04.1", transposed, hint=1)
    check("04.1", line)
    check("04.4", 9)
    check("04.4", ...)  # only reads the question, which is not recorded
    seat("--class", "Cleo")
    check("04.4", ..., hint=2)
    check("10.1", lambda p, w, s: 3)
    files = sorted(notebooks.glob("marks-*.jsonl"))
    assert [f.name for f in files] == [
        "marks-ada-example.jsonl",
        "marks-ben.jsonl",
        "marks-cleo.jsonl",
    ]
    assert [len(f.read_text().splitlines()) for f in files] == [2, 4, 2]
    capsys.readouterr()
    copy = tmp_path / "copy.jsonl"  # handed in twice
    copy.write_text(files[1].read_text())
    table = tmp_path / "marks.csv"
    done = CliRunner().invoke(main, ["marks", *map(str, [*files, copy]), "--csv", str(table)])
    assert done.exit_code == 0
    rows = {(r["student"], r["exercise"]): r for r in csv.DictReader(table.open())}
    expected = {
        ("Ada Example", "04.1"): ("True", "1", "0"),
        ("Ada Example", "04.4"): ("True", "1", "0"),
        ("Ben", "04.1"): ("True", "3", "1"),
        ("Ben", "04.4"): ("False", "1", "0"),
        ("Cleo", "04.4"): ("False", "0", "2"),
        ("Cleo", "10.1"): ("False", "1", "0"),
    }
    assert {k: (r["solved"], r["tries"], r["hint"]) for k, r in rows.items()} == expected
    lines = done.output.splitlines()
    assert lines[0].split() == ["student", "04", "10", "solved", "tries", "hints", "minutes"]
    assert lines[1].split()[:6] == ["Ada", "Example", "2", "0", "2", "2"]
    assert lines[2].split()[:6] == ["Ben", "1", "0", "1", "4", "1"]
    assert lines[3].split()[:6] == ["Cleo", "0", "0", "0", "1", "1"]
    assert ["04.1", "2", "2", "2", "1"] in [text.split() for text in lines]


def test_the_solutions_are_hidden_in_a_class_only(seat, notebooks):
    from jupyter_server.services.contents.largefilemanager import LargeFileManager

    def listed(command: list[str]) -> set[str]:
        settings = [a for a in command if a.startswith("--ContentsManager.hide_globs=")]
        options = {"hide_globs": ast.literal_eval(settings[0].split("=", 1)[1])} if settings else {}
        manager = LargeFileManager(root_dir=str(notebooks), **options)
        return {entry["name"] for entry in manager.get("")["content"]}

    assert "solutions" in listed(seat())
    assert listed(seat("--class")) == {"00_first.ipynb"}


def test_without_a_class_nothing_is_recorded(notebooks, monkeypatch):
    monkeypatch.delenv(marks.STUDENT, raising=False)
    check("04.4", 7)
    assert not list(notebooks.glob("marks-*"))


def test_a_check_works_where_the_marks_file_cannot_be_written(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv(marks.STUDENT, "Ada")
    monkeypatch.setenv(marks.FILE, str(tmp_path / "missing" / "marks.jsonl"))
    check("04.4", 7)
    printed = capsys.readouterr().out
    assert "✓" in printed
    assert "was not recorded" in printed


def test_a_name_without_a_letter_is_refused(notebooks):
    done = CliRunner().invoke(main, ["lab", str(notebooks), "--class", "//"])
    assert done.exit_code == 2
    assert "no letter or digit" in done.output


def test_hints_are_printed_up_to_their_level(capsys):
    check("04.1", transposed, hint=2)
    printed = " ".join(capsys.readouterr().out.split())
    assert "hint 1: " + HINTS["04.1"][0] in printed
    assert "hint 2: " + HINTS["04.1"][1] in printed
    check("04.1", line, hint=2)
    assert "hint" not in capsys.readouterr().out
    with pytest.raises(InputError, match="hint is 0, 1 or 2"):
        check("04.1", line, hint=3)


def test_every_exercise_has_two_hints():
    assert list(HINTS) == list(EXERCISES)


@pytest.mark.parametrize(
    "text",
    [
        "not json",
        "[]",
        json.dumps({"student": "Ada"}),
        json.dumps({**GOOD, "right": 1}),
        json.dumps({**GOOD, "time": "2026-01-01T10:00:00"}),
    ],
)
def test_a_line_that_is_not_a_mark_is_refused(tmp_path, text):
    file = tmp_path / "marks.jsonl"
    marks.append_mark(file, "Ada", "04.1", True, True, 0)
    file.write_text(file.read_text() + text + "\n")
    done = CliRunner().invoke(main, ["marks", str(file)])
    assert done.exit_code == 2
    assert "line 2 is not a mark" in done.output


def test_time_runs_from_the_first_check_to_the_first_correct_answer():
    def mark(right: bool, minute: int) -> marks.Mark:
        return marks.Mark("Ada", "04.1", right, True, 0, f"2026-01-01T10:{minute:02}:00+00:00")

    (result,) = marks.results([mark(True, 9), mark(False, 0), mark(True, 6), mark(False, 2)])
    assert (result.tries, result.minutes, result.solved) == (3, 6.0, True)
