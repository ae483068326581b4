"""``sfmkit page``: a recording as an interactive HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from .parsing import PREFIX

__all__ = ["page"]


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Page to write.  [default: inspect.html beside the recording]",
)
@PREFIX
def page(recording: Path, out: Path | None, prefix: str) -> None:
    """Write an interactive HTML page of a recording (.rrd), or of a folder with one.

    The page is self-contained.

    A click on a keypoint, match or point shows how it was found and what became of it.
    """
    from ..reports.inspection import write_inspector

    path = write_inspector(recording, out, prefix)
    size = path.stat().st_size / 2**20
    click.echo(f"{path}: {size:.1f} MiB, for any browser; no network is needed")
