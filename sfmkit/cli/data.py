"""``sfmkit data``: list, download and verify the public data sets."""

from __future__ import annotations

from pathlib import Path

import click

DATA = click.option(
    "--data",
    type=click.Path(path_type=Path),
    help="Folder of the data sets; default: SFMKIT_DATA, or the user's cache.",
)


@click.group()
def data() -> None:
    """List, download and verify the public data sets."""


@data.command("list")
@DATA
def list_(data: Path | None) -> None:
    """List the data sets and their folders on this machine."""
    from ..datasets.catalog import DATASETS
    from ..datasets.pair import data_root
    from ..errors import InputError

    for spec in DATASETS.values():
        try:
            where = str(data_root(spec.name, data))
        except InputError:
            where = f"not downloaded; about {spec.size_mb} MB"
        click.echo(f"{spec.name:<10} {spec.title}\n{'':<11}{where}")


@data.command()
@click.argument("name")
@DATA
def fetch(name: str, data: Path | None) -> None:
    """Download, verify and unpack the data set NAME. Interrupted downloads are resumed."""
    from ..datasets.catalog import dataset_spec

    spec = dataset_spec(name)
    click.echo(
        f"{spec.title}\n  home:  {spec.home}\n  terms: {spec.terms}\n  cite:  {spec.citation}"
    )
    click.echo(
        f"  about {spec.size_mb} MB" + ("" if spec.pins else "; no checksums are known for it")
    )

    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskID,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    from ..datasets.fetch import fetch as run

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
            if detail not in tasks:
                tasks[detail] = bars.add_task(detail, total=None if fraction is None else 1.0)
            bars.update(tasks[detail], completed=fraction)

        root = run(spec, data, show)
    click.echo(f"{root}: complete")


@data.command()
@click.argument("names", nargs=-1)
@DATA
def verify(names: tuple[str, ...], data: Path | None) -> None:
    """Verify the checksums of data sets (NAMES, or all that are downloaded).

    Exit status 2 if a file is missing or changed.
    """
    from ..datasets import pairs
    from ..datasets.catalog import DATASETS, check_folder, dataset_spec
    from ..datasets.pair import data_root
    from ..errors import InputError

    bad = []
    for spec in [dataset_spec(name) for name in names] or DATASETS.values():
        try:
            root = data_root(spec.name, data)
        except InputError:
            if names:
                raise
            continue
        if spec.pins:
            wrong = check_folder(spec, root)
            click.echo(
                f"{spec.name}: {len(spec.pins) - len(wrong)} of {len(spec.pins)} files as "
                f"pinned, in {root}"
            )
        else:
            wrong = []
            n = sum(1 for _ in pairs(spec.name, data))
            click.echo(f"{spec.name}: {n} pairs are complete; no checksums are known, in {root}")
        bad += [f"{spec.name}/{line}" for line in wrong]
    if bad:
        raise InputError(
            f"{len(bad)} files are missing or changed: "
            + "; ".join(bad[:5])
            + ("; ..." if bad[5:] else "")
        )
