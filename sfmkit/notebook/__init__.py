"""Widgets and embedded viewers for JupyterLab; they need the extra ``notebook``."""

__all__ = ["embedded", "widgets"]
