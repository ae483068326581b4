"""Cells of Markdown tables show their text and nothing else."""

from __future__ import annotations

import pytest

from sfmkit._utils.markdown import escape, table_row

TEXTS = [
    "a | b",
    "`code`",
    "two\nlines",
    "<script>alert(1)</script>",
    "*bold* _it_ ~~no~~",
    "[link](http://x)",
    "![picture](x.png)",
    "back\\slash \\| bar",
    "&lt;",
    "$x$",
    "1,234.5",
]


@pytest.mark.parametrize("text", TEXTS)
def test_a_parser_gives_the_text_back(text):
    parser = pytest.importorskip("markdown_it").MarkdownIt("commonmark").enable("table")
    page = f"{table_row(['head', 'x'])}\n|:--|--:|\n{table_row([text, '1'])}\n"
    tokens = parser.parse(page)
    cells = [token for token in tokens if token.type == "inline"]
    assert len(cells) == 4
    children = cells[2].children or []
    assert {child.type for child in children} <= {"text", "text_special"}
    assert "".join(child.content for child in children) == " ".join(text.split())


def test_numbers_and_names_are_left_alone():
    assert escape("fast-brief 1,234.5 +0.1 %") == "fast-brief 1,234.5 +0.1 %"
