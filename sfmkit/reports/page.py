"""Build one self-contained HTML page of text, tables and figures.

Every function takes plain text and returns HTML in which that text is escaped. Pictures are
embedded as data URIs, so the page can be mailed and viewed without a network. It adapts to narrow
screens and to the light and dark colour schemes.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from ..errors import InputError

PNG = b"\x89PNG\r\n\x1a\n"

_STYLE = """
:root { color-scheme: light dark; --ink: #1c1e21; --soft: #5c6370; --paper: #fff; --line: #d8dce2;
  --band: #f5f6f8; --mark: rgb(255 196 0 / .14); --shade: rgb(0 0 0 / .28); --link: #0b5cad; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e6ea; --soft: #a0a7b4; --paper: #16181c; --line: #363b44; --band: #1f2228;
    --mark: rgb(255 196 0 / .13); --shade: rgb(0 0 0 / .8); --link: #7db7f0; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
main { max-width: 76rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.25rem; line-height: 1.25; margin: 2.5rem 0 .5rem; padding-top: .5rem;
  border-top: 2px solid var(--line); }
h3 { font-size: 1rem; margin: 1.5rem 0 .4rem; }
p, ul, dl { max-width: 46rem; margin: .5rem 0; }
a { color: var(--link); }
nav ul { padding-left: 1.2rem; }
code, pre { font: .85rem/1.4 ui-monospace, "DejaVu Sans Mono", monospace; }
code { overflow-wrap: anywhere; }
pre { background: var(--band); padding: .6rem .8rem; overflow-x: auto; border-radius: 4px;
  max-width: 100%; }
.note { color: var(--soft); font-size: .9rem; }
/* A shadow at a side shows that the table continues there: at the table's end, a cover that scrolls
   with the table hides it. */
.wide { overflow-x: auto; max-width: 100%; border: 1px solid var(--line); border-radius: 4px;
  background:
  linear-gradient(to right, var(--paper) 40%, transparent) 0 0 / 3rem 100% no-repeat local,
  linear-gradient(to left, var(--paper) 40%, transparent) 100% 0 / 3rem 100% no-repeat local,
  linear-gradient(to right, var(--shade), transparent) 0 0 / 1rem 100% no-repeat scroll,
  linear-gradient(to left, var(--shade), transparent) 100% 0 / 1rem 100% no-repeat scroll; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums;
  min-width: 100%; }
th, td { padding: .28rem .6rem; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { font-weight: 600; vertical-align: bottom; }
th.right, td.right { text-align: right; }
td { white-space: nowrap; }
td.long { white-space: normal; min-width: 14rem; }
thead { background: rgb(128 136 150 / .1); }
th.paper, td.paper { background: var(--mark); }
tbody tr:last-child td { border-bottom: 0; }
figure { margin: 1rem 0; }
figure img { display: block; max-width: 100%; height: auto; background: #fff;
  border: 1px solid var(--line); border-radius: 4px; }
figcaption { color: var(--soft); font-size: .9rem; margin-top: .3rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem .8rem; font-size: .9rem; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 30rem) { dl { grid-template-columns: 1fr; } dd { margin-bottom: .4rem; } }
@media print { .wide { overflow: visible; border: 0; } }
"""
_LONG = 44  # characters; a longer cell may be broken into lines


def page(
    title: str,
    intro: Sequence[str],
    sections: Sequence[tuple[str, str]],
    *,
    style: str = "",
    script: str = "",
) -> str:
    """Build the whole page.

    Args:
        title, intro: its heading and first paragraphs, plain text.
        sections: (heading, HTML made by the functions below); two or more get a table of contents.
        style, script: additional CSS and JavaScript; no other script can run.
    """
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    scripts = f"; script-src 'sha256-{digest}'" if script else ""
    anchors = _anchors([heading for heading, _ in sections])
    contents = "".join(
        f'<li><a href="#{a}">{escape(h)}</a></li>' for a, (h, _) in zip(anchors, sections)
    )
    body = "".join(
        f'<section id="{a}"><h2>{escape(heading)}</h2>{html}</section>'
        for a, (heading, html) in zip(anchors, sections)
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Nothing may be fetched or run, whatever the results contain.
        '<meta http-equiv="Content-Security-Policy" content="'
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
        f'{scripts}">'
        f"<title>{escape(title)}</title><style>{_STYLE}{style}</style></head><body><main>"
        f"<h1>{escape(title)}</h1>{paragraphs(intro)}"
        + (f"<nav><ul>{contents}</ul></nav>" if len(sections) > 1 else "")
        + f"{body}</main>{f'<script>{script}</script>' if script else ''}</body></html>\n"
    )


def _anchors(headings: Iterable[str]) -> list[str]:
    """Make a unique fragment identifier for each heading."""
    made: list[str] = []
    for heading in headings:
        base = anchor = re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") or "section"
        number = 1
        while anchor in made:
            number += 1
            anchor = f"{base}-{number}"
        made.append(anchor)
    return made


def paragraphs(texts: Sequence[str], kind: str = "") -> str:
    """Wrap plain text in paragraphs; the kind ``note`` has a smaller font."""
    mark = f' class="{escape(kind)}"' if kind else ""
    return "".join(f"<p{mark}>{escape(text)}</p>" for text in texts)


def heading(text: str) -> str:
    """Make a heading one level below that of a section."""
    return f"<h3>{escape(text)}</h3>"


def code(text: str) -> str:
    """Show a command to type."""
    return f"<pre><code>{escape(text)}</code></pre>"


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Make a list of terms with their descriptions."""
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in pairs) + "</dl>"


def table(
    title: str,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    right: Sequence[bool] = (),
    marked: Sequence[bool] = (),
    note: str = "",
) -> str:
    """Make a table in a box that scrolls horizontally on a narrow page.

    Args:
        head, rows: plain text.
        right: columns that are right-aligned.
        marked: columns that are highlighted, the paper's.
    """

    def cell(tag: str, column: int, text: str) -> str:
        classes = [
            name
            for name, on in (
                ("right", column < len(right) and right[column]),
                ("paper", column < len(marked) and marked[column]),
                ("long", tag == "td" and len(text) > _LONG),
            )
            if on
        ]
        mark = f' class="{" ".join(classes)}"' if classes else ""
        return f"<{tag}{mark}>{escape(text)}</{tag}>"

    lines = "".join(
        "<tr>" + "".join(cell("td", k, text) for k, text in enumerate(row)) + "</tr>"
        for row in rows
    )
    return (
        f'{heading(title)}<div class="wide" tabindex="0" role="region" '
        f'aria-label="{escape(title)}"><table><thead><tr>'
        + "".join(cell("th", k, text) for k, text in enumerate(head))
        + f"</tr></thead><tbody>{lines}</tbody></table></div>"
        + paragraphs([note] if note else [], "note")
    )


def figure(title: str, path: Path, alt: str) -> str:
    """Embed a PNG file as a figure, with its title below.

    Raises:
        InputError: the file does not exist or is not a PNG file.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    if not data.startswith(PNG):
        raise InputError(f"{path} is not a PNG file")
    source = base64.b64encode(data).decode("ascii")
    return (
        f'<figure><img src="data:image/png;base64,{source}" alt="{escape(alt)}" loading="lazy">'
        f"<figcaption>{escape(title)}</figcaption></figure>"
    )
