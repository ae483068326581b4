"""``sfmkit cache``: what ablations have stored."""

from __future__ import annotations

from pathlib import Path

import click

CACHE = click.option(
    "--cache",
    type=click.Path(path_type=Path),
    help="Folder; default: SFMKIT_CACHE, or the user's cache.",
)


@click.group()
def cache() -> None:
    """Results of stages that sweeps have cached: how many, whether they are sound, and away with
    them."""


def _open(folder: Path | None):
    from ..ablation.cache import Cache, cache_folder

    return Cache(folder or cache_folder())


@cache.command()
@CACHE
def stats(cache: Path | None) -> None:
    """How many results there are, and how large they are."""
    store = _open(cache)
    found = store.stats()
    click.echo(f"{store.folder}")
    for kind, (n, size) in found.kinds.items():
        click.echo(f"  {kind:<10} {n:>9,}  {size / 1e6:>10,.1f} MB")
    click.echo(f"  {'all':<10} {found.entries:>9,}  {found.nbytes / 1e6:>10,.1f} MB")


@cache.command()
@CACHE
def verify(cache: Path | None) -> None:
    """Read every result and compare its checksums. Damaged ones are removed; exit status 2 if there
    were any."""
    from ..errors import InputError
    from .progress import progress

    store = _open(cache)
    with progress(enabled=True) as say:
        n, damaged = store.verify(lambda done: say("verify", f"{done:,}"))
    for line in damaged:
        click.echo(line)
    if damaged:
        raise InputError(
            f"{len(damaged)} of {n:,} results were damaged and are removed; they are made again "
            "when needed"
        )
    click.echo(f"{n:,} results are sound, in {store.folder}")


@cache.command()
@CACHE
@click.option("--yes", is_flag=True, help="Do not ask.")
def clear(cache: Path | None, yes: bool) -> None:
    """Remove all results. Only time is lost."""
    store = _open(cache)
    found = store.stats()
    if found.entries and not yes:
        click.confirm(
            f"remove {found.entries:,} results, {found.nbytes / 1e6:,.1f} MB, in {store.folder}?",
            abort=True,
        )
    store.clear()
    click.echo(f"removed {found.entries:,} results, {found.nbytes / 1e6:,.1f} MB")
