"""The explorables in a browser: their numbers are those of the library, also without a kernel."""

from __future__ import annotations

import json
import os
import re
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from chromium import open_browser, wait_for
from made_up_result import make_result
from scipy.spatial.transform import Rotation

from sfmkit.errors import InputError
from sfmkit.estimation.verdict import assess
from sfmkit.geometry.fundamental import (
    epipolar_lines,
    epipoles,
    fundamental_7point,
    fundamental_8point,
    fundamental_from_pose,
    signed_sampson_distance,
)
from sfmkit.geometry.losses import marginal_score
from sfmkit.io.images import read_image
from sfmkit.notebook.explorables import HomographyOrDepth, RansacSteps, TwoCameras
from sfmkit.notebook.explorables.bundle import bundle
from sfmkit.types import Verdict

ROOT = Path(__file__).parents[2]
MODULES = ("homography_or_depth", "ransac", "two_cameras")
SIZE = (640, 480)
VERDICTS = {
    "general": Verdict.GENERAL,
    "planar": Verdict.PLANAR,
    "rotation": Verdict.PURE_ROTATION,
}


@pytest.fixture(scope="module")
def result():
    """A reconstruction whose photographs are a grey ramp."""
    ramp = np.add.outer(np.linspace(60, 160, SIZE[1]), np.linspace(0, 60, SIZE[0]))
    rgb = np.repeat(ramp[..., None], 3, axis=2).astype(np.uint8)
    made = make_result(points=400, size_wh=SIZE, image=rgb)
    return replace(made, images=(read_image(rgb), read_image(rgb)))


@pytest.fixture(scope="module")
def browser():
    with open_browser() as browser:
        yield browser


