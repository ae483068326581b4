"""``sfmkit lab``: JupyterLab with the notebooks, on 127.0.0.1 only and without internet."""

from __future__ import annotations

import getpass
import os
import re
import signal
import sys
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

import click

from .._utils import tether
from ..errors import InputError

__all__ = ["lab", "lab_command", "marks_file", "notebook_folder", "runs_as_root"]

HOST = "127.0.0.1"


def notebook_folder(folder: Path | None) -> Path:
    """Find the folder to open.

    It is the given one, or ``notebooks`` beside the package or in the working directory.

    Raises:
        InputError: None of these folders contains a notebook; an installed wheel has none.
    """
    if folder is not None:
        if not folder.is_dir() or not any(folder.glob("*.ipynb")):
            raise InputError(f"{folder} holds no notebooks (*.ipynb)")
        return folder.resolve()
    for place in (Path(__file__).parents[2] / "notebooks", Path.cwd() / "notebooks"):
        if any(place.glob("*.ipynb")):
            return place.resolve()
    raise InputError(
        "there are no notebooks here: an installed sfmkit comes without them. Clone the repository "
        "and run `sfmkit lab` in it, or name their folder: sfmkit lab FOLDER"
    )


def lab_command(
    folder: Path, port: int, browser: bool, student: str | None = None
) -> tuple[list[str], dict[str, str]]:
    """Make the command line of JupyterLab and its environment.

    Args:
        student: Name of the student, whose checks are written to :func:`marks_file`; the solutions
            are hidden. None without a class.
    """
    first = min(folder.glob("*.ipynb"))
    command = [
        sys.executable,
        "-m",
        "jupyterlab",
        f"--ServerApp.root_dir={folder}",
        f"--ServerApp.ip={HOST}",
        f"--ServerApp.port={port}",
        "--ServerApp.log_level=ERROR",
        f"--LabApp.default_url=/lab/tree/{quote(first.name)}",
        "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate",
        "--LabApp.news_url=None",
    ]
    if not browser:
        command.append("--ServerApp.open_browser=False")
    if runs_as_root():
        command.append("--ServerApp.allow_root=True")
    # The parent of labconfig/, whose settings prevent JupyterLab from requesting news.
    settings = os.pathsep.join(
        filter(None, (str(Path(__file__).parent), os.environ.get("JUPYTER_CONFIG_PATH")))
    )
    classroom = {}
    if student is not None:
        from ..teaching.marks import FILE, STUDENT

        hidden = ["__pycache__", "*.pyc", "*.pyo", ".DS_Store", "*~", "solutions"]
        command.append(f"--ContentsManager.hide_globs={hidden!r}")
        classroom = {STUDENT: student, FILE: str(marks_file(folder, student))}
    # rerun reads the variable when it is imported; the kernel then serves the page of the viewer.
    return command, {
        **os.environ,
        **classroom,
        "JUPYTER_CONFIG_PATH": settings,
        "RERUN_NOTEBOOK_ASSET": "serve-local",
    }


def marks_file(folder: Path, student: str) -> Path:
    """Return the file of the student's checks: ``marks-NAME.jsonl`` beside the notebooks.

    Raises:
        InputError: The name has no letter or digit.
    """
    name = re.sub(r"\W+", "-", student).strip("-").lower()
    if not name:
        raise InputError(f"the name {student!r} has no letter or digit")
    return folder / f"marks-{name}.jsonl"


def runs_as_root() -> bool:
    """Return whether the process has root privileges, as in most containers."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


@click.command()
@click.argument("folder", required=False, type=click.Path(path_type=Path))
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8888,
    show_default=True,
    help="Port; the next free one if it is in use.",
)
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open a browser.")
@click.option(
    "--class",
    "student",
    is_flag=False,
    flag_value="",
    metavar="[NAME]",
    help="For a class: hide the solutions, and write every check to the marks file of the student "
    "NAME (default: the login name) beside the notebooks.",
)
def lab(folder: Path | None, port: int, browser: bool, student: str | None) -> None:
    """Open the notebooks in JupyterLab.

    JupyterLab listens on 127.0.0.1 only and needs no internet. FOLDER contains other notebooks than
    those of the project. As root (as in most containers), the notebooks also run as root.
    """
    place = notebook_folder(folder)
    if find_spec("jupyterlab") is None:
        raise InputError(
            "JupyterLab is not installed here; install the extra: pip install 'sfmkit[notebook]'"
        )
    if runs_as_root():
        click.echo(
            "running as root, and so will the notebooks. The page asks for a token and listens on "
            "127.0.0.1 only.",
            err=True,
        )
    if student is not None:
        student = student.strip() or getpass.getuser()
        click.echo(f"the checks of {student} are written to {marks_file(place, student)}")
    command, environment = lab_command(place, port, browser, student)
    if sys.stdin is not None and sys.stdin.isatty():
        signal.signal(signal.SIGINT, lambda *_: None)  # Ctrl-C reaches JupyterLab, which asks
    server = tether.start(command, environment)
    try:
        status = server.wait()
    finally:
        server.end()
    sys.exit(status)
