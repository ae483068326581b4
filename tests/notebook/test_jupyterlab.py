"""The notebooks in a real JupyterLab in a real browser, without the web: run, clicked, and measured
on the screen."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import nbformat
import numpy as np
import PIL.Image
import pytest
from chromium import open_browser, wait_for

from sfmkit import detect
from sfmkit.datasets.lesson import lesson_pair
from sfmkit.io.images import read_image

pytestmark = [pytest.mark.browser, pytest.mark.notebook, pytest.mark.slow, pytest.mark.timeout(900)]

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
HERE = ("127.0.0.1", "localhost")
TOP, TITLE, BOTTOM = (
    64,
    28,
    30,
)  # pixels of the viewer's bars, of a view's title, and of the time line
YELLOW = (240, 228, 66)
OPERATORS = ("orb", "fast-brief")  # of notebook 04
PATIENCE_S = 120  # on a crowded machine


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    """The pair that the notebooks show where there are no real photographs, with its truth."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("SFMKIT_DATA", raising=False)
        for variable in ("HOME", "XDG_CACHE_HOME"):
            patch.setenv(variable, str(tmp_path_factory.mktemp("empty")))
        return lesson_pair()


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """(address, token, folder) of `sfmkit lab` on a copy of the notebooks, by a user without
    settings."""
    home = tmp_path_factory.mktemp("lab")
    folder = Path(shutil.copytree(NOTEBOOKS, home / "notebooks"))
    mine = {
        k: v for k, v in os.environ.items() if not k.startswith(("JUPYTER", "SFMKIT_DATA", "XDG"))
    }
    log = home / "log.txt"
    with log.open("w") as sink:
        process = subprocess.Popen(
            [sys.executable, "-m", "sfmkit.cli", "lab", str(folder), "--no-browser", "--port", "0"],
            env={**mine, "HOME": str(home)},
            stdout=sink,
            stderr=sink,
            start_new_session=True,
        )
    try:
        found: list[re.Match] = []

        def announced() -> bool:
            found[:] = re.finditer(
                r"(http://127\.0\.0\.1:\d+)/lab\S*\?token=(\w+)", log.read_text()
            )
            return bool(found) or process.poll() is not None

        assert wait_for(announced, 60)
        assert found, log.read_text()
        yield found[0][1], found[0][2], folder
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture(scope="module")
def browser():
    with open_browser() as browser:
        yield browser