@pytest.fixture
def page(browser):
    """A page without a network, whose errors fail the test."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.route(re.compile("^(http|https|ws)"), lambda route: route.abort())
    yield page
    page.close()
    assert not errors


def test_a_bundle_imports_nothing():
    for name in MODULES:
        source = bundle(name)
        assert not re.search(r"^import ", source, re.MULTILINE)
        assert not re.search(r"^export (?!default)", source, re.MULTILINE)
        assert source.count("export default { render };") == 1
        names = re.findall(r"^(?:const|let|function) (\w+)", source, re.MULTILINE)
        assert len(names) == len(set(names))
        assert "http" not in source.replace("http://www.w3.org/2000/svg", "")


def kit(page, module: str, names: str):
    """Evaluate expressions with the functions of a module in the page."""
    page.set_content("<main></main>")
    page.add_script_tag(content=f"{bundle(module)}\nglobalThis.kit = {{ {names} }};", type="module")
    page.wait_for_function("globalThis.kit !== undefined")
    return lambda expression, argument: page.evaluate(f"(a) => {expression}", argument)


def tensor(values) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float64)


def same_up_to_scale(a, b, tolerance=1e-9) -> bool:
    a, b = np.ravel(a) / np.linalg.norm(a), np.ravel(b) / np.linalg.norm(b)
    return min(np.abs(a - b).max(), np.abs(a + b).max()) < tolerance


@pytest.mark.browser
def test_the_geometry_in_javascript_agrees_with_the_library(page, result):
    names = "fundamental, lineOf, epipoles, sampson, fundamental7, fundamental8"
    js = kit(page, "two_cameras", f"{names}, anglesOf, rotationOf")
    view = result.two_view
    K1, K2 = (camera.tensors()[0] for camera in (view.camera1, view.camera2))
    x1, x2 = (x[view.inliers] for x in (result.correspondences.x1, result.correspondences.x2))
    F = fundamental_from_pose(view.R, view.t, K1, K2)
    arguments = {
        "F": F.tolist(),
        "R": view.R.tolist(),
        "t": view.t.tolist(),
        "K": [K1.tolist(), K2.tolist()],
        "x1": x1[:60].tolist(),
        "x2": x2[:60].tolist(),
    }
    assert same_up_to_scale(js("kit.fundamental(a.R, a.t, a.K[0], a.K[1])", arguments), F)
    lines = js("a.x1.map((x) => kit.lineOf(a.F, x))", arguments)
    np.testing.assert_allclose(lines, epipolar_lines(F, x1[:60]), atol=1e-6)
    for mine, theirs in zip(js("kit.epipoles(a.F)", arguments), epipoles(F)):
        assert same_up_to_scale(mine, theirs)
    distances = js("a.x1.map((x, k) => kit.sampson(a.F, x, a.x2[k]))", arguments)
    np.testing.assert_allclose(distances, signed_sampson_distance(F, x1[:60], x2[:60]), atol=1e-9)
    eight = js("kit.fundamental8(a.x1, a.x2)", arguments)
    assert same_up_to_scale(eight, fundamental_8point(x1[:60], x2[:60]), 1e-7)
    seven = js("kit.fundamental7(a.x1.slice(0, 7), a.x2.slice(0, 7))", arguments)
    expected, valid = fundamental_7point(x1[:7][None], x2[:7][None])
    assert len(seven) == int(valid.sum())
    for f in expected[valid]:
        assert any(same_up_to_scale(mine, f, 1e-6) for mine in seven)
    np.testing.assert_allclose(
        js("kit.rotationOf(kit.anglesOf(a.R))", arguments), view.R, atol=1e-12
    )


@pytest.fixture
def two_cameras(page, result, tmp_path):
    """The page of the explorable, opened from a file."""
    path = TwoCameras(result).to_html(tmp_path / "cameras.html")
    assert path.stat().st_size < 2e6
    page.goto(path.as_uri())
    page.wait_for_selector(".sfmkit-explorable")
    return page


def state_of(page) -> dict:
    return page.evaluate("document.querySelector('.sfmkit-explorable').explorable.state")


def on_screen(page, picture: int, x) -> list[float]:
    """The position on the screen of pixel x of photograph 0 or 1."""
    return (
        page.locator("svg.photograph")
        .nth(picture)
        .evaluate(
            "(svg, [x, y]) => { const p = new DOMPoint(x, y).matrixTransform(svg.getScreenCTM());"
            " return [p.x, p.y]; }",
            list(map(float, x)),
        )
    )


def drawn_line(page, picture: int) -> np.ndarray:
    """The (2, 2) ends of the epipolar line drawn in a photograph, pixels."""
    svg = page.locator("svg.photograph").nth(picture)
    text = svg.locator("polyline.chosen-line").get_attribute("points")
    return np.array([[float(v) for v in p.split(",")] for p in text.split()])


def assert_the_line_is_the_librarys(page, result, picture: int) -> None:
    """Compare a drawn line with the library's for the pose and the pixel of the state."""
    state = state_of(page)
    turn = Rotation.from_euler("xyz", state["angles"], degrees=True).as_matrix()
    K1, K2 = (c.tensors()[0].clone() for c in (result.two_view.camera1, result.two_view.camera2))
    K2[:2, :2] *= state["f"]
    F = fundamental_from_pose(tensor(turn), tensor(state["t"]), K1, K2)
    pixel = tensor([matched(result, state, picture)])
    line = epipolar_lines(F if picture == 1 else F.T, pixel)[0].numpy()
    ends = drawn_line(page, picture)
    assert np.abs(np.c_[ends, np.ones(2)] @ line).max() < 0.5


def matched(result, state: dict, picture: int) -> list[float]:
    """The pixel of the match near the chosen one, as the page marks it, or the chosen one."""
    mine = result.correspondences.x1 if picture == 1 else result.correspondences.x2
    rows = result.cloud.match
    distance = (mine[rows] - tensor(state["pixel"])).norm(dim=1)
    near = float(distance.min()) < 0.02 * SIZE[0]
    return mine[rows][distance.argmin()].tolist() if near else state["pixel"]


