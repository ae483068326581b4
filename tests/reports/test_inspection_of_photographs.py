"""The page of real reconstructions in a browser: its four questions, against the library."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from chromium import open_browser
from scipy.spatial import cKDTree

from sfmkit import Reconstruction, reconstruct
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.io.images import read_image
from sfmkit.io.intrinsics import parse_intrinsics
from sfmkit.options import DEFAULT
from sfmkit.recording import read_recording, save_recording
from sfmkit.recording.inspection import (
    Tables,
    keypoint_life,
    match_life,
    point_life,
    read_tables,
    rejections,
)
from sfmkit.reports import write_inspector

OPERATORS = ("surf", "orb", "fast-brief")
CELLS = 40
BUDGET = 5000  # keypoints per operator and image
pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(300)]


@dataclass(frozen=True, eq=False)
class Shown:
    """A page in a browser, the reconstruction it shows, and what its recording holds."""

    page: object
    path: Path
    result: Reconstruction
    tables: Tables
    errors: list[str]

    def life(self) -> str:
        return self.page.inner_text("#life").strip()

    def only(self, operator: str) -> None:
        for k, name in enumerate(OPERATORS):
            self.page.set_checked(f"[data-operator='{k}']", name == operator)


@pytest.fixture(scope="module")
def browser():
    with open_browser() as browser:
        yield browser


@pytest.fixture(scope="module", params=["demo", pytest.param("fountain", marks=pytest.mark.data)])
def shown(request, browser, tmp_path_factory) -> Shown:
    """The bundled pair and the fountain, with fewer keypoints than by default."""
    if request.param == "demo":
        *images, intrinsics = demo_pair()
    else:
        folder = request.getfixturevalue("data_dir") / "strecha" / "fountain-P11" / "images"
        images, intrinsics = [folder / "0000.jpg", folder / "0001.jpg"], folder / "K.txt"
    camera = parse_intrinsics(intrinsics, read_image(images[0]).size_wh)
    detect = replace(DEFAULT.detect, budget=BUDGET, max_size=1536)
    result = reconstruct(*images, camera, OPERATORS, options=replace(DEFAULT, detect=detect))
    folder = tmp_path_factory.mktemp(request.param)
    save_recording(folder / "recording.rrd", result)
    path = write_inspector(folder)
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(20_000)
    errors: list[str] = []
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.goto(path.as_uri(), wait_until="load")
    tables = read_tables(read_recording(folder / "recording.rrd"))
    yield Shown(page, path, result, tables, errors)
    page.close()


def test_the_page_is_small_and_makes_no_error(shown):
    """By default the largest pair has 190 thousand keypoints, which must fit into 15 MB."""
    text = shown.path.read_text()
    photographs = sum(map(len, re.findall(r"data:image/jpeg;base64,[^\"]*", text)))
    keypoints = sum(len(f.keypoints) for pair in shown.result.features.values() for f in pair)
    assert photographs < 2.5e6
    assert (len(text) - photographs - 1e5) / keypoints < 65
    assert not shown.errors
    assert len(shown.tables.points.xyz) == len(shown.result.cloud) > 2000


def test_where_a_point_comes_from(shown):
    """Places of the cloud that are clicked, and points by number, against the library's lives."""
    g, page = np.random.default_rng(0), shown.page
    numbers = g.choice(len(shown.tables.points.xyz), 100, replace=False).tolist()
    page.locator("#scene").scroll_into_view_if_needed()
    said = page.evaluate("(some) => some.map((n) => told(pointLife(n)))", numbers)
    assert said == [str(point_life(shown.tables, n)) for n in numbers]

    placed = page.evaluate("placed.map(([p, n]) => [...p, n])")
    u, v, depth, row = np.array(placed).T
    low = page.evaluate("document.querySelector('.side').getBoundingClientRect().top")
    box = page.locator("#scene").bounding_box()
    seen = np.flatnonzero((u > 5) & (v > 5) & (box["y"] + v < low - 5) & (u < box["width"] - 5))
    for k in g.choice(seen, 4, replace=False):
        # Events have whole pixels of the window; the canvas may begin between two of them.
        column, line = round(box["x"] + float(u[k])), round(box["y"] + float(v[k]))
        page.mouse.click(column, line)
        x, y = column - box["x"], line - box["y"]
        under = np.flatnonzero((np.abs(u - x) <= 1) & (np.abs(v - y) <= 1))
        n = int(row[under[np.argmin(depth[under])]])
        assert shown.life() == str(point_life(shown.tables, n))
    assert not shown.errors


