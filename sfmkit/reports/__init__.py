"""Results as files: output folders, tables, HTML pages, LaTeX."""

from .html import find_results, write_report
from .inspection import write_inspector
from .latex import latex_table
from .outputs import write_outputs
from .result import Column, Result, ResultFigure, ResultTable, read_result, write_result

__all__ = [
    "Column",
    "Result",
    "ResultFigure",
    "ResultTable",
    "find_results",
    "latex_table",
    "read_result",
    "write_inspector",
    "write_outputs",
    "write_report",
    "write_result",
]
