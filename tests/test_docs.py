"""The code, links and pictures of the documentation."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import PIL.Image
import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("page", ["docs/conventions.md", "docs/extend.md", "docs/stages.md"])
def test_the_code_of_a_page_runs_from_top_to_bottom(page):
    text = (ROOT / page).read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert blocks
    assert sum("assert" in block for block in blocks) >= 3
    namespace: dict = {}
    for block in blocks:
        line = text[: text.index(block)].count("\n")
        exec(compile("\n" * line + block, page, "exec"), namespace)


def test_links_to_files_are_valid():
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.slow
def test_the_picture_of_the_index_page_shows_the_current_counts():
    """`python benchmarks/pictures.py` stores the statistics of its run in the picture."""
    with PIL.Image.open(ROOT / "docs" / "images" / "demo-matches.jpg") as picture:
        stored = json.loads(picture.info["comment"])
    pictures = runpy.run_path(str(ROOT / "benchmarks" / "pictures.py"))
    current = pictures["statistics"](pictures["demo"]())
    assert stored.keys() == current.keys() == {*pictures["OPERATORS"], "multi"}
    for name, counts in current.items():
        for count, value in counts.items():
            # Processors round differently, which changes single matches.
            assert stored[name][count] == pytest.approx(value, rel=0.005), f"{name} {count}"
