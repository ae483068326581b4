"""The ``sfmkit`` command. Nothing heavy is imported before a command runs, so that ``--help``
answers at once."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

import click

from .._version import __version__
from .exit_status import BAD_INPUT, INTERRUPTED, OK

# command -> module below sfmkit.cli, and its name there
COMMANDS = {
    "reconstruct": ("reconstruct", "reconstruct"),
    "demo": ("reconstruct", "demo"),
    "operators": ("reconstruct", "operators"),
    "inspect": ("inspect", "inspect"),
    "view": ("inspect", "view"),
    "data": ("data", "data"),
    "lab": ("lab", "lab"),
    "bench": ("bench", "bench"),
    "report": ("report", "report"),
    "density": ("density", "density"),
    "compare": ("compare", "compare"),
    "ablate": ("ablate", "ablate"),
    "cache": ("cache", "cache"),
}


class Group(click.Group):
    """A group that imports a command when it is asked for, and ends with a message instead of a
    traceback."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, name = COMMANDS[cmd_name]
        return getattr(import_module(f".{module}", __package__), name)

    def invoke(self, ctx: click.Context) -> Any:
        from ..errors import SfmError

        try:
            return super().invoke(ctx)
        except SfmError as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(BAD_INPUT)
        except BrokenPipeError:
            sys.exit(OK)  # whoever read us has had enough
        except KeyboardInterrupt:
            click.echo("interrupted; nothing was written", err=True)
            sys.exit(INTERRUPTED)


@click.group(
    cls=Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(__version__, prog_name="sfmkit")
def main() -> None:
    """Two photographs in, a coloured 3-D cloud out, and an account of which detector contributed
    what."""


if __name__ == "__main__":
    main()
