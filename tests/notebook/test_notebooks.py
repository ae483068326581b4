"""The notebooks: stripped, short, run from top to bottom without the web, every shown cell shows
something, and solved."""

from __future__ import annotations

import ast
import re
import resource
import runpy
import time
from pathlib import Path

import nbformat
import pytest

from sfmkit.teaching import checking
from sfmkit.teaching.exercises import EXERCISES

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SOLUTIONS = sorted((FOLDER / "solutions").glob("*.py"))
SECONDS_A_CELL = 180  # on a crowded machine
SECONDS = 60  # a notebook on two free cores
WIDEST = (
    140  # characters of a line of code; a cell shows a hundred, and only strings may be that long
)


def last_statement_shows(source: str) -> bool:
    """Whether a cell ends with an expression, a print or a check: then its output must not be
    empty."""
    code = "\n".join("" if line.startswith("%") else line for line in source.splitlines())
    body = ast.parse(code).body
    return bool(body) and (isinstance(body[-1], ast.Expr) or "print(" in code)


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request):
    return nbformat.read(request.param, as_version=4)


def test_there_are_notebooks():
    assert NOTEBOOKS
    assert [p.stem for p in SOLUTIONS] == [p.stem for p in NOTEBOOKS]


def test_a_notebook_is_stripped_short_and_says_what_it_teaches(notebook):
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code), (
        "strip the outputs before a commit"
    )
    assert not any("widgets" in key for key in notebook.metadata)
    assert max(len(line) for cell in code for line in cell.source.splitlines()) <= WIDEST
    assert len(notebook.cells) <= 30
    assert len(code) <= 20
    assert "After this notebook you can" in notebook.cells[0].source
    ids = [cell.id for cell in notebook.cells]
    assert len(set(ids)) == len(ids)
    text = "\n".join(cell.source for cell in notebook.cells)
    assert 3 <= len(re.findall(r"check\(\"", text)) <= 5
    assert "## Exercises" in text


@pytest.mark.parametrize("path", SOLUTIONS, ids=lambda path: path.stem)
def test_the_solutions_solve_every_exercise_of_their_notebook(path, monkeypatch):
    solved = {}
    monkeypatch.setattr(
        checking, "check", lambda name, answer: solved.update({name: checking.judge(name, answer)})
    )
    runpy.run_path(str(path))
    assert list(solved) == [name for name in EXERCISES if name.startswith(path.stem[:2])]
    assert all(judgement.right for judgement in solved.values())
    asked = nbformat.read(FOLDER / f"{path.stem}.ipynb", as_version=4)
    assert re.findall(r"check\(\"(.*?)\"", "\n".join(c.source for c in asked.cells)) == list(solved)


def real_data(notebook) -> bool:
    return any("lesson_" in cell.source for cell in notebook.cells)


def without_data(monkeypatch, empty: Path) -> None:
    """No real photographs, no cache, and no way to the web."""
    monkeypatch.delenv("SFMKIT_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(empty))
    for variable in ("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"):
        monkeypatch.setenv(variable, "http://127.0.0.1:9")
    monkeypatch.setenv("RERUN_NOTEBOOK_ASSET", "serve-local")


def run(notebook) -> float:
    """Run it; the smaller of the seconds on the clock and those of processors.

    On a free machine the clock decides. On a crowded one it tells of the crowd: there the
    processors' seconds stand for it, which the notebook would not take longer than on two free
    cores unless it waits.
    """
    from nbclient import NotebookClient

    def used() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return children.ru_utime + children.ru_stime

    start, before = time.perf_counter(), used()
    NotebookClient(
        notebook, timeout=SECONDS_A_CELL, resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    return min(time.perf_counter() - start, used() - before)


def assert_it_shows_what_it_should(notebook) -> None:
    for cell in notebook.cells:
        if cell.cell_type != "code":
            continue
        assert not any(out.output_type == "error" for out in cell.outputs)
        noise = "".join(out.text for out in cell.outputs if out.get("name") == "stderr")
        assert "Traceback" not in noise
        assert not re.search(r"sfmkit/.*Warning", noise), noise
        if last_statement_shows(cell.source):
            shown = [out for out in cell.outputs if out.output_type != "stream" or out.text.strip()]
            assert shown, f"cell {cell.id} shows nothing"


@pytest.mark.notebook
@pytest.mark.timeout(600)
def test_a_notebook_runs_from_top_to_bottom(notebook, monkeypatch, tmp_path):
    without_data(monkeypatch, tmp_path)
    assert run(notebook) < SECONDS
    assert_it_shows_what_it_should(notebook)


@pytest.mark.notebook
@pytest.mark.data
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_notebook_runs_on_the_real_photographs(notebook, monkeypatch, tmp_path, data_dir):
    if not real_data(notebook):
        pytest.skip("it looks at no photographs of a data set")
    without_data(monkeypatch, tmp_path)
    monkeypatch.setenv("SFMKIT_DATA", str(data_dir))
    assert run(notebook) < SECONDS
    assert_it_shows_what_it_should(notebook)


@pytest.mark.notebook
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["00_quick_start", "04_epipolar_geometry"])
def test_cells_may_be_run_again_and_in_another_order(name, monkeypatch, tmp_path):
    """After the first cell, a student goes back and forth: nothing that was computed changes, no
    exercise is spoilt."""
    without_data(monkeypatch, tmp_path)
    once = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    code = [cell for cell in once.cells if cell.cell_type == "code"]
    again = nbformat.from_dict({**once, "cells": [*code, *code[:0:-1]]})
    for k, cell in enumerate(again.cells):
        again.cells[k] = nbformat.from_dict({**cell, "id": f"{cell.id}-{k}"})
    if name.startswith("00"):  # made by one cell, shown by the next
        probe = nbformat.v4.new_code_cell(
            "assert len(result.cloud) == int(result.two_view.inliers.sum())"
        )
        again.cells.append(probe)
    run(again)
    assert_it_shows_what_it_should(again)


@pytest.mark.notebook
def test_a_cell_run_too_early_names_what_is_missing(monkeypatch, tmp_path):
    from nbclient.exceptions import CellExecutionError

    without_data(monkeypatch, tmp_path)
    notebook = nbformat.read(FOLDER / "00_quick_start.ipynb", as_version=4)
    shown = next(cell for cell in notebook.cells if "result.two_view.verdict" in cell.source)
    notebook.cells = [shown]
    with pytest.raises(CellExecutionError, match="name 'result' is not defined"):
        run(notebook)
