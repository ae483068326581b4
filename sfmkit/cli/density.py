"""``sfmkit density``: density of a cloud, and comparison of its edges with the other points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .._utils.writing import check_free
from .clouds import read_cloud
from .parsing import POSITIVE
from .progress import progress

if TYPE_CHECKING:
    from ..evaluation.density_by_operator import DensityReport


@click.command()
@click.argument("cloud", type=click.Path(path_type=Path), metavar="CLOUD.ply")
@click.option(
    "--radius",
    type=POSITIVE,
    metavar="R",
    help="Radius in the unit of the cloud.  [default: 10 x the spacing of the points]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/density"),
    show_default=True,
    help="Folder to write.",
)
@click.option("--overwrite", is_flag=True, help="Replace the folder if it exists.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
def density(
    cloud: Path, radius: float | None, out: Path, overwrite: bool, quiet: bool, as_json: bool
) -> None:
    """Count the neighbours within R of each point of CLOUD.ply.

    The definition is that of CloudCompare: a point is its own neighbour, and points at a distance
    of exactly R count. The command writes density.json, density.ply (coloured, with the counts),
    density.png and histogram.png to the folder --out.
    """
    check_free(out, overwrite)
    with progress(enabled=not quiet and not as_json) as say:
        say("read", str(cloud))
        from ..clouds.density import check_radius
        from ..evaluation.density_by_operator import density_report, write_density

        if radius is not None:
            check_radius(radius)
        report = density_report(read_cloud(cloud), radius, progress=say)
        say("write", str(out))
        write_density(report, out, overwrite=overwrite)
    if as_json:
        import json

        click.echo(json.dumps(report.numbers(), indent=1))
    elif not quiet:
        _print(report, out, given=radius is not None)


def _print(report: DensityReport, out: Path, given: bool) -> None:
    from rich import box
    from rich.table import Table

    from ..clouds.density import default_classes
    from ..clouds.local_shape import NEIGHBOURS
    from ..evaluation.density_by_operator import EDGE_SHARE
    from ..viz.figures import unit_of
    from .summary import wide_console

    console = wide_console()
    n, h, unit = report.density.neighbours, report.histogram, unit_of(report.cloud).strip()
    facts = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    facts.add_row("points", f"{len(n):,}")
    facts.add_row(
        "radius",
        f"{report.density.radius:.4g} {unit or '(unit of the file)'}"
        f"{'' if given else ', ten times the spacing of the points'}",
    )
    facts.add_row(
        "neighbours",
        f"mean {h.mean:.2f}, standard deviation {h.std:.2f}, from {n.min():,} to {n.max():,} "
        "(the point itself included)",
    )
    facts.add_row(
        "histogram",
        f"{h.classes} classes of {h.edges[1] - h.edges[0]:.0f}; "
        f"CloudCompare takes {default_classes(len(n))}",
    )
    per = unit or "unit"
    facts.add_row(
        "surface density",
        f"mean {report.density.surface.mean():.4g} points per squared {per.rstrip('s')}",
    )
    facts.add_row(
        "volume density",
        f"mean {report.density.volume.mean():.4g} points per cubed {per.rstrip('s')}",
    )
    console.print(facts)
    known, of = int(report.shape.known.sum()), len(report.shape.index)
    if report.effects:
        console.print(
            f"\nDensity at edges: the {EDGE_SHARE:.0%} of the points with the largest value of a "
            "feature, compared with the others:"
        )
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for column in ("feature", "Cliff's delta", "95 % interval", ""):
            table.add_column(column, justify="left" if column in ("feature", "") else "right")
        for name, effect in report.effects.items():
            verdict = (
                "denser"
                if effect.low > 0
                else "sparser"
                if effect.high < 0
                else "no difference shown"
            )
            table.add_row(
                name.replace("_", " "),
                f"{effect.delta:+.2f}",
                f"[{effect.low:+.2f}, {effect.high:+.2f}]",
                verdict,
            )
        console.print(table)
    else:
        console.print("\nEdges were not compared: too few points, or too large a radius.")
    console.print(
        f"{known:,} of {of:,} points have the {NEIGHBOURS} neighbours needed for the shape.\n",
        highlight=False,
    )
    console.print(f"{out}: density.json, density.ply, density.png, histogram.png", highlight=False)
