"""The ``sfmkit`` command: one module per subcommand, imported when it runs."""

from .main import main

__all__ = ["main"]
