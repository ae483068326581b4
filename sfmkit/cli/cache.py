"""``sfmkit cache``: the cache of ablations."""

from __future__ import annotations

import click

from .work_options import CACHE


@click.group()
def cache() -> None:
    """Inspect, verify and clear the cache of ablations."""


def _open(location: str | None):
    from ..ablation.cache import Cache, default_cache

    return Cache(location or default_cache())


@cache.command()
@CACHE
def stats(cache: str | None) -> None:
    """Print the number and the size of the results."""
    store = _open(cache)
    found = store.stats()
    click.echo(f"{store.location}")
    for kind, (n, size) in found.kinds.items():
        click.echo(f"  {kind:<10} {n:>9,}  {size / 1e6:>10,.1f} MB")
    click.echo(f"  {'all':<10} {found.entries:>9,}  {found.nbytes / 1e6:>10,.1f} MB")


@cache.command()
@CACHE
def verify(cache: str | None) -> None:
    """Verify the checksums of all results.

    Damaged results are removed. Exit status 2 if there were any.
    """
    from ..errors import InputError
    from .progress import progress

    store = _open(cache)
    with progress(enabled=True) as say:
        n, damaged = store.verify(lambda done: say("verify", f"{done:,}"))
    for line in damaged:
        click.echo(line)
    if damaged:
        raise InputError(
            f"{len(damaged)} of {n:,} results were damaged and removed; they are computed again "
            "when needed"
        )
    click.echo(f"{n:,} results are intact, in {store.location}")


@cache.command()
@CACHE
@click.option("--yes", is_flag=True, help="Do not ask.")
def clear(cache: str | None, yes: bool) -> None:
    """Remove all results; they are computed again when needed."""
    store = _open(cache)
    found = store.stats()
    if found.entries and not yes:
        click.confirm(
            f"remove {found.entries:,} results, {found.nbytes / 1e6:,.1f} MB, in {store.location}?",
            abort=True,
        )
    store.clear()
    click.echo(f"removed {found.entries:,} results, {found.nbytes / 1e6:,.1f} MB")
