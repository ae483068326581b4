"""The report of an ablation as one self-contained HTML page: nothing is fetched, tables are sorted by a click on a head."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from .result import Cell, ResultFigure, ResultTable


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        title: its head.
        answers: sentences about it, which open the page.
        tables, figures: that follow; tables whose name is in `folded` are closed at first.
    """

    title: str
    answers: tuple[str, ...] = ()
    tables: tuple[ResultTable, ...] = ()
    figures: tuple[ResultFigure, ...] = ()
    folded: frozenset[str] = frozenset()


def page(
    title: str, lead: str, sections: Sequence[Section], notes: Sequence[str], facts: Mapping[str, str], folder: Path
) -> str:
    """The page.

    Args:
        lead: one paragraph below the title.
        notes: how to read it.
        facts: circumstances, a line each.
        folder: where the figures are; they are taken into the page.
    """
    words = "".join(
        f'<h3><a href="#part{k}">{escape(s.title)}</a></h3><ul class="answers">'
        + "".join(f"<li>{escape(a)}</li>" for a in s.answers)
        + "</ul>"
        for k, s in enumerate(sections)
        if s.answers
    )
    body = "".join(_section(s, f"part{k}", folder) for k, s in enumerate(sections))
    terms = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.items())
    paragraphs = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body><main>'
        f"<h1>{escape(title)}</h1><p>{escape(lead)}</p>\n<section><h2>The answers</h2>{words}</section>\n{body}"
        f"<section><h2>How to read this</h2>{paragraphs}</section><section><h2>Circumstances</h2><dl>{terms}</dl></section>"
        f"</main><script>{_SCRIPT}</script></body></html>\n"
    )


def _section(section: Section, anchor: str, folder: Path) -> str:
    parts = [_figure(f, folder) for f in section.figures[:1]]
    parts += [table(t, folded=t.name in section.folded) for t in section.tables]
    parts += [_figure(f, folder) for f in section.figures[1:]]
    return f'<section id="{anchor}"><h2>{escape(section.title)}</h2>{"".join(parts)}</section>\n'


def table(t: ResultTable, folded: bool = False) -> str:
    """A table whose heads are buttons that sort it."""
    heads = "".join(
        f'<th scope="col" aria-sort="none"{_right(c.right)}><button type="button">{_breaking(c.name)}</button></th>'
        for c in t.columns
    )
    rows = "".join(
        "<tr>" + "".join(_cell(v, text, c.right) for v, text, c in zip(row, shown, t.columns)) + "</tr>"
        for row, shown in zip(t.rows, t.shown())
    )
    inside = (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{escape(t.title, quote=True)}"><table id="{t.name}">'
        f"<caption>{escape(t.title)}</caption><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"
        f'<p class="note">{escape(t.note)}</p>'
    )
    if not folded:
        return inside
    return f"<details><summary>{escape(t.title)} ({len(t.rows):,} rows)</summary>{inside}</details>"


def _cell(value: Cell, text: str, right: bool) -> str:
    key = f' data-value="{value!r}"' if isinstance(value, (int, float)) and text else ""
    return f"<td{_right(right)}{key}>{_breaking(text)}</td>"


def _right(right: bool) -> str:
    return ' class="right"' if right else ""


def _breaking(text: str) -> str:
    """Names of combinations may break after a slash."""
    return escape(text).replace("/", "/<wbr>")


def _figure(f: ResultFigure, folder: Path) -> str:
    data = base64.b64encode((folder / f.file).read_bytes()).decode()
    return (
        f'<figure><div class="scroll" role="region" tabindex="0" aria-label="{escape(f.title, quote=True)}">'
        f'<img src="data:image/png;base64,{data}" alt="{escape(f.alt, quote=True)}"></div>'
        f"<figcaption>{escape(f.title)}</figcaption></figure>"
    )


