"""JupyterLab is opened on the right folder, on the loopback interface, with the viewer's page
served from here."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from sfmkit.cli import lab, main
from sfmkit.errors import InputError


@pytest.fixture
def started(monkeypatch):
    """What would have been started."""
    calls = []

    class Ended:
        def wait(self):
            return 0

        def end(self):
            pass

    def start(command, env):
        calls.append((command, env))
        return Ended()

    monkeypatch.setattr(lab.tether, "start", start)
    return calls


def test_lab_opens_the_notebooks_on_this_machine_only(started):
    assert CliRunner().invoke(main, ["lab", "--no-browser", "--port", "9001"]).exit_code == 0
    ((command, environment),) = started
    notebooks = Path(__file__).parents[2] / "notebooks"
    assert f"--ServerApp.root_dir={notebooks}" in command
    assert "--ServerApp.ip=127.0.0.1" in command
    assert "--ServerApp.port=9001" in command
    assert "--ServerApp.open_browser=False" in command
    assert environment["RERUN_NOTEBOOK_ASSET"] == "serve-local"
    assert "--LabApp.default_url=/lab/tree/00_quick_start.ipynb" in command


def test_a_folder_of_ones_own(started, tmp_path):
    (tmp_path / "mine.ipynb").write_text("{}")
    assert CliRunner().invoke(main, ["lab", str(tmp_path)]).exit_code == 0
    assert f"--ServerApp.root_dir={tmp_path.resolve()}" in started[0][0]


@pytest.mark.parametrize("root", [True, False])
def test_as_root_it_starts_too_and_says_so(started, monkeypatch, root):
    monkeypatch.setattr(lab, "runs_as_root", lambda: root)
    result = CliRunner().invoke(main, ["lab"])
    assert (
        ("--ServerApp.allow_root=True" in started[0][0])
        == ("running as root" in result.output)
        == root
    )


def test_without_notebooks_it_says_where_to_get_them(started, monkeypatch, tmp_path):
    monkeypatch.setattr(lab, "__file__", str(tmp_path / "site-packages/sfmkit/cli/lab.py"))
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["lab"])
    assert result.exit_code == 2
    assert "Clone the repository" in result.output
    assert not started
    with pytest.raises(InputError, match="holds no notebooks"):
        lab.notebook_folder(tmp_path)


def test_without_jupyterlab_it_says_what_to_install(started, monkeypatch, tmp_path):
    (tmp_path / "mine.ipynb").write_text("{}")
    monkeypatch.setattr(lab, "find_spec", lambda name: None)
    result = CliRunner().invoke(main, ["lab", str(tmp_path)])
    assert result.exit_code == 2
    assert "sfmkit[notebook]" in result.output
