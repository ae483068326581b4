"""The command ``sfmkit``: one module per subcommand, imported when the subcommand runs."""

from .main import main

__all__ = ["main"]
