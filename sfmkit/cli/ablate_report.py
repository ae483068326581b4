"""``sfmkit ablate report``: which operators help, in words, tables and plots."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--worst",
    type=click.IntRange(1, 20),
    metavar="N",
    help="Also record the N worst cases, FOLDER/worst.rrd, to see why.",
)
@click.option(
    "--of",
    "combination",
    metavar="A/B",
    help="The worst cases of this combination; default: of each data set's best.",
)
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def report(folder: Path, worst: int | None, combination: str | None, quiet: bool) -> None:
    """Judge the sweep in FOLDER: FOLDER/report/ gets a page to open in any browser, tables and
    plots.

    Which combination is best on each data set, is that real, what does each operator contribute,
    and what is worth its time. Tables are there as CSV, Markdown and LaTeX.
    """
    from ..ablation.report.write import write_report
    from ..errors import InputError
    from .progress import progress

    if combination and worst is None:
        raise InputError("--of says whose worst cases to record; say how many with --worst N")
    with progress(enabled=not quiet) as say:
        made = write_report(folder, say)
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
            cases = choose_worst(folder, made.findings, worst, combination)
            save_worst(path, cases, say)
        if not quiet:
            click.echo(f"{path}: {len(cases)} cases; sfmkit view {path}")
