"""Progress, command line and output of the benchmarks."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from .._utils.progress import Progress
from .progress import resumable

if TYPE_CHECKING:
    from ..reports.result import Result

__all__ = ["command_line", "hand_over", "parts_bar"]


def command_line() -> str:
    """Reconstruct the command line from the options.

    Folders are omitted, because they differ between machines.
    """
    context = click.get_current_context()
    words = context.command_path.replace("\\", "/").rsplit("/", 1)[-1].split()
    for option in context.command.params:
        name = option.name or ""
        if (
            name in ("data", "root", "out")
            or context.get_parameter_source(name) is not ParameterSource.COMMANDLINE
        ):
            continue
        value = context.params[name]
        if name == "shard":
            words += [option.opts[0], "{}/{}".format(*value)]
        elif isinstance(value, bool):
            words.append(option.opts[0] if value else option.secondary_opts[0])
        elif name == "matchers":
            chosen = [f"{k}={v}" for k, v in value.items()] if isinstance(value, dict) else [value]
            words += [word for choice in chosen for word in (option.opts[0], choice)]
        elif name == "sources":
            words += [option.opts[0], ",".join(Path(source).name for source in value)]
        elif getattr(option, "multiple", False):
            words += [word for path in value for word in (option.opts[0], Path(path).name)]
        else:
            words += [option.opts[0], ",".join(value) if isinstance(value, tuple) else str(value)]
    return shlex.join(words)


@contextmanager
def parts_bar(bench: str) -> Iterator[Progress]:
    """Show a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn(bench),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with resumable(), Bars(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=1.0)

        def report(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
            bar.update(task, completed=fraction, description=detail)

        yield report


def hand_over(folder: Path, result: Result) -> None:
    """Write the result of a benchmark into its folder, and print its tables and files."""
    from ..reports.result import write_result
    from .summary import print_result

    files = write_result(folder, result)
    print_result(result)
    figures = [figure.file for figure in result.figures]
    click.echo(f"{folder}: {', '.join([*(file.name for file in files), *figures])}")
