"""Exercises of the notebooks, and ``check()`` that grades them."""

from .checking import check

__all__ = ["check"]