@pytest.mark.browser
def test_clicks_drags_and_sliders_draw_the_librarys_lines(two_cameras, result):
    page = two_cameras
    screenshot(page, "two-cameras")
    for picture, other in ((0, 1), (1, 0)):
        page.mouse.click(*on_screen(page, picture, (250, 200)))
        assert state_of(page)["active"] == picture + 1
        assert np.abs(np.array(state_of(page)["pixel"]) - (250, 200)).max() < 2
        assert_the_line_is_the_librarys(page, result, other)
    page.mouse.move(*on_screen(page, 0, (300, 220)))
    page.mouse.down()
    for k in range(15):
        page.mouse.move(*on_screen(page, 0, (300 + 6 * k, 220 - 4 * k)))
    page.mouse.up()
    assert state_of(page)["pixel"][0] == pytest.approx(384, abs=2)
    assert_the_line_is_the_librarys(page, result, 1)
    for name, keys in (("rotation y", 30), ("t z", 20), ("focal length 2", 12)):
        page.get_by_label(name, exact=True).focus()
        for _ in range(keys):
            page.keyboard.press("ArrowRight")
        assert_the_line_is_the_librarys(page, result, 1)
    assert state_of(page)["median"] > 2  # the motion is not that of the matches any more
    page.click("button[data-key=estimated]")
    assert state_of(page)["median"] < 0.5
    median = page.evaluate("document.querySelector('.sfmkit-explorable').explorable.median()")
    print(f"median response of the two cameras: {median:.1f} ms")


@pytest.mark.browser
def test_the_motions_have_their_epipoles(two_cameras, result):
    page = two_cameras
    page.click("button[data-key=forward]")
    K = result.two_view.camera1.K
    epipole = page.locator("svg.photograph").first.locator("circle.epipole")
    assert float(epipole.get_attribute("cx")) == pytest.approx(K[0, 2], abs=0.5)
    assert float(epipole.get_attribute("cy")) == pytest.approx(K[1, 2], abs=0.5)
    page.click("button[data-key=sideways]")
    ends = drawn_line(page, 1)
    assert ends[0, 1] == pytest.approx(ends[1, 1], abs=0.01)
    page.click("button[data-key=rotating]")
    assert page.locator("polyline.chosen-line").count() == 0
    assert "no epipolar plane" in page.locator(".words").inner_text()


