"""``sfmkit pairs``: match and judge the pairs of a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .._utils.writing import check_file, check_free
from .exit_status import OK, UNTRUSTWORTHY
from .folder_options import folder_options, match, print_pairs
from .parsing import parse_shard
from .progress import resumable

if TYPE_CHECKING:
    from ..mapping import MatchedFolder
    from ..mapping.planning import FolderPlan


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
@click.option(
    "--colmap",
    type=click.Path(path_type=Path),
    metavar="FILE.db",
    help="Also write a COLMAP database.",
)
@click.option(
    "--h5",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Also write features.h5, matches.h5 and pairs.txt of hloc.",
)
def pairs(
    out: Path,
    overwrite: bool,
    quiet: bool,
    shard: Any,
    colmap: Path | None,
    h5: Path | None,
    **given: Any,
) -> None:
    """Match and judge the pairs of the photographs in FOLDER and its subfolders.

    Writes pairs.parquet, pairs.csv, pairs.json and graph.png to the folder --out. Detections and
    pairs are cached; run the same command again to resume. Exit status: 0 done, 1 no pair has a
    trustworthy geometry, 2 bad input.
    """
    check_free(out, overwrite)
    _check_hand_over(colmap, h5, overwrite)
    from rich.console import Console

    from .._utils.writing import staged_folder
    from ..ablation.watching import bar

    with resumable(), bar(enabled=not quiet, console=Console(stderr=True)) as watch:
        from ..mapping.pair_outputs import write_pair_files

        matched = match(watch, shard, _check(colmap, h5), **given)
        with staged_folder(out, overwrite) as staged:
            report = write_pair_files(matched, staged)
        _hand_over(matched, colmap, h5, overwrite)
    if not quiet:
        print_pairs(report)
        click.echo(f"written to {out}")
    trusted = any(R is not None for R in matched.table["R11"].to_pylist())
    click.get_current_context().exit(OK if trusted else UNTRUSTWORTHY)


def _check_hand_over(colmap: Path | None, h5: Path | None, overwrite: bool) -> None:
    """Check before the work that the files can be written."""
    from ..errors import OutputError

    if colmap is not None:
        from ..io.colmap.engine import pycolmap_module

        pycolmap_module()
        check_file(colmap)
        if colmap.exists() and not overwrite:
            raise OutputError(f"{colmap} exists; choose another file, or use --overwrite")
    if h5 is not None:
        from .._utils.hdf5 import h5py_module

        h5py_module()
        check_free(h5, overwrite)


def _check(colmap: Path | None, h5: Path | None) -> Callable[[FolderPlan], None]:
    def check(plan: FolderPlan) -> None:
        if colmap is not None:
            from ..mapping.map_outputs import check_cameras

            check_cameras(plan)
        if h5 is not None:
            from ..mapping.hloc import check_names

            check_names(plan.collection)

    return check


def _hand_over(matched: MatchedFolder, colmap: Path | None, h5: Path | None, replace: bool) -> None:
    """Write the files for COLMAP and hloc."""
    if colmap is None and h5 is None:
        return
    from ..mapping.database import write_database
    from ..mapping.hloc import write_hloc
    from ..mapping.keypoint_lists import list_all_keypoints

    lists = list_all_keypoints(matched)
    if colmap is not None:
        write_database(matched, lists, colmap)
    if h5 is not None:
        write_hloc(matched, lists, h5, overwrite=replace)
