"""``sfmkit lab``: JupyterLab on the notebooks, on this machine only and without the web."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import click

from ..errors import InputError

HOST = "127.0.0.1"


def notebook_folder(folder: Path | None) -> Path:
    """The folder to open: the one given, or ``notebooks`` beside the package or below the working directory.

    Raises:
        InputError: none of these holds a notebook, as with a wheel that was installed without the repository.
    """
    if folder is not None:
        if not folder.is_dir() or not any(folder.glob("*.ipynb")):
            raise InputError(f"{folder} holds no notebooks (*.ipynb)")
        return folder.resolve()
    for place in (Path(__file__).parents[2] / "notebooks", Path.cwd() / "notebooks"):
        if any(place.glob("*.ipynb")):
            return place.resolve()
    raise InputError(
        "there are no notebooks here: an installed sfmkit comes without them. Clone the repository and run `sfmkit lab` "
        "in it, or name their folder: sfmkit lab FOLDER"
    )


def lab_command(folder: Path, port: int, browser: bool, allow_root: bool = False) -> tuple[list[str], dict[str, str]]:
    """The command line of JupyterLab and its environment."""
    command = [sys.executable, "-m", "jupyterlab", f"--ServerApp.root_dir={folder}", f"--ServerApp.ip={HOST}",
               f"--ServerApp.port={port}", "--LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate",
               "--LabApp.news_url=None"]  # fmt: skip
    if not browser:
        command.append("--ServerApp.open_browser=False")
    if allow_root:
        command.append("--ServerApp.allow_root=True")
    # The embedded viewer's page is served by the kernel: read when rerun is imported, so it must be there before.
    return command, {**os.environ, "RERUN_NOTEBOOK_ASSET": "serve-local"}


@click.command()
@click.argument("folder", required=False, type=click.Path(path_type=Path))
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8888, show_default=True, help="The next free one if taken."
)
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open a browser on it.")
@click.option("--allow-root", is_flag=True, help="Run as root, which JupyterLab refuses otherwise; for containers.")
def lab(folder: Path | None, port: int, browser: bool, allow_root: bool) -> None:
    """Open the notebooks in JupyterLab; it listens on 127.0.0.1 only and needs no internet.

    FOLDER: other notebooks than the project's own.
    """
    place = notebook_folder(folder)
    if find_spec("jupyterlab") is None:
        raise InputError("JupyterLab is not installed here; install the extra: pip install 'sfmkit[notebook]'")
    command, environment = lab_command(place, port, browser, allow_root)
    sys.exit(subprocess.run(command, env=environment, check=False).returncode)
