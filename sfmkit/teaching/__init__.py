"""Exercises of the notebooks, and the function ``check`` that grades the answers."""

from .checking import check

__all__ = ["check"]
