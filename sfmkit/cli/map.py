"""``sfmkit map``: cameras and points of a folder of photographs."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path
from typing import Any

import click

from .._utils.writing import check_free
from .exit_status import OK, UNTRUSTWORTHY
from .folder_options import folder_options, match, print_pairs
from .progress import resumable


@click.command("map")
@folder_options
@click.option(
    "--mapper",
    type=click.Choice(["incremental", "global"]),
    default="incremental",
    show_default=True,
    help="COLMAP's mapper.",
)
@click.option(
    "--two-view-points",
    is_flag=True,
    help="Keep points that only two photographs show, as for two photographs always.",
)
@click.option(
    "--mapper-threads",
    type=click.IntRange(1, 1024),
    default=1,
    show_default=True,
    metavar="N",
    help="Threads of COLMAP's mapper. With more than one the model varies slightly between runs.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/map"),
    show_default=True,
    help="Folder to write.",
)
def map_command(
    out: Path,
    overwrite: bool,
    quiet: bool,
    mapper: Any,
    two_view_points: bool,
    mapper_threads: int,
    **given: Any,
) -> None:
    """Reconstruct cameras and points of the photographs in FOLDER by COLMAP's mapper.

    The pairs are matched and judged as by `sfmkit pairs`; pycolmap (the extra `peers`) maps them.
    Run the same command again to resume. Exit status: 0 done, 1 no model, 2 bad input.
    """
    from ..io.colmap.engine import pycolmap_module

    check_free(out, overwrite)
    pycolmap_module()  # before the work
    from rich.console import Console

    from ..ablation.run import SweepState
    from ..ablation.watching import bar

    with resumable(), bar(enabled=not quiet, console=Console(stderr=True)) as watch:
        from ..mapping.map_outputs import check_cameras, write_map
        from ..mapping.mapper import MapOptions

        began = time.perf_counter()
        matched = match(watch, check=check_cameras, **given)
        two_view_points = two_view_points or len(matched.plan.collection) == 2
        report = write_map(
            matched,
            out,
            MapOptions(mapper, two_view_points, given["seed"], mapper_threads),
            overwrite=overwrite,
            seconds={"pairs": time.perf_counter() - began},
            command=shlex.join(["sfmkit", *sys.argv[1:]]),
            say=lambda text: watch(SweepState("map", what=text)),
        )
    if not quiet:
        print_pairs(report["pairs"])
        print_map(report)
        click.echo(f"written to {out}; the page is {out / 'report.html'}")
    click.get_current_context().exit(OK if report["model"] else UNTRUSTWORTHY)


def print_map(report: dict[str, Any]) -> None:
    """Print the model and the tracks of every operator."""
    from rich.console import Console
    from rich.table import Table

    model = report["model"]
    if model is None:
        click.echo("no model: the pairs do not connect enough photographs")
        return
    click.echo(
        f"{model['registered']:,} of {model['photographs']:,} photographs registered, "
        f"{model['points']:,} points, {model['track_length']:.2f} photographs per point, mean "
        f"reprojection error {model['reprojection_error_px']:.3f} px"
    )
    table = Table("operator", "points", "alone", "share", "track length", "error, px")
    for column in table.columns[1:]:
        column.justify = "right"
    for name, line in report["operators"].items():
        length, error = line["track_length"], line["error_px"]
        table.add_row(
            name,
            f"{line['points']:,}",
            f"{line['alone']:,}",
            f"{line['share']:.1%}",
            "" if length is None else f"{length:.2f}",
            "" if error is None else f"{error:.3f}",
        )
    Console(width=100).print(table)
