"""The command ``sfmkit``.

Large packages are imported only when a command runs, so that ``--help`` is fast.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import click

from .._version import __version__
from ..errors import SfmError
from . import signals, streams
from .crash import describe_crash
from .exit_status import BAD_INPUT, CRASHED, INTERRUPTED, OK

__all__ = ["COMMANDS", "Group", "main"]

# Command -> module in sfmkit.cli, and name in the module.
COMMANDS = {
    "reconstruct": ("reconstruct", "reconstruct"),
    "demo": ("reconstruct", "demo"),
    "operators": ("reconstruct", "operators"),
    "matchers": ("matchers", "matchers"),
    "inspect": ("inspect", "inspect"),
    "view": ("inspect", "view"),
    "page": ("page", "page"),
    "data": ("data", "data"),
    "lab": ("lab", "lab"),
    "marks": ("marks", "marks"),
    "bench": ("bench", "bench"),
    "report": ("report", "report"),
    "density": ("density", "density"),
    "compare": ("compare", "compare"),
    "pairs": ("pairs", "pairs"),
    "map": ("map", "map_command"),
    "ablate": ("ablate", "ablate"),
    "cache": ("cache", "cache"),
}


class Group(click.Group):
    """A group that imports commands lazily, and converts exceptions to exit statuses."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, name = COMMANDS[cmd_name]
        return getattr(import_module(f".{module}", __package__), name)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except SfmError as error:
            click.echo(f"error: {error}", err=True)
            status = BAD_INPUT
        except MemoryError:
            click.echo(
                "error: out of memory; try a smaller --max-size or --budget where there is one",
                err=True,
            )
            status = BAD_INPUT
        except BrokenPipeError:
            status = OK  # the reader of standard output has closed it
        except (KeyboardInterrupt, Exception) as error:
            interrupt = signals.cause_of(error)
            if interrupt is not None:
                click.echo(f"{signals.describe(interrupt)}; nothing was written", err=True)
                status = signals.status_of(interrupt)
            else:
                click.echo(describe_crash(error), err=True)
                status = CRASHED
        ctx.exit(status)

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, **extra)
        with signals.raised_as_exceptions():
            try:
                status = super().main(args, prog_name, complete_var, False, **extra)
            except SystemExit as leaving:
                status = leaving.code
            except click.ClickException as error:
                error.show()
                status = BAD_INPUT
            except click.Abort as abort:
                cause = abort.__cause__
                if isinstance(cause, KeyboardInterrupt):
                    status = signals.status_of(cause)
                else:
                    status = INTERRUPTED
                click.echo("aborted; nothing was changed", err=True)
            status = status if isinstance(status, int) else OK
            if (failure := streams.failure()) is not None:
                reason = failure.strerror or failure
                click.echo(f"error: standard output cannot be written: {reason}", err=True)
                status = BAD_INPUT if status == OK else status
        sys.exit(status)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command as the main program of the process."""
        streams.protect()
        return self.main(*args, **kwargs)


@click.group(
    cls=Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(__version__, prog_name="sfmkit")
def main() -> None:
    """Reconstruct a scene from two photographs, with statistics per feature operator.

    Exit status: 0 done, 1 no trustworthy result, 2 bad input, 70 a fault of sfmkit, 128 + n ended
    by signal n (130 Ctrl-C).
    """


if __name__ == "__main__":
    main()
