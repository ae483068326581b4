"""``sfmkit report``: the benchmarks' results on one page."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), default=Path("out"))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="The page to write.  [default: report.html in FOLDER]",
)
def report(folder: Path, out: Path | None) -> None:
    """One self-contained HTML page of all results of `sfmkit bench` below FOLDER (default: out)."""
    from ..reports.html import write_report

    path = write_report(folder, out)
    click.echo(
        f"{path}: {path.stat().st_size / 2**20:.1f} MiB, for any browser; no network is needed"
    )
