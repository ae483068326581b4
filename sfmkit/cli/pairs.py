"""``sfmkit pairs``: match and judge the pairs of a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .._utils.writing import check_free
from .exit_status import OK, UNTRUSTWORTHY
from .folder_options import folder_options, match, parse_shard, print_pairs
from .progress import resumable


@click.command()
@folder_options
@click.option(
    "--shard",
    callback=parse_shard,
    metavar="I/N",
    help="Only part I of N of the pairs. Run the command without it, with the same cache, to "
    "collect all parts.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/pairs"),
    show_default=True,
    help="Folder to write.",
)
def pairs(out: Path, overwrite: bool, quiet: bool, shard: Any, **given: Any) -> None:
    """Match and judge the pairs of the photographs in FOLDER and its subfolders.

    Writes pairs.parquet, pairs.csv, pairs.json and graph.png to the folder --out. Detections and
    pairs are cached; run the same command again to resume. Exit status: 0 done, 1 no pair has a
    trustworthy geometry, 2 bad input.
    """
    check_free(out, overwrite)
    from rich.console import Console

    from .._utils.writing import staged_folder
    from ..ablation.watching import bar

    with resumable(), bar(enabled=not quiet, console=Console(stderr=True)) as watch:
        from ..mapping.pair_outputs import write_pair_files

        matched, _ = match(watch, shard, **given)
        with staged_folder(out, overwrite) as staged:
            report = write_pair_files(matched, staged)
    if not quiet:
        print_pairs(report)
        click.echo(f"written to {out}")
    trusted = any(R is not None for R in matched.table["R11"].to_pylist())
    click.get_current_context().exit(OK if trusted else UNTRUSTWORTHY)
