"""``sfmkit ablate merge``: the shards of a sweep as one."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("shards", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/ablation"),
    show_default=True,
    help="Folder to write.",
)
@click.option("--overwrite", is_flag=True, help="Replace the folder if it exists.")
def merge(shards: tuple[Path, ...], out: Path, overwrite: bool) -> None:
    """Merge the folders SHARDS of `sfmkit ablate --shard 1/N` to N/N.

    The rows are those of the sweep without shards, in its order.
    """
    from ..ablation.merge import merge_shards
    from ..ablation.table import TABLE

    rows = merge_shards(shards, out, overwrite=overwrite)
    click.echo(f"{rows:,} rows in {out / TABLE}; next: sfmkit ablate report {out}")
