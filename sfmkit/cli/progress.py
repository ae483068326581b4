"""What a command says while it works."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import click

from .._utils.progress import Progress, silent
from .exit_status import INTERRUPTED


@contextmanager
def goes_on() -> Iterator[None]:
    """Ctrl-C ends work of which nothing is lost, and says so."""
    try:
        yield
    except KeyboardInterrupt:
        click.echo("interrupted; the same command goes on where it stopped", err=True)
        sys.exit(INTERRUPTED)


@contextmanager
def progress(enabled: bool) -> Iterator[Progress]:
    """Show one live line on a terminal, and print one line per stage elsewhere."""
    if not enabled:
        yield silent
        return
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        seen: set[str] = set()

        def say(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
            if stage not in seen:
                seen.add(stage)
                click.echo(f"{stage} ...", err=True)

        yield say
        return
    from rich.progress import Progress as Bars
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    with Bars(
        SpinnerColumn(),
        TextColumn("{task.fields[stage]:<12}{task.description}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as bar:
        task = bar.add_task("", total=None, stage="start")

        def update(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
            bar.update(task, stage=stage, description=detail)

        yield update
