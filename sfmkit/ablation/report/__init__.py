"""The report of an ablation: statistics, tables, figures, page."""

from __future__ import annotations

from .write import Report, write_report

__all__ = ["Report", "write_report"]