class Notebook:
    """A notebook in JupyterLab, run from top to bottom."""

    def __init__(self, browser, lab, name: str):
        address, token, folder = lab
        self.name, self.file = name, folder / name
        self.asked: set[str] = set()  # hosts
        self.page = browser.new_page(viewport={"width": 1280, "height": 1000})
        self.page.set_default_timeout(
            1000 * PATIENCE_S
        )  # drawing in software starves everything else on the page
        self.page.on(
            "request", lambda request: self.asked.add(urlsplit(request.url).hostname or "")
        )
        self.page.route(
            lambda url: urlsplit(url).hostname not in (*HERE, None, ""), lambda route: route.abort()
        )
        # A workspace of its own: the default one would open again what another test had open.
        self.page.goto(f"{address}/lab/workspaces/{Path(name).stem}/tree/{name}?token={token}")
        self.page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=120_000)
        # Asked to run before its kernel is there, JupyterLab asks which kernel to take.
        self.page.wait_for_selector("text=/Python 3.* \\| Idle/", timeout=120_000)
        self.choose("Run", "Run All Cells")
        assert wait_for(self.has_run, PATIENCE_S, 2), "not every cell was run"

    def choose(self, menu: str, item: str) -> None:
        if self.page.locator(".jp-Dialog").count():
            self.screenshot("dialog")
            pytest.fail("JupyterLab asks: " + self.page.locator(".jp-Dialog").first.inner_text())
        self.page.locator(".lm-MenuBar-itemLabel", has_text=re.compile(f"^{menu}$")).click()
        self.page.locator(".lm-Menu-itemLabel", has_text=re.compile(f"^{item}$")).click()

    def cells(self) -> list:
        return [
            cell
            for cell in nbformat.read(self.file, as_version=4).cells
            if cell.cell_type == "code"
        ]

    def has_run(self) -> bool:
        indicator = self.page.locator(".jp-Notebook-ExecutionIndicator").first
        if indicator.get_attribute("data-status") != "idle":
            return False
        self.choose("File", "Save Notebook")

        def saved() -> bool:
            try:
                return all(cell.execution_count for cell in self.cells())
            except nbformat.reader.NotJSONError:  # it is being written
                return False

        return wait_for(saved, 5, 0.5)

    def screenshot(self, name: str) -> np.ndarray:
        png = self.page.screenshot()
        if artefacts := os.environ.get("SFMKIT_ARTEFACTS"):
            Path(artefacts).mkdir(parents=True, exist_ok=True)
            (Path(artefacts) / f"lab-{self.name[:2]}-{name}.png").write_bytes(png)
        return np.asarray(PIL.Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

    def assert_quiet(self) -> None:
        for cell in self.cells():
            for out in cell.outputs:
                assert out.output_type != "error", cell.source
                assert out.get("name") != "stderr", out.text
        assert self.page.locator(".jp-OutputArea-error").count() == 0
        # The viewer asks for its newest release; it shows all the same when there is no answer.
        assert self.asked - {"", *HERE} <= {"api.github.com"}

    def on_screen(self, picture: int, x: np.ndarray) -> np.ndarray:
        """(2,) where pixel x of the explorer's picture lies on the screen."""
        return np.array(
            self.page.locator("svg.sfmkit-photograph")
            .nth(picture)
            .evaluate(
                "(svg, [x, y]) => { const p = new DOMPoint(x, y).matrixTransform(svg.getScreenCTM()); return [p.x, p.y]; }",
                list(map(float, x)),
            )
        )

    def explored(self) -> tuple[np.ndarray, np.ndarray]:
        """The pixel of image 1 that is shown, and the ends (2, 2) of the line that is drawn for
        it."""
        mark = self.page.locator("circle.pixel")
        points = self.page.locator("polyline.epipolar-line").get_attribute("points")
        ends = np.array([[float(v) for v in p.split(",")] for p in points.split()])
        return np.array([float(mark.get_attribute(a)) for a in ("cx", "cy")]), ends

    def click_image1(self, x: tuple[float, float]) -> None:
        before = self.page.locator("circle.pixel").get_attribute("cx")

        def answered() -> bool:
            """The page may still have been moving under the mouse: then the click is repeated."""
            self.page.locator("svg.sfmkit-photograph").first.scroll_into_view_if_needed()
            self.page.mouse.click(*self.on_screen(0, np.array(x)))
            return wait_for(
                lambda: self.page.locator("circle.pixel").get_attribute("cx") != before, 15, 0.05
            )

        assert wait_for(answered, 60)


def true_pixels(pair, x1: np.ndarray) -> np.ndarray:
    """(N, 2) where pixel x1 of image 1 may lie in image 2, by the scene's true cameras: near, far
    and in between."""
    depths = np.geomspace(3, 60, 40)[:, None]
    X2 = depths * (np.linalg.inv(pair.camera1.K) @ [*x1, 1]) @ pair.R.T + pair.t * baseline(pair)
    projected = X2 @ pair.camera2.K.T
    return projected[:, :2] / projected[:, 2:]


def baseline(pair) -> float:
    return 1 / np.linalg.norm(pair.t)  # the direction alone matters to the line


def assert_the_line_is_true(pair, x1: np.ndarray, ends: np.ndarray) -> None:
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    normal = np.array([-along[1], along[0]])
    assert np.abs((true_pixels(pair, x1) - ends[0]) @ normal).max() < 0.5


@pytest.fixture(scope="module")
def epipolar(browser, lab):
    notebook = Notebook(browser, lab, "04_epipolar_geometry.ipynb")
    yield notebook
    notebook.page.close()


def test_the_quick_start_runs(browser, lab):
    notebook = Notebook(browser, lab, "00_quick_start.ipynb")
    notebook.screenshot("run")
    notebook.assert_quiet()
    pictures = sum(
        "image/png" in out.get("data", {}) for cell in notebook.cells() for out in cell.outputs
    )
    assert pictures == 3
    notebook.page.close()


def test_the_lesson_runs_without_the_web(epipolar):
    epipolar.assert_quiet()
    epipolar.page.wait_for_selector("canvas", timeout=120_000)


@pytest.mark.parametrize("x1", [(350.0, 410.0), (700.5, 250.25), (520.0, 640.0)])
def test_a_click_draws_the_line_that_the_true_cameras_give(epipolar, bundled, x1):
    epipolar.click_image1(x1)
    clicked, ends = epipolar.explored()
    assert np.abs(clicked - x1).max() < 3  # a pixel of the screen is that many of the photograph
    assert_the_line_is_true(bundled, clicked, ends)
    w, h = bundled.camera2.size_wh
    inside = [x for x in true_pixels(bundled, clicked) if 20 < x[0] < w - 20 and 20 < x[1] < h - 20]
    assert inside
    shot = epipolar.screenshot("click")

    def yellow(x: np.ndarray) -> bool:
        column, row = np.round(epipolar.on_screen(1, x)).astype(int)
        near = shot[row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3)
        return np.abs(near - YELLOW).max(1).min() < 90

    # Keypoints along the line are drawn over it.
    assert np.mean([yellow(x) for x in inside]) > 0.5, "the line is not drawn where it should be"


def test_a_click_on_a_match_gives_its_point_and_the_ray(epipolar):
    epipolar.click_image1((500.0, 374.5))
    page = epipolar.page
    for k in range(40):  # the wall is full of matches; not every pixel is near one
        if page.locator("circle.match").count() == 2:
            break
        epipolar.click_image1((400.0 + 7 * k, 330.0 + 3 * k))
    assert page.locator("circle.match").count() == 2
    assert page.locator("circle.point").count() == 1
    assert "its point lies at" in page.locator(".jp-OutputArea").nth(1).inner_text()
    ray, point = page.locator("polyline.ray"), page.locator("circle.point")
    (x0, y0), (x1, y1) = (
        [float(v) for v in p.split(",")] for p in ray.get_attribute("points").split()
    )
    x, y = (float(point.get_attribute(a)) for a in ("cx", "cy"))
    off = abs((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / np.hypot(x1 - x0, y1 - y0)
    assert (
        off < 5
    )  # the point was triangulated from the match, which may lie a few pixels from the click
    page.locator("svg.sfmkit-map").scroll_into_view_if_needed()
    epipolar.screenshot("ray")


def test_a_slider_answers_within_a_third_of_a_second(epipolar):
    epipolar.click_image1((450.0, 500.0))
    page = epipolar.page
    handle = page.locator(".noUi-handle").first
    handle.focus()
    taken = []
    for _ in range(6):
        before = page.locator("circle.candidate").count()
        start = time.perf_counter()
        page.keyboard.press("ArrowRight")
        assert wait_for(
            lambda before=before: page.locator("circle.candidate").count() != before, 20, 0.005
        )
        taken.append(time.perf_counter() - start)
    assert min(taken) < 0.3, (
        taken
    )  # the best: other work on the machine is no property of the slider


def test_the_viewer_draws_and_a_keypoint_clicked_in_it_is_answered(epipolar, bundled):
    page = epipolar.page
    canvas = page.locator("canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box["x"] + box["width"] <= page.viewport_size["width"]

    def drawn() -> bool:
        shot = epipolar.screenshot("viewer")
        x0, y0, x1, y1 = (
            round(v)
            for v in (box["x"], box["y"], box["x"] + box["width"] / 2, box["y"] + box["height"])
        )
        return (
            len(np.unique(shot[y0 + TOP + TITLE : y1 - BOTTOM, x0:x1].reshape(-1, 3), axis=0))
            > 1000
        )

    assert wait_for(drawn, 120, 1), "the viewer stays blank"
    image = read_image(bundled.image1)
    keypoints = np.concatenate([detect(image, name).keypoints for name in OPERATORS]).astype(float)
    w, h = image.size_wh
    view = np.array([box["width"] / 2, box["height"] - TOP - TITLE - BOTTOM])
    scale = min(view / (w, h))
    corner = np.array([box["x"], box["y"] + TOP + TITLE]) + (view - scale * np.array([w, h])) / 2
    seen: list[np.ndarray] = []
    before, _ = epipolar.explored()

    def answered(target: np.ndarray) -> bool:
        """After a click on the target, a keypoint near it is explored."""
        place = corner + scale * (target + 0.5)
        page.mouse.move(*place)
        time.sleep(
            3
        )  # a frame takes a while without a graphics card, and picking is a frame behind
        page.mouse.click(*place)
        return wait_for(lambda: not np.allclose(epipolar.explored()[0], before), 10)

    for target in loneliest(keypoints, 8):
        if answered(target):
            seen.append(target)
            break
    epipolar.screenshot("keypoint")
    assert seen, "no click on a keypoint was answered"
    x1, ends = epipolar.explored()
    assert np.abs(keypoints - x1).max(1).min() < 1e-2, "what is explored is no keypoint"
    assert np.linalg.norm(x1 - seen[0]) < 8 / scale
    assert_the_line_is_true(bundled, x1, ends)


def loneliest(x: np.ndarray, n: int) -> np.ndarray:
    """(n, 2) of the points, those with the most room around them."""
    from scipy.spatial import cKDTree

    different = np.unique(np.round(x, 2), axis=0)
    room = cKDTree(different).query(different, k=2)[0][:, 1]
    return different[np.argsort(-room)[:n]]


def test_the_keyboard_stays_with_the_notebook(epipolar):
    """The viewer takes the keyboard only when it is clicked."""
    page = epipolar.page
    page.locator(".jp-MarkdownCell").first.click()
    time.sleep(0.6)
    page.evaluate("document.querySelector('canvas').focus()")
    assert page.evaluate("document.activeElement.tagName") != "CANVAS"
