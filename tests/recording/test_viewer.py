"""A recording in the real viewer in a real browser: every view of every page shows something, and a
click explains."""

from __future__ import annotations

import io
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from chromium import open_browser, wait_for
from made_up_result import OPERATORS, make_result
from scipy.ndimage import uniform_filter

from sfmkit.io.images import read_image
from sfmkit.recording.blueprint import LEGEND_SHARE, QUANTITIES
from sfmkit.recording.log import save_recording
from sfmkit.recording.viewer import serve
from sfmkit.viz.colours import operator_rgb

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(600)]

PANEL, TOP, BOTTOM, TITLE = (
    300,
    64,
    30,
    28,
)  # pixels of the selection panel, the bars and a view's title
TABS = {
    "Overview": 50,
    "Keypoints": 146,
    "Matches": 234,
    "Epipolar geometry": 343,
    "Cloud": 454,
    "Account": 528,
}
# What every browser without a graphics card or a network says; anything else is the recording's
# fault.
ENVIRONMENT = (
    "rasterizer",
    "viewport command",
    "deprecated parameters",
    "query. Expected",
    "adapters",
    "Failed to load examples",
    "GPU stall",
    "WebGL",
)

Box = tuple[float, float, float, float]  # x0, y0, x1, y1 as shares of the area that the pages have
LEGEND = 1 / (LEGEND_SHARE + 1)  # share of the legend below the views of every page


def grid(names: list[str], columns: int, x0: float = 0) -> dict[str, Box]:
    """Boxes of views of equal size, row by row, right of x0."""
    rows = -(-len(names) // columns)
    width, height = (1 - x0) / columns, (1 - LEGEND) / rows
    return {
        name: (
            x0 + k % columns * width,
            k // columns * height,
            x0 + (k % columns + 1) * width,
            (k // columns + 1) * height,
        )
        for k, name in enumerate(names)
    }


def above_the_legend(views: dict[str, Box]) -> dict[str, Box]:
    """Boxes whose heights are shares of the page without its legend."""
    part = 1 - LEGEND
    return {name: (x0, y0 * part, x1, y1 * part) for name, (x0, y0, x1, y1) in views.items()}


PAGES: dict[str, dict[str, Box]] = {
    "Overview": above_the_legend(
        {
            "scene": (0, 0, 0.6, 0.6),
            "inliers": (0, 0.6, 0.6, 1),
            "image 1": (0.6, 0, 1, 8 / 23),
            "image 2": (0.6, 8 / 23, 1, 16 / 23),
            "stage": (0.6, 16 / 23, 1, 1),
        }
    ),
    **{
        page: grid(["view 1", "view 2", "view 3", "view 4"], 2)
        for page in ("Matches", "Epipolar geometry", "Cloud")
    },
    "Keypoints": {
        **above_the_legend({"image 1": (0, 0, 0.5, 0.5), "image 2": (0.5, 0, 1, 0.5)}),
        **above_the_legend(
            {name: (k / 3, 0.5, (k + 1) / 3, 1) for k, name in enumerate(OPERATORS)}
        ),
    },
    "Account": {
        **above_the_legend({"account": (0, 0, 0.6, 1)}),
        **grid([*QUANTITIES, "seconds"], 2, x0=0.6),
    },
}
for views in PAGES.values():
    views["legend"] = (0, 1 - LEGEND, 1, 1)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    g = np.random.default_rng(1)
    photographs = [
        np.asarray(
            PIL.Image.fromarray(
                g.integers(90, 170, (15, 20, 1), dtype=np.uint8).repeat(3, 2)
            ).resize((640, 480), PIL.Image.BICUBIC)
        )
        for _ in range(2)
    ]
    result = make_result(points=2000, outliers=200, size_wh=(640, 480), image=photographs[0])
    result = replace(result, images=tuple(read_image(p) for p in photographs))
    path = tmp_path_factory.mktemp("viewer") / "made-up.rrd"
    save_recording(path, result)
    with serve(path) as server:
        yield server


@pytest.fixture(scope="module")
def browser():
    with open_browser() as browser:
        yield browser


def screenshot(page, name: str) -> np.ndarray:
    png = page.screenshot()
    if folder := os.environ.get("SFMKIT_ARTEFACTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / f"{name}.png").write_bytes(png)
    return np.asarray(PIL.Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def cut(shot: np.ndarray, box: Box) -> np.ndarray:
    """The pixels of a view, without its title; (3, TOP + TITLE) off the page's corner for the first
    view."""
    h, w = shot.shape[:2]
    width, height = w - PANEL, h - TOP - BOTTOM
    x0, y0, x1, y1 = (
        round(v)
        for v in (box[0] * width, TOP + box[1] * height, box[2] * width, TOP + box[3] * height)
    )
    return shot[y0 + TITLE : y1 - 3, x0 + 3 : x1 - 3]


def drawn(pixels: np.ndarray) -> float:
    """Share of pixels that differ from the commonest colour."""
    flat = pixels.reshape(-1, 3) @ (1, 256, 65536)
    values, counts = np.unique(flat, return_counts=True)
    return 1 - counts.max() / len(flat)


def all_drawn(shot: np.ndarray, views: dict[str, Box]) -> bool:
    return all(drawn(cut(shot, box)) > 0.01 for box in views.values())


def coloured(pixels: np.ndarray, *colours: tuple[int, int, int]) -> np.ndarray:
    """Which pixels are nearly of one of the colours."""
    return np.any([np.abs(pixels - np.array(rgb)).max(-1) < 80 for rgb in colours], axis=0)


@pytest.mark.parametrize(
    "size, pages",
    [((1280, 800), tuple(PAGES)), ((1920, 1080), ("Overview", "Cloud"))],
    ids=["1280x800", "1920x1080"],
)
def test_every_view_of_every_page_shows_something_and_nothing_is_complained_of(
    server, browser, size, pages
):
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    said: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    try:
        page.goto(server.url)
        page.wait_for_selector("canvas", timeout=120_000)
        for name in pages:
            views = PAGES[name]
            if name != "Overview":
                page.mouse.click(TABS[name], 50)
            label = f"viewer-{size[0]}-{name.split()[0].lower()}"

            if not wait_for(
                lambda label=label, views=views: all_drawn(screenshot(page, label), views), 120, 1
            ):
                shot = screenshot(page, label)
                pytest.fail(
                    f"{name}: "
                    + str({view: f"{drawn(cut(shot, box)):.1%}" for view, box in views.items()})
                )
        page.mouse.click(TABS["Overview"], 50)

        def coloured_by_operator() -> bool:
            shot = screenshot(page, f"viewer-{size[0]}-overview")
            boxes = [PAGES["Overview"][view] for view in ("inliers", "image 1", "image 2")]
            return all(
                coloured(cut(shot, box), operator_rgb(name)).sum() > 200
                for box in boxes
                for name in OPERATORS
            )

        assert wait_for(coloured_by_operator, 120, 1)
    finally:
        page.close()
    warnings = [s for s in said if " WARN " in s or " ERROR " in s]
    ours = [s for s in warnings if not any(known in s for known in ENVIRONMENT)]
    assert ours == []


def settled(page, name: str) -> np.ndarray:
    """The page once it has stopped changing, however long a frame takes here; as it is after a
    minute."""
    shot = screenshot(page, name)

    def still() -> bool:
        nonlocal shot
        before, shot = shot, screenshot(page, name)
        return np.array_equal(
            before[TOP:-BOTTOM], shot[TOP:-BOTTOM]
        )  # the bar above tells a running latency

    wait_for(still, 60, 1)
    return shot


def test_clicking_a_point_names_its_origin_and_marks_it_in_both_photographs(server, browser):
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    overview = PAGES["Overview"]
    aside = (900.0, 760.0)
    try:
        page.goto(server.url)
        page.wait_for_selector("canvas", timeout=120_000)
        page.mouse.move(*aside)
        assert wait_for(lambda: all_drawn(screenshot(page, "click-before"), overview), 120, 1)
        before = settled(page, "click-before")
        pixels = cut(before, overview["scene"])
        assert drawn(pixels) > 0.05
        dots = (pixels.max(-1) < 200) & ~coloured(pixels, *map(operator_rgb, OPERATORS))
        dots[: len(dots) // 8] = dots[len(dots) // 2 :] = (
            False  # the cloud stands above the cameras
        )
        density = uniform_filter(dots.astype(float), 5)
        tried: list[str] = []

        def explained() -> bool:
            row, column = np.unravel_index(density.argmax(), density.shape)
            density[row - 3 : row + 4, column - 3 : column + 4] = 0  # another place next time
            x, y = float(column + 3), float(row + TOP + TITLE)
            page.mouse.move(x + 1, y)
            page.mouse.move(x, y)
            settled(page, "click-hover")  # what lies below the pointer is known a frame later
            page.mouse.click(x, y)
            settled(page, "click-clicked")
            page.mouse.move(*aside)
            change = np.abs(settled(page, "click-after") - before).max(-1) > 40
            # The panel lists what is known of the point; in both images a mark and its depth
            # appear, nothing more.
            panel = change[150:560, -PANEL + 10 :].mean()
            marks = [
                int(cut(change[..., None], overview[view]).sum()) for view in ("image 1", "image 2")
            ]
            tried.append(
                f"({x:.0f}, {y:.0f}): {panel:.1%} of the panel, {marks} pixels of the images"
            )
            return panel > 0.02 and all(20 < mark < 8000 for mark in marks)

        assert wait_for(explained, 300, 1), tried
    finally:
        page.close()
