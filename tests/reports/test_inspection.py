"""The page of a recording in a real browser, against the library's answers."""

from __future__ import annotations

import numpy as np
import pytest
from chromium import open_browser
from made_up_result import OPERATORS, POINTS, make_result

from sfmkit.errors import InputError
from sfmkit.recording import read_recording, save_recording
from sfmkit.recording.inspection import keypoint_life, match_life, point_life, read_tables
from sfmkit.reports import write_inspector

RESULT = make_result()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    save_recording(folder / "recording.rrd", RESULT)
    return write_inspector(folder), read_tables(read_recording(folder / "recording.rrd"))


def test_the_page_is_small_and_closed(made):
    text = made[0].read_text()
    assert made[0].name == "inspect.html"
    assert len(text) < 400_000
    assert "default-src 'none'" in text
    assert "http://" not in text
    assert "https://" not in text


def test_a_folder_without_a_recording(tmp_path):
    with pytest.raises(InputError, match=r"no recording\.rrd"):
        write_inspector(tmp_path)


@pytest.mark.browser
@pytest.mark.slow
def test_clicks_are_answered_as_by_the_library(made):
    path, tables = made
    with open_browser() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        requests, errors = [], []
        page.on("request", lambda r: requests.append(r.url))
        page.on("pageerror", lambda e: errors.append(str(e)))
        page.goto(path.as_uri(), wait_until="load")

        def shown() -> str:
            return page.inner_text("#life").strip()

        page.select_option("#stage", "keypoints")
        for k in (1, 2):  # one operator alone, so that the nearest dot is known
            page.uncheck(f"[data-operator='{k}']")
        xy = tables.keypoints["surf"][1].xy
        apart = np.linalg.norm(xy[:, None] - xy[None], axis=2) + 1e9 * np.eye(len(xy))
        inside = (xy > 10).all(1) & (xy < (310, 230)).all(1)
        n = int(np.argmax(apart.min(1) * inside))
        page.locator("#photo2").scroll_into_view_if_needed()
        box = page.locator("#photo2 canvas").bounding_box()
        factor = box["width"] / 320
        x, y = ((float(v) + 0.5) * factor for v in xy[n])
        page.mouse.click(box["x"] + x, box["y"] + y)
        assert shown() == str(keypoint_life(tables, "surf", 2, n))
        count = page.inner_text("#count")
        assert count.startswith(f"{len(tables.keypoints['surf'][0].xy):,} in image 1")
        page.check("[data-operator='1']")
        both = sum(len(tables.keypoints[name][0].xy) for name in OPERATORS[:2])
        assert page.inner_text("#count").startswith(f"{both:,} in image 1")
        for row in (4, 8, POINTS + 3):  # found by two operators, by two, and an outlier
            page.fill("#match", str(row))
            page.click("#go button")
            assert shown() == str(match_life(tables, row))
        page.fill("#point", "7")
        page.click("#go button")
        assert shown() == str(point_life(tables, 7))
        ties = [0.25, 0.75, -0.25, 2.5, 3.5, -2.5, 0.125, 1234.5]
        rounded = page.evaluate(
            "(v) => v.map((x) => [fixed(x, 0), fixed(x, 1), fixed(x, 2)])", ties
        )
        assert rounded == [[f"{x:.0f}", f"{x:.1f}", f"{x:.2f}"] for x in ties]
        page.evaluate("document.getElementById('life').textContent = ''")
        page.locator("#scene").scroll_into_view_if_needed()
        at = page.evaluate("placed.filter(([, n]) => n === 20)[0][0].slice(0, 2)")
        page.locator("#scene").click(position={"x": at[0], "y": at[1]})
        assert shown().startswith("point ")
        page.check("#heat")
        assert not errors
        assert all(url.startswith(("file:", "data:")) for url in requests)
        page.set_viewport_size({"width": 380, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= 380
