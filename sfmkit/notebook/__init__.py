"""Widgets and embedded viewers for JupyterLab."""
