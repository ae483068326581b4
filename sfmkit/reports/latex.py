"""Tables for papers: LaTeX with the package booktabs."""

from __future__ import annotations

from .result import MINUS, ResultTable

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "°": r"\textdegree{}",
    "×": r"$\times$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "α": r"$\alpha$",
    "χ": r"$\chi$",
    "²": r"$^2$",
    "–": "--",
    MINUS: r"$-$",
}


def escape(text: str) -> str:
    """Escape the special characters of LaTeX.

    The document needs the packages ``fontenc`` with the option T1, and ``textcomp``.
    """
    return "".join(_SPECIAL.get(c, c) for c in " ".join(text.split()))


def latex_table(table: ResultTable) -> str:
    """Make a ``table`` environment with caption and label; it needs the package booktabs."""

    def line(cells: list[str]) -> str:
        return "  " + " & ".join(escape(cell) for cell in cells) + r" \\"

    columns = "".join("r" if c.right else "l" for c in table.columns)
    caption = table.title + (f". {table.note}" if table.note else "")
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            f"  \\caption{{{escape(caption)}}}",
            f"  \\label{{tab:{table.name}}}",
            f"  \\begin{{tabular}}{{{columns}}}",
            r"  \toprule",
            line([c.name for c in table.columns]),
            r"  \midrule",
            *(line(row) for row in table.shown()),
            r"  \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )
