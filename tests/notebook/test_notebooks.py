"""The notebooks: stored without outputs, short, executable without a network, with solutions."""

from __future__ import annotations

import ast
import re
import resource
import runpy
import time
from pathlib import Path

import nbformat
import pytest

from sfmkit import teaching
from sfmkit.teaching import checking
from sfmkit.teaching.exercises import EXERCISES

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SOLUTIONS = sorted((FOLDER / "solutions").glob("*.py"))
SECONDS_PER_CELL = 180  # on a busy machine
SECONDS = 60  # for one notebook on two idle cores
WIDEST = 140  # characters of a line of code; a cell shows about a hundred


def last_statement_shows(source: str) -> bool:
    """Whether a cell ends with an expression or prints, so that it must have an output."""
    code = "\n".join("" if line.startswith("%") else line for line in source.splitlines())
    body = ast.parse(code).body
    return bool(body) and (isinstance(body[-1], ast.Expr) or "print(" in code)


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request):
    return nbformat.read(request.param, as_version=4)


def test_there_are_notebooks():
    assert NOTEBOOKS
    assert [p.stem for p in SOLUTIONS] == [p.stem for p in NOTEBOOKS]


def test_a_notebook_has_no_outputs_is_short_and_lists_its_goals(notebook):
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code), (
        "strip the outputs before committing"
    )
    assert not any("widgets" in key for key in notebook.metadata)
    assert max(len(line) for cell in code for line in cell.source.splitlines()) <= WIDEST
    assert len(notebook.cells) <= 30
    assert len(code) <= 25
    assert "After this notebook you can" in notebook.cells[0].source
    ids = [cell.id for cell in notebook.cells]
    assert len(set(ids)) == len(ids)
    text = "\n".join(cell.source for cell in notebook.cells)
    assert 3 <= len(re.findall(r"check\(\"", text)) <= 5
    assert "## Exercises" in text


@pytest.mark.parametrize("path", SOLUTIONS, ids=lambda path: path.stem)
def test_the_solutions_pass_every_exercise_of_their_notebook(path, monkeypatch):
    solved = {}
    monkeypatch.setattr(
        teaching, "check", lambda name, answer: solved.update({name: checking.judge(name, answer)})
    )
    runpy.run_path(str(path))
    assert list(solved) == [name for name in EXERCISES if name.startswith(path.stem[:2])]
    assert all(judgement.right for judgement in solved.values())
    asked = nbformat.read(FOLDER / f"{path.stem}.ipynb", as_version=4)
    assert re.findall(r"check\(\"(.*?)\"", "\n".join(c.source for c in asked.cells)) == list(solved)


def test_functions_have_the_same_signature_in_question_notebook_and_solution(notebook):
    text = "\n".join(cell.source for cell in notebook.cells)
    number = notebook.cells[0].id[:2]
    solution = (FOLDER / "solutions" / f"{_stem(number)}.py").read_text()
    for name in (n for n in EXERCISES if n.startswith(number)):
        if signature := re.match(r"\w+\([^)]*\)(?=: )", EXERCISES[name].question):
            assert f"def {signature[0]}:" in text, f"{name} in the notebook"
            assert f"def {signature[0]}:" in solution, f"{name} in the solution"
            assert f"`{signature[0]}`" in text, f"{name} in the list of exercises"


def _stem(number: str) -> str:
    return next(path.stem for path in NOTEBOOKS if path.stem.startswith(number))


def real_data(notebook) -> bool:
    return any("lesson_" in cell.source for cell in notebook.cells)


def without_data(monkeypatch, empty: Path) -> None:
    """Hide the real photographs and the cache, and block the network."""
    monkeypatch.delenv("SFMKIT_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(empty))
    for variable in ("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"):
        monkeypatch.setenv(variable, "http://127.0.0.1:9")
    monkeypatch.setenv("RERUN_NOTEBOOK_ASSET", "serve-local")


def run(notebook) -> float:
    """Run a notebook and return the smaller of the wall-clock and the processor seconds.

    On an idle machine the wall clock is smaller. On a busy machine it measures the other programs,
    so the processor time is used.
    """
    from nbclient import NotebookClient

    def used() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return children.ru_utime + children.ru_stime

    start, before = time.perf_counter(), used()
    NotebookClient(
        notebook, timeout=SECONDS_PER_CELL, resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    return min(time.perf_counter() - start, used() - before)


def assert_every_cell_has_its_output(notebook) -> None:
    for cell in notebook.cells:
        if cell.cell_type != "code":
            continue
        assert not any(out.output_type == "error" for out in cell.outputs)
        noise = "".join(out.text for out in cell.outputs if out.get("name") == "stderr")
        assert "Traceback" not in noise
        assert not re.search(r"sfmkit/.*Warning", noise), noise
        if last_statement_shows(cell.source):
            shown = [out for out in cell.outputs if out.output_type != "stream" or out.text.strip()]
            assert shown, f"cell {cell.id} has no output"


@pytest.mark.notebook
@pytest.mark.timeout(600)
def test_a_notebook_runs_from_top_to_bottom(notebook, monkeypatch, tmp_path):
    without_data(monkeypatch, tmp_path)
    assert run(notebook) < SECONDS
    assert_every_cell_has_its_output(notebook)


@pytest.mark.notebook
@pytest.mark.data
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_notebook_runs_on_the_real_photographs(notebook, monkeypatch, tmp_path, data_dir):
    if not real_data(notebook):
        pytest.skip("the notebook does not use photographs of a data set")
    without_data(monkeypatch, tmp_path)
    monkeypatch.setenv("SFMKIT_DATA", str(data_dir))
    assert run(notebook) < SECONDS
    assert_every_cell_has_its_output(notebook)


@pytest.mark.notebook
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["00_quick_start", "04_epipolar_geometry"])
def test_cells_can_be_rerun_in_another_order(name, monkeypatch, tmp_path):
    """After the first cell, the other cells run in reverse order with the same results."""
    without_data(monkeypatch, tmp_path)
    once = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    code = [cell for cell in once.cells if cell.cell_type == "code"]
    again = nbformat.from_dict({**once, "cells": [*code, *code[:0:-1]]})
    for k, cell in enumerate(again.cells):
        again.cells[k] = nbformat.from_dict({**cell, "id": f"{cell.id}-{k}"})
    if name.startswith("00"):
        probe = nbformat.v4.new_code_cell(
            "assert len(result.cloud) == int(result.two_view.inliers.sum())"
        )
        again.cells.append(probe)
    run(again)
    assert_every_cell_has_its_output(again)


@pytest.mark.notebook
def test_a_cell_that_runs_too_early_names_the_missing_variable(monkeypatch, tmp_path):
    from nbclient.exceptions import CellExecutionError

    without_data(monkeypatch, tmp_path)
    notebook = nbformat.read(FOLDER / "00_quick_start.ipynb", as_version=4)
    shown = next(cell for cell in notebook.cells if "result.two_view.verdict" in cell.source)
    notebook.cells = [shown]
    with pytest.raises(CellExecutionError, match="name 'result' is not defined"):
        run(notebook)