def test_why_a_match_was_rejected(shown):
    page, m = shown.page, shown.tables.matches
    page.select_option("#stage", "rejected")
    for k in range(len(OPERATORS)):
        page.check(f"[data-operator='{k}']")
    rows = np.flatnonzero(np.char.startswith(m.fate, "outlier"))
    assert page.inner_text("#count").startswith(f"{len(rows):,} in image 1")
    xy = np.asarray(m.xy1)[rows]
    apart = cKDTree(xy).query(xy, 2)[0][:, 1]
    row = int(rows[np.argmax(apart)])  # the rejected match that lies most apart
    page.locator("#photo1").scroll_into_view_if_needed()
    box = page.locator("#photo1 canvas").bounding_box()
    factor = box["width"] / shown.tables.report["images"][0]["size_wh"][0]
    x, y = (np.asarray(m.xy1)[row] + 0.5) * factor
    page.locator("#photo1 canvas").click(position={"x": float(x), "y": float(y)})
    operator = OPERATORS[int(m.kept[row])]
    life = keypoint_life(shown.tables, operator, 1, int(m.keypoint1[row]))
    assert life.match == row
    assert shown.life() == str(life)
    assert f"ended here: {m.fate[row].removeprefix('outlier: ')}" in shown.life()
    limit = shown.result.options.estimate.threshold_px
    assert f"an inlier lies within {limit:g} px of its epipolar line" in shown.life()
    table = page.inner_text("#why-matches-were-rejected")
    for r in rejections(shown.tables):
        assert f"{r.count:,} of {r.of:,}" in table
        assert r.why in table


def test_which_operator_covers_which_region(shown):
    """The cells and the colour bar of each operator, against its features."""
    page, result = shown.page, shown.result
    page.select_option("#stage", "keypoints")
    page.check("#heat")
    for name in OPERATORS:
        shown.only(name)
        counts = []
        for i in (0, 1):
            (w, h), x = result.images[i].size_wh, result.features[name][i].keypoints + 0.5
            rows = int(np.ceil(h * CELLS / w))
            edges = [np.arange(n + 1) * w / CELLS for n in (rows, CELLS)]
            counts.append(np.histogram2d(x[:, 1], x[:, 0], edges)[0].astype(int))
            found = dict(page.evaluate(f"[...state.cells[{i}]]"))
            expected = {k: int(n) for k, n in enumerate(counts[i].ravel()) if n}
            different = {k for k in found | expected if found.get(k) != expected.get(k)}
            assert len(different) <= 2  # pixels on an edge, float32 in the page
        ticks = page.locator("#bar .ticks span").all_inner_texts()
        assert ticks[0] == "1"
        assert abs(int(ticks[-1].replace(",", "")) - max(c.max() for c in counts)) <= 1
        assert "all keypoints: number per cell" in page.inner_text("#bar figcaption")
    page.uncheck("#heat")
    assert page.locator("#bar").is_hidden()


def test_what_fusion_changed(shown):
    page, counts = shown.page, shown.result.correspondences.counts
    table = page.locator("#what-fusion-changed tbody tr").all_inner_texts()
    for name, line in zip(OPERATORS, table, strict=True):
        shown.only(name)
        for stage, n in (
            ("before", counts[name].matches),
            ("merged", counts[name].merged),
            ("after", counts[name].matches - counts[name].merged),
        ):
            page.select_option("#stage", stage)
            assert page.inner_text("#count").startswith(f"{n:,} in image 1")
            assert f"{n:,}" in line.split("\t")
        found = int(shown.result.correspondences.found_by(name).sum())
        assert line.split("\t")[4] == f"{found:,}"


def test_the_page_on_a_phone(shown):
    page = shown.page
    page.set_viewport_size({"width": 380, "height": 800})
    page.select_option("#stage", "after")
    page.check("#heat")
    assert page.evaluate("document.documentElement.scrollWidth") <= 380
    assert page.locator("#bar").bounding_box()["width"] <= 380
    page.uncheck("#heat")
    page.evaluate("showMatch(5)")
    assert shown.life() == str(match_life(shown.tables, 5))
    answer = page.locator("#life").bounding_box()
    assert answer["y"] + answer["height"] <= 800, "the answer stays in sight"
