"""Progress of a command on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import click

from .._utils.progress import Progress, silent
from . import signals

__all__ = ["progress", "resumable"]


@contextmanager
def resumable() -> Iterator[None]:
    """End an interrupted command with a message that it can be resumed."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        message = f"{signals.describe(interrupt)}; run the same command again to resume"
        click.echo(message, err=True)
        sys.exit(signals.status_of(interrupt))


@contextmanager
def progress(enabled: bool) -> Iterator[Progress]:
    """Report progress on standard error.

    Yields:
        The callback: on a terminal it updates one line, otherwise it prints one line per stage.
    """
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
