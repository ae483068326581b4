"""``sfmkit report``: one page of all results of benchmarks."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["report"]


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), default=Path("out"))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Page to write.  [default: report.html in FOLDER]",
)
def report(folder: Path, out: Path | None) -> None:
    """Write one HTML page of all results of `sfmkit bench` in FOLDER.

    The page is self-contained. FOLDER is "out" by default.
    """
    from ..reports.html import write_report

    path = write_report(folder, out)
    size = path.stat().st_size / 2**20
    click.echo(f"{path}: {size:.1f} MiB, for any browser; no network is needed")
