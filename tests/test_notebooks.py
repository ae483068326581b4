"""The notebooks: stripped, short, run from top to bottom without the web, every shown cell shows something, and solved."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import nbformat
import pytest

from sfmkit import teaching
from sfmkit.exercises import EXERCISES

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SOLUTIONS = sorted((FOLDER / "solutions").glob("*.py"))
SECONDS_A_CELL = 180  # on a crowded machine; a notebook takes well below a minute on two free cores


def last_statement_shows(source: str) -> bool:
    """Whether a cell ends with an expression, a print or a check: then its output must not be empty."""
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
    assert all(not cell.outputs and cell.execution_count is None for cell in code), "strip the outputs before a commit"
    assert not any("widgets" in key for key in notebook.metadata)
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
    monkeypatch.setattr(teaching, "check", lambda name, answer: solved.update({name: teaching.judge(name, answer)}))
    runpy.run_path(str(path))
    assert list(solved) == [name for name in EXERCISES if name.startswith(path.stem[:2])]
    assert all(judgement.right for judgement in solved.values())
    asked = nbformat.read(FOLDER / f"{path.stem}.ipynb", as_version=4)
    assert re.findall(r"check\(\"(.*?)\"", "\n".join(c.source for c in asked.cells)) == list(solved)


@pytest.mark.notebook
@pytest.mark.timeout(600)
def test_a_notebook_runs_from_top_to_bottom(notebook, monkeypatch):
    from nbclient import NotebookClient

    for variable in ("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"):  # no way to the web
        monkeypatch.setenv(variable, "http://127.0.0.1:9")
    monkeypatch.setenv("RERUN_NOTEBOOK_ASSET", "serve-local")
    NotebookClient(notebook, timeout=SECONDS_A_CELL, resources={"metadata": {"path": str(FOLDER)}}).execute()
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
