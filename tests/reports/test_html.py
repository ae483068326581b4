"""The page of all results: complete, self-contained, escaped; and what a browser makes of it."""

from __future__ import annotations

from html.parser import HTMLParser

import pytest
from chromium import open_browser
from click.testing import CliRunner
from PIL import Image

from sfmkit.cli.report import report
from sfmkit.errors import InputError
from sfmkit.reports import page
from sfmkit.reports.html import find_results, write_report
from sfmkit.reports.result import Column, Result, ResultFigure, ResultTable, write_result

NASTY = "<script>alert('x')</script> & \"quotes\""


def write_made_up(folder, name: str, title: str = "Made up") -> None:
    folder.mkdir(parents=True)
    Image.new("RGB", (900, 300), "#0072B2").save(folder / "figure.png")
    columns = (
        Column("operator"),
        *(Column(f"a long head, {k}", ".3f") for k in range(24)),
        Column("paper", ".1f", True),
    )
    rows = tuple((f"{NASTY} {k}", *(k + j / 7 for j in range(24)), 3.5) for k in range(3))
    table = ResultTable("made-up", f"Table {NASTY}", columns, rows, f"Note {NASTY}")
    figure = ResultFigure(f"Figure {NASTY}", "figure.png", f"Alt {NASTY}")
    notes = (f"Mind {NASTY}",)
    write_result(
        folder, Result(name, title, f"sfmkit bench {NASTY}", (table,), (figure,), (0, 1, 2), notes)
    )


@pytest.fixture
def folder(tmp_path):
    write_made_up(tmp_path / "uav", "uav", "Drone")
    write_made_up(tmp_path / "oxford", "oxford", "Homographies")
    write_made_up(tmp_path / "another", "another", "Homographies")
    (tmp_path / "reconstruction").mkdir()
    return tmp_path


class Reader(HTMLParser):
    """Checks nesting, and keeps tags with their attributes, and the text."""

    VOID = ("meta", "img", "link", "br")

    def __init__(self, html: str):
        super().__init__()
        self.tags, self.text, self.open = [], "", []
        self.feed(html)
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_everything_is_on_the_page_escaped_and_self_contained(folder):
    path = write_report(folder)
    assert path == folder / "report.html"
    html = Reader(path.read_text(encoding="utf-8"))
    assert not [tag for tag, _ in html.tags if tag in ("script", "link", "iframe", "object")]
    references = [
        v for _, a in html.tags for k, v in a.items() if k in ("src", "href", "srcset", "action")
    ]
    assert len([r for r in references if r.startswith("data:image/png;base64,")]) == 3
    assert all(r.startswith(("data:image/png", "#")) for r in references)
    ids = [a["id"] for _, a in html.tags if "id" in a]
    assert len(set(ids)) == len(ids), "headings alike have anchors of their own"
    assert {r[1:] for r in references if r.startswith("#")} == set(ids)
    assert html.text.index("Homographies") < html.text.index("Drone")
    for what in ("Table", "Note", "Figure", "Mind", "sfmkit bench"):
        assert html.text.count(f"{what} {NASTY}") >= 3, what
    assert [a["alt"] for tag, a in html.tags if tag == "img"] == [f"Alt {NASTY}"] * 3
    assert html.text.count("1.143") >= 3
    assert ("td", {"class": "right paper"}) in html.tags
    for term in ("processor", "versions", "seeds"):
        assert html.text.count(term) >= 3
    assert "0, 1, 2" in html.text


def test_the_order_is_the_papers(folder):
    assert [f.name for f in find_results(folder)] == ["oxford", "uav", "another"]
    assert find_results(folder / "uav") == [folder / "uav"]


def test_the_command(folder, tmp_path):
    out = tmp_path / "page.html"
    done = CliRunner().invoke(report, [str(folder), "--out", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    assert str(out) in done.output
    assert out.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_nothing_to_report(tmp_path):
    with pytest.raises(InputError, match=r"holds no results.*sfmkit bench"):
        write_report(tmp_path)
    with pytest.raises(InputError, match="there is no folder"):
        write_report(tmp_path / "none")
    write_made_up(tmp_path / "uav", "uav")
    (tmp_path / "uav" / "figure.png").write_bytes(b"GIF89a")
    with pytest.raises(InputError, match="not a PNG"):
        write_report(tmp_path)
    (tmp_path / "uav" / "result.json").write_text("{}")
    with pytest.raises(InputError, match="version 2"):
        write_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_one_section_needs_no_contents():
    assert "<nav>" not in page.page("t", [], [("one", "")])


@pytest.mark.browser
@pytest.mark.parametrize("width", [400, 1280])
def test_a_browser_shows_it_without_a_network(folder, tmp_path, width):
    path = write_report(folder)
    with open_browser() as browser:
        tab = browser.new_page(viewport={"width": width, "height": 900}, color_scheme="light")
        asked, problems = [], []
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("console", lambda message: problems.append(message.text))
        tab.goto(path.as_uri())
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
        assert tab.evaluate("document.documentElement.scrollWidth") <= width, (
            "the page itself does not scroll sideways"
        )
        boxes = tab.evaluate(
            "[...document.querySelectorAll('.wide')].map(b => [b.scrollWidth, b.clientWidth])"
        )
        assert len(boxes) == 3
        assert all(inner > outer for inner, outer in boxes), "wide tables scroll in their box"
        tab.evaluate("document.querySelectorAll('img').forEach(i => i.loading = 'eager')")
        tab.wait_for_function(
            "[...document.images].every(i => i.complete && i.naturalWidth == 900)"
        )
        light = tab.evaluate("getComputedStyle(document.body).backgroundColor")
        tab.emulate_media(color_scheme="dark")
        dark = tab.evaluate("getComputedStyle(document.body).backgroundColor")
        assert light == "rgb(255, 255, 255)" != dark
        picture = tmp_path / "page.png"
        tab.screenshot(path=picture)
        assert problems == []
    assert len(Image.open(picture).convert("L").getcolors()) > 20
