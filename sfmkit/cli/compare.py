"""``sfmkit compare``: registration and comparison of two overlapping point clouds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .._utils.writing import check_free
from ..errors import InputError
from .clouds import read_cloud
from .parsing import POSITIVE, SEED
from .progress import progress

if TYPE_CHECKING:
    import numpy as np

CLOUD = click.Path(path_type=Path)


@click.command()
@click.argument("first", type=CLOUD, metavar="A.ply")
@click.argument("second", type=CLOUD, metavar="B.ply")
@click.option(
    "--radius",
    type=POSITIVE,
    metavar="R",
    help="Radius of the density, in the unit of A.  [default: 10 x the spacing of its points]",
)
@click.option(
    "--pairs",
    type=CLOUD,
    metavar="FILE",
    help="File of corresponding points: lines of two vertex numbers, of A and B, from 0.",
)
@click.option("--seed", type=SEED, default=0, show_default=True)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/compare"),
    show_default=True,
    help="Folder to write.",
)
@click.option("--overwrite", is_flag=True, help="Replace the folder if it exists.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers as JSON.")
def compare(
    first: Path,
    second: Path,
    radius: float | None,
    pairs: Path | None,
    seed: int,
    out: Path,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Register B.ply to A.ply, and compare counts, densities and distances.

    The registration estimates rotation, scale and translation. The command writes compare.json,
    compare.png and second.ply (B in the frame and unit of A) to the folder --out. Exit status 1:
    the alignment is doubtful, as for symmetrical objects and clouds that overlap by less than four
    fifths; give --pairs.
    """
    import sys

    from .exit_status import OK, UNTRUSTWORTHY

    check_free(out, overwrite)
    with progress(enabled=not quiet and not as_json) as say:
        say("read", f"{first}, {second}")
        from ..clouds.comparison import compare as compare_clouds
        from ..clouds.density import check_radius
        from ..reports.comparison import write_comparison

        if radius is not None:
            check_radius(radius)
        rows = None if pairs is None else _read_pairs(pairs)
        found = compare_clouds(
            read_cloud(first),
            read_cloud(second),
            radius=radius,
            pairs=rows,
            seed=seed,
            progress=say,
        )
        say("write", str(out))
        write_comparison(found, out, overwrite=overwrite)
    numbers = found.numbers()
    if as_json:
        import json

        click.echo(json.dumps(numbers, indent=1))
    elif not quiet:
        _print(numbers, out)
    if found.alignment.doubtful:
        click.echo(
            "warning: the alignment may be wrong: another position fits nearly as well, or the "
            "overlap is too small; look at compare.png, and give --pairs",
            err=True,
        )
    sys.exit(UNTRUSTWORTHY if found.alignment.doubtful else OK)


def _read_pairs(path: Path) -> np.ndarray:
    import numpy as np

    try:
        pairs = np.array(
            [
                [int(word) for word in line.split()]
                for line in path.read_text(encoding="utf-8-sig").splitlines()
                if line.strip()
            ]
        )
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(
            f"{path} must hold lines of two whole numbers, a vertex of A and one of B ({error})"
        ) from error
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError(f"{path} must hold lines of two whole numbers, a vertex of A and one of B")
    return pairs


def _print(numbers: dict[str, Any], out: Path) -> None:
    from rich import box
    from rich.table import Table

    from .summary import wide_console

    console = wide_console()
    moved = numbers["alignment"]
    console.print(
        f"B is scaled by {moved['scale']:.6g}; {moved['overlap'][0]:.0%} of A and "
        f"{moved['overlap'][1]:.0%} of B have a partner, at a root mean square distance of "
        f"{moved['residual']:.3g} of A's units."
    )
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("")
    for column in ("A", "B"):
        table.add_column(column, justify="right")
    a, b = numbers["first"], numbers["second"]
    table.add_row("points", *(f"{c['points']:,}" for c in (a, b)))
    table.add_row(
        f"neighbours within {numbers['radius']:.3g}, mean",
        *(f"{c['neighbours']['mean']:.1f}" for c in (a, b)),
    )
    table.add_row("  standard deviation", *(f"{c['neighbours']['std']:.1f}" for c in (a, b)))
    table.add_section()
    for name, key in (("median", "median"), ("95 %", "p95"), ("root mean square", "rms")):
        table.add_row(
            f"distance to the other, {name}", *(f"{c['distance'][key]:.4g}" for c in (a, b))
        )
    table.add_section()
    for name, key in (("median", "median"), ("95 %", "p95"), ("root mean square", "rms")):
        table.add_row(
            f"  of A's extent {numbers['extent']:.4g}, {name}",
            *(f"{c['distance_over_extent'][key]:.3%}" for c in (a, b)),
        )
    console.print(table)
    console.print(f"{out}: compare.json, compare.png, second.ply")
