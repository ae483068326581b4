"""``sfmkit cache``: what ablations have stored."""

from __future__ import annotations

import click

CACHE = click.option(
    "--cache",
    metavar="FOLDER|URL",
    help="Folder, or a URL such as s3://bucket/cache; default: SFMKIT_CACHE, or the user's cache.",
)


@click.group()
def cache() -> None:
    """Results of stages that sweeps have cached: how many, whether they are sound, and away with
    them."""


def _open(location: str | None):
    from ..ablation.cache import Cache, default_cache

    return Cache(location or default_cache())


@cache.command()
@CACHE
def stats(cache: str | None) -> None:
    """How many results there are, and how large they are."""
    store = _open(cache)
    found = store.stats()
    click.echo(f"{store.location}")
    for kind, (n, size) in found.kinds.items():
        click.echo(f"  {kind:<10} {n:>9,}  {size / 1e6:>10,.1f} MB")
    click.echo(f"  {'all':<10} {found.entries:>9,}  {found.nbytes / 1e6:>10,.1f} MB")


@cache.command()
@CACHE
def verify(cache: str | None) -> None:
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
    click.echo(f"{n:,} results are sound, in {store.location}")


@cache.command()
@CACHE
@click.option("--yes", is_flag=True, help="Do not ask.")
def clear(cache: str | None, yes: bool) -> None:
    """Remove all results. Only time is lost."""
    store = _open(cache)
    found = store.stats()
    if found.entries and not yes:
        click.confirm(
            f"remove {found.entries:,} results, {found.nbytes / 1e6:,.1f} MB, in {store.location}?",
            abort=True,
        )
    store.clear()
    click.echo(f"removed {found.entries:,} results, {found.nbytes / 1e6:,.1f} MB")
