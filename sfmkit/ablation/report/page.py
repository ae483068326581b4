"""The report of an ablation as one self-contained HTML page with sortable tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from ...reports import page
from ...reports.result import Cell, ResultFigure, ResultTable


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        title: its heading.
        answers: sentences, shown at the top of the page.
        tables, figures: shown below; tables whose name is in `folded` are collapsed at first.
    """

    title: str
    answers: tuple[str, ...] = ()
    tables: tuple[ResultTable, ...] = ()
    figures: tuple[ResultFigure, ...] = ()
    folded: frozenset[str] = frozenset()


def ablation_page(
    title: str,
    lead: str,
    sections: Sequence[Section],
    notes: Sequence[str],
    facts: Mapping[str, str],
    folder: Path,
) -> str:
    """Make the page.

    Args:
        title: the title.
        lead: one paragraph below the title.
        sections: the parts.
        notes: how to read the page.
        facts: name -> value, shown at the end.
        folder: the folder of the figures, which are embedded in the page.
    """
    words = "".join(page.heading(s.title) + _list(s.answers) for s in sections if s.answers)
    parts = [
        ("The answers", words),
        *((s.title, _section(s, folder)) for s in sections),
        ("How to read this", page.paragraphs(notes)),
        ("Circumstances", page.facts(facts.items())),
    ]
    return page.page(title, [lead], parts, style=_STYLE, script=_SCRIPT)


def _list(answers: Sequence[str]) -> str:
    return '<ul class="answers">' + "".join(f"<li>{escape(a)}</li>" for a in answers) + "</ul>"


def _section(section: Section, folder: Path) -> str:
    drawn = [page.figure(f.title, folder / f.file, f.alt) for f in section.figures]
    listed = [sortable(t, folded=t.name in section.folded) for t in section.tables]
    return "".join([*drawn[:1], *listed, *drawn[1:]])


def sortable(t: ResultTable, folded: bool = False) -> str:
    """Make a table with headings that sort it; a folded one is collapsed at first."""
    heads = "".join(
        f'<th scope="col" aria-sort="none"{_right(c.right)}>'
        f'<button type="button">{_breaking(c.name)}</button></th>'
        for c in t.columns
    )
    rows = "".join(
        "<tr>"
        + "".join(_cell(v, text, c.right) for v, text, c in zip(row, shown, t.columns))
        + "</tr>"
        for row, shown in zip(t.rows, t.shown())
    )
    box = (
        f'<div class="wide" role="region" tabindex="0" aria-label="{escape(t.title)}">'
        f'<table id="{t.name}">'
        f"<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
        f"{page.paragraphs([t.note], 'note')}"
    )
    if not folded:
        return page.heading(t.title) + box
    return f"<details><summary>{escape(t.title)} ({len(t.rows):,} rows)</summary>{box}</details>"


def _cell(value: Cell, text: str, right: bool) -> str:
    key = f' data-value="{value!r}"' if isinstance(value, (int, float)) and text else ""
    return f"<td{_right(right)}{key}>{_breaking(text)}</td>"


def _right(right: bool) -> str:
    return ' class="right"' if right else ""


def _breaking(text: str) -> str:
    """Names of combinations may break after a slash."""
    return escape(text).replace("/", "/<wbr>")


_STYLE = """
.answers { max-width: 56rem; padding-left: 1.2rem; }
.answers li { margin: .3rem 0; overflow-wrap: anywhere; }
.answers li:first-child { font-weight: 600; }
#the-answers, #the-answers h2 { border: 0; margin-top: .5rem; }
th:first-child, td:first-child { position: sticky; left: 0; background: var(--paper);
  white-space: normal; min-width: 8rem; }
@media (min-width: 60rem) { th:first-child, td:first-child { min-width: 13rem; } }
table { font-size: .82rem; border-collapse: separate; border-spacing: 0; }
th, td { padding: .26rem .45rem; }
nav ul { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; list-style: none; padding: 0; }
tbody tr:hover td { background: var(--band); }
th button { all: unset; cursor: pointer; display: block; width: 100%; font-weight: 600; }
th button:focus-visible { outline: 2px solid var(--link); outline-offset: 2px; }
th button:hover { color: var(--link); }
th button::after { content: "\\00a0\\2195"; color: var(--soft); font-weight: 400; }
th[aria-sort=ascending] button::after { content: "\\00a0\\2191"; color: var(--link); }
th[aria-sort=descending] button::after { content: "\\00a0\\2193"; color: var(--link); }
figure { overflow-x: auto; } figure img { width: 100%; min-width: 30rem; max-width: 52rem; }
summary { cursor: pointer; font-weight: 600; padding: .4rem 0; color: var(--link); }
@media (max-width: 30rem) { table { font-size: .8rem; } th, td { padding: .2rem .35rem; } }
@media print { body { font-size: 9.5pt; } nav { display: none; }
  table { font-size: 6.6pt; min-width: 0; } th, td { padding: .1rem .22rem; }
  td { white-space: normal; } th button::after { content: "" !important; }
  figure img { min-width: 0; max-width: 15cm; } figure, tr { break-inside: avoid; }
  h2, h3 { break-after: avoid; } }
"""

# The first click on a column of numbers puts the largest first, on one of text the first of the
# alphabet; the next turns it round. Empty cells stay last. What looks like a number, or starts with
# one (an interval), is sorted as one.
_SCRIPT = """
'use strict';
function key(cell){
  const given=cell.dataset.value;
  const text=(given!==undefined?given:cell.textContent).trim().replace(/\\u2212/g,'-');
  if(text==='')return null;
  const finite=text.replace(/,/g,'');
  const number=/^[-+]?(\\d|inf)/.test(text)?(text==='inf'?Infinity:parseFloat(finite)):NaN;
  return Number.isNaN(number)?text.toLowerCase():number;
}
function compare(a,b){
  if(typeof a===typeof b)return a<b?-1:a>b?1:0;
  return typeof a==='number'?-1:1;
}
for(const button of document.querySelectorAll('th button'))button.addEventListener('click',()=>{
  const head=button.parentElement, body=head.closest('table').tBodies[0], column=head.cellIndex;
  const rows=[...body.rows].map(row=>[key(row.cells[column]),row]);
  const numbers=rows.some(([k])=>typeof k==='number');
  const before=head.getAttribute('aria-sort');
  const up=before==='none'?!numbers:before==='descending';
  for(const other of head.parentElement.cells)other.setAttribute('aria-sort','none');
  head.setAttribute('aria-sort',up?'ascending':'descending');
  const full=rows.filter(([k])=>k!==null).sort((a,b)=>up?compare(a[0],b[0]):compare(b[0],a[0]));
  body.append(...full.concat(rows.filter(([k])=>k===null)).map(([,row])=>row));
});
addEventListener('beforeprint',()=>{
  for(const d of document.querySelectorAll('details'))d.open=true;
});
"""