_STYLE = """
:root{color-scheme:light dark;--ink:#1c2430;--soft:#5b6675;--line:#d5dae1;--paper:#fff;--band:#f3f5f8;--link:#0b5cad}
@media(prefers-color-scheme:dark){:root{--ink:#e4e8ee;--soft:#a4afbd;--line:#3a4350;--paper:#14181e;--band:#1e242c;--link:#7db7f5}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,sans-serif}
main{max-width:76rem;margin:0 auto;padding:1rem clamp(.8rem,3vw,2rem) 4rem}
h1{font-size:1.6rem;line-height:1.25;margin:.5rem 0}h2{font-size:1.3rem;margin:2.5rem 0 .6rem;border-bottom:2px solid var(--line)}
p,li,dd{max-width:62rem;overflow-wrap:anywhere}a{color:var(--link)}
h3{margin:1.2rem 0 .2rem;font-size:1.1rem}
.answers{padding-left:1.2rem}.answers li{margin:.35rem 0}.answers li:first-child{font-weight:650}
.scroll{overflow-x:auto;margin:.8rem 0 .2rem}.scroll:focus-visible{outline:2px solid var(--link)}
table{border-collapse:collapse;font-size:.86rem;font-variant-numeric:tabular-nums;min-width:100%}
caption{text-align:left;font-weight:650;padding:.3rem 0;font-size:.95rem}
th,td{padding:.22rem .5rem;border-bottom:1px solid var(--line);text-align:left;vertical-align:bottom;white-space:nowrap}
td{vertical-align:top}.right{text-align:right}
th:first-child,td:first-child{position:sticky;left:0;background:var(--paper);white-space:normal;min-width:8rem}
@media(min-width:60rem){th:first-child,td:first-child{min-width:15rem}}
tbody tr:nth-child(even) td{background:var(--band)}
th button{all:unset;cursor:pointer;font-weight:650;white-space:normal;display:block;width:100%}
th button:focus-visible{outline:2px solid var(--link);outline-offset:2px}
th button:hover{color:var(--link)}
th button::after{content:" \\2195";color:var(--soft);font-weight:400}
th[aria-sort=ascending] button::after{content:" \\2191";color:var(--link)}
th[aria-sort=descending] button::after{content:" \\2193";color:var(--link)}
.note,figcaption{color:var(--soft);font-size:.84rem;margin:.2rem 0 1.4rem}
figure{margin:1.2rem 0}img{display:block;width:100%;max-width:54rem;min-width:30rem;height:auto;background:#fff}
summary{cursor:pointer;font-weight:650;padding:.4rem 0;color:var(--link)}
dt{font-weight:650}dd{margin:0 0 .5rem}
@media(max-width:480px){body{font-size:15px}table{font-size:.8rem}th,td{padding:.2rem .35rem}}
@media print{:root{--ink:#000;--soft:#444;--line:#bbb;--paper:#fff;--band:#f6f6f6}body{font-size:9.5pt}
main{max-width:none;padding:0}.scroll{overflow:visible}table{font-size:6.6pt;min-width:0}
th,td{padding:.1rem .22rem;white-space:normal}th button::after{content:""!important}img{min-width:0;max-width:15cm}
figure,tr{break-inside:avoid}h2,caption{break-after:avoid}}
"""

# The first click on a column of numbers puts the largest first, on one of text the first of the alphabet; the next turns
# it round. Empty cells stay last. What looks like a number, or starts with one (an interval), is sorted as one.
_SCRIPT = """
'use strict';
function key(cell){
  const given=cell.dataset.value, text=(given!==undefined?given:cell.textContent).trim().replace(/\\u2212/g,'-');
  if(text==='')return null;
  const number=/^[-+]?(\\d|inf)/.test(text)?(text==='inf'?Infinity:parseFloat(text.replace(/,/g,''))):NaN;
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
addEventListener('beforeprint',()=>{for(const d of document.querySelectorAll('details'))d.open=true});
"""