@pytest.mark.browser
def test_the_centre_of_camera_2_can_be_dragged(two_cameras):
    page = two_cameras
    box = page.locator(".handle circle").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    before = state_of(page)["t"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.evaluate("document.querySelector('.sfmkit-explorable').explorable.responses.length = 0")
    for k in range(1, 21):
        page.mouse.move(x + 2 * k, y)
    page.mouse.up()
    median = page.evaluate("document.querySelector('.sfmkit-explorable').explorable.median()")
    print(f"median response of dragging camera 2: {median:.1f} ms")
    moved = page.locator(".handle circle").bounding_box()
    assert moved["x"] + moved["width"] / 2 == pytest.approx(x + 40, abs=2)
    assert np.linalg.norm(np.subtract(state_of(page)["t"], before)) > 0.1


def screenshot(page, name: str) -> None:
    if folder := os.environ.get("SFMKIT_ARTEFACTS"):
        page.screenshot(path=str(Path(folder) / f"explorable-{name}.png"), full_page=True)


@pytest.fixture
def ransac(page, result, tmp_path):
    view, corr = result.two_view, result.correspondences
    images = (image.rgb for image in result.images)
    path = RansacSteps(*images, corr.x1, corr.x2, view.inliers).to_html(tmp_path / "ransac.html")
    page.goto(path.as_uri())
    page.wait_for_selector(".sfmkit-explorable")
    return page


@pytest.mark.browser
def test_the_score_and_the_stopping_rule_are_those_of_the_library(page):
    js = kit(page, "ransac", "samplesNeeded, marginalScore, fitLine")
    square = np.linspace(0, 1.5, 40)
    scores = js("a.map((square) => kit.marginalScore(square, 1.1))", square.tolist())
    np.testing.assert_allclose(scores, marginal_score(tensor(square), 1.1), atol=1e-9)
    for w, s in ((0.6, 2), (0.5, 7), (0.95, 4)):
        expected = int(np.ceil(np.log(1 - 0.99) / np.log(1 - w**s)))
        assert js("kit.samplesNeeded(0.99, a[0], a[1])", [w, s]) == expected
    x = np.random.default_rng(0).normal(size=(20, 2)) * (3, 0.2)
    normal = np.linalg.svd(x - x.mean(0))[2][1]
    assert same_up_to_scale(js("kit.fitLine(a)", x.tolist()), [*normal, -normal @ x.mean(0)])


@pytest.mark.browser
def test_ransac_finds_the_consensus_set_and_stops(ransac):
    page = ransac
    page.get_by_role("button", name="draw a sample").click()
    state = state_of(page)
    assert state["drawn"] == 1
    assert len(state["sample"]) == 2
    assert page.locator("circle.sample").count() == 2
    # The sample lies on its line, in the figure too.
    ends = page.locator("polyline.sample-line").get_attribute("points")
    p, q = (np.array([float(v) for v in point.split(",")]) for point in ends.split())
    for k in range(2):
        dot = page.locator("circle.sample").nth(k)
        x = np.array([float(dot.get_attribute(a)) for a in ("cx", "cy")])
        away = (q - p)[0] * (x - p)[1] - (q - p)[1] * (x - p)[0]
        assert abs(away) / np.linalg.norm(q - p) < 0.5
    page.get_by_role("button", name="draw until N").click()
    state = state_of(page)
    assert state["drawn"] >= state["needed"]
    w = state["best"]["consensus"] / 100
    assert state["needed"] == int(np.ceil(np.log(0.01) / np.log(1 - w**2)))
    screenshot(page, "ransac-line")


@pytest.mark.browser
def test_ransac_for_f_counts_the_consensus_set_of_the_library(ransac):
    page = ransac
    page.click("button[data-key=fundamental]")
    page.click("button[data-key=yes]")  # local optimisation
    page.get_by_role("button", name="draw until N").click()
    state = state_of(page)
    data = json.loads(page.locator("#data").text_content())
    wrong = round(state["wrong"] * len(data["right"]))
    matches = tensor([*data["wrong"][:wrong], *data["right"][wrong:]])
    F = tensor(state["best"]["model"])
    inside = signed_sampson_distance(F, matches[:, :2], matches[:, 2:]).abs() <= 1
    assert int(inside.sum()) == state["best"]["consensus"]
    assert state["best"]["consensus"] > 0.9 * (len(matches) - wrong)
    screenshot(page, "ransac-f")


@pytest.mark.browser
def test_the_comparison_shows_what_local_optimisation_changes(ransac):
    page = ransac
    page.get_by_role("button", name="compare many searches").click()
    assert wait_for(lambda: state_of(page)["comparison"]["done"] == 100, 60)
    rows = {(r["score"], r["optimise"]): r for r in state_of(page)["comparison"]["rows"]}
    for score in ("count", "marginal"):
        assert rows[score, True]["error"] < rows[score, False]["error"]


@pytest.fixture
def homography(page, tmp_path):
    page.goto(HomographyOrDepth().to_html(tmp_path / "homography.html").as_uri())
    page.wait_for_selector(".sfmkit-explorable")
    return page


def assert_the_verdict_is_the_librarys(state: dict) -> None:
    x1, x2, F, H, K = (tensor(state[name]) for name in ("x1", "x2", "F", "H", "K"))
    inliers = signed_sampson_distance(F, x1, x2).abs() < state["threshold"]
    found = assess(x1, x2, K, K, F, inliers, H, state["threshold"])
    names = {
        "general": Verdict.GENERAL,
        "planar": Verdict.PLANAR,
        "rotation": Verdict.PURE_ROTATION,
    }
    assert found.verdict is names[state["verdict"]]
    expected = {
        "sigma_px": state["sigma"],
        "share_off_plane": state["offPlane"],
        "share_off_rotation": state["offRotation"],
        **{f"gric_{name}": value for name, value in state["scores"].items()},
    }
    for name, value in expected.items():
        # The rotation is iterated until it changes by less than 1e-7.
        assert found.evidence[name] == pytest.approx(value, rel=1e-5), name


@pytest.mark.browser
def test_the_verdict_is_that_of_the_library_for_every_scene(homography):
    page = homography
    for key, verdict in (("plane", "planar"), ("depth", "general"), ("rotation", "rotation")):
        page.click(f"button[data-key={key}]")
        assert state_of(page)["verdict"] == verdict
        assert_the_verdict_is_the_librarys(state_of(page))


@pytest.mark.browser
def test_dragging_points_off_the_plane_changes_the_verdict(homography):
    page = homography
    point = page.locator("circle.scene-point").first.bounding_box()
    x, y = point["x"] + point["width"] / 2, point["y"] + point["height"] / 2
    seen = []
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(1, 9):
        page.mouse.move(x, y + 10 * k)
        seen.append(state_of(page)["verdict"])
        assert_the_verdict_is_the_librarys(state_of(page))
    page.mouse.up()
    screenshot(page, "homography-or-depth")
    assert seen[-1] == "general"
    assert state_of(page)["offPlane"] > 0.2
    median = page.evaluate("document.querySelector('.sfmkit-explorable').explorable.median()")
    print(f"median response of homography or depth: {median:.1f} ms")


@pytest.mark.browser
def test_an_exported_notebook_and_the_documentation_answer_without_a_kernel(page, result, tmp_path):
    """The same stored notebook, exported by nbconvert and built by Sphinx."""
    import nbformat
    from nbconvert import HTMLExporter
    from sphinx.application import Sphinx

    content, metadata = TwoCameras(result)._repr_mimebundle_()
    output = nbformat.v4.new_output("display_data", data=content, metadata=metadata)
    cells = [
        nbformat.v4.new_markdown_cell("# Two cameras"),
        nbformat.v4.new_code_cell("cameras", outputs=[output], execution_count=1),
    ]
    notebook = nbformat.v4.new_notebook(cells=cells)
    nbformat.write(notebook, tmp_path / "index.ipynb")
    exported = tmp_path / "exported.html"
    exported.write_text(HTMLExporter().from_notebook_node(notebook)[0])
    settings = runpy.run_path(str(ROOT / "docs" / "conf.py"))
    chosen = ("html_theme", "nb_mime_priority_overrides")
    Sphinx(
        srcdir=tmp_path,
        confdir=None,
        outdir=tmp_path / "site",
        doctreedir=tmp_path / "trees",
        buildername="html",
        status=None,
        confoverrides={
            "extensions": ["myst_nb"],
            "nb_execution_mode": "off",
            **{name: settings[name] for name in chosen},
        },
    ).build()
    for path in (exported, tmp_path / "site" / "index.html"):
        page.goto(path.as_uri())
        frame = page.frame_locator("iframe")
        picture = frame.locator("svg.photograph").first
        picture.scroll_into_view_if_needed()
        before = frame.locator("polyline.chosen-line").nth(1).get_attribute("points")
        picture.click(position={"x": 60, "y": 40})
        line = frame.locator("polyline.chosen-line").nth(1)
        assert wait_for(lambda line=line, before=before: line.get_attribute("points") != before, 20)


def test_data_that_an_explorable_cannot_show_are_refused(result):
    with pytest.raises(InputError, match="with a cloud"):
        TwoCameras(replace(result, cloud=None))
    x = result.correspondences.x1
    rgb = result.images[0].rgb
    with pytest.raises(InputError, match="16 right matches"):
        RansacSteps(rgb, rgb, x, x, np.zeros(len(x), bool))
    with pytest.raises(InputError, match="flags"):
        RansacSteps(rgb, rgb, x, x, np.ones(3, bool))
