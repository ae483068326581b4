"""Exercises of the notebooks and the function ``check`` that grades answers."""

from .checking import check

__all__ = ["check"]
