"""``sfmkit ablate report``: which operators help, in words, tables and plots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .parsing import POSITIVE


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder to write.  [default: report in FOLDER, if there is one FOLDER]",
)
@click.option(
    "--threshold-px",
    type=POSITIVE,
    metavar="PX",
    help="Compare homographies by the area up to this error.  [default: 5]",
)
@click.option(
    "--threshold-deg",
    type=POSITIVE,
    metavar="DEG",
    help="Compare poses by the area up to this error.  [default: 5]",
)
@click.option(
    "--units",
    type=click.Choice(["auto", "scene", "pair"]),
    default="auto",
    show_default=True,
    help="What intervals and tests take as independent; auto: scenes if there are at least five.",
)
@click.option(
    "--worst",
    type=click.IntRange(1, 20),
    metavar="N",
    help="Also record the N worst cases in worst.rrd beside the folder of the report.",
)
@click.option(
    "--of",
    "combination",
    metavar="A/B",
    help="The worst cases of this combination; default: of each data set's best.",
)
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def report(
    folders: tuple[Path, ...],
    out: Path | None,
    threshold_px: float | None,
    threshold_deg: float | None,
    units: Any,
    worst: int | None,
    combination: str | None,
    quiet: bool,
) -> None:
    """Evaluate the sweeps in FOLDERS: a page for any browser, tables and plots.

    Which combination is best on each data set, is the difference significant, what does each
    operator contribute, and what does it cost? Several FOLDERS are sweeps of other data sets or
    shards of one sweep. Tables are written as CSV, Markdown and LaTeX.
    """
    from ..ablation.report.write import write_report
    from ..errors import InputError
    from .progress import progress

    if combination and worst is None:
        raise InputError("--of needs --worst N, the number of cases to record")
    with progress(enabled=not quiet) as say:
        made = write_report(
            folders,
            out,
            threshold_px=threshold_px,
            threshold_deg=threshold_deg,
            units=units,
            say=say,
        )
    if not quiet:
        for section in made.sections:
            click.echo(f"\n{section.title}")
            for answer in section.answers:
                click.echo(f"  {answer}")
        click.echo(f"\n{made.page}, and {len(made.files) - 1} tables and plots beside it")
    if worst is not None:
        from ..ablation.report.worst import choose_worst
        from ..ablation.report.worst_recording import save_worst

        with progress(enabled=not quiet) as say:
            path = made.page.parents[1] / "worst.rrd"
            cases = choose_worst(folders, made.findings, worst, combination)
            save_worst(path, cases, say)
        if not quiet:
            click.echo(f"{path}: {len(cases)} cases; sfmkit view {path}")
