"""What a command says while it works."""

from __future__ import annotations

from contextlib import contextmanager

import click


@contextmanager
def progress(enabled: bool):
    """A function (stage, detail) that keeps one live line on a terminal, and prints a line a stage elsewhere."""
    if not enabled:
        yield lambda stage, detail: None
        return
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        seen: set[str] = set()

        def say(stage: str, detail: str) -> None:
            if stage not in seen:
                seen.add(stage)
                click.echo(f"{stage} ...", err=True)

        yield say
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    with Progress(SpinnerColumn(), TextColumn("{task.fields[stage]:<12}{task.description}"), TimeElapsedColumn(),
                  console=console, transient=True) as bar:  # fmt: skip
        task = bar.add_task("", total=None, stage="start")
        yield lambda stage, detail: bar.update(task, stage=stage, description=detail)
