"""The layout of a recording in the viewer: pages of named views, one page per question."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..errors import InputError
from .eye import UP, eye_for, near_points, seen_points
from .log_photos import dot_size
from .scales import BAR_BOUNDS, LEGEND_BOUNDS
from .stream import Size, beside

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction

LEGEND_SHARE = 6  # a page is this many times higher than its legend


@dataclass(frozen=True, eq=False)
class Layout:
    """What the layout of the views depends on; the viewer fits views for which it is not given.

    Attributes:
        sizes_wh: sizes of both images, pixels.
        seen: (M, 3) points that the 3-D views must contain, baselines.
        cloud, covariance, history: whether there are a cloud, covariances of its points and a
            history of the robust estimate.
        near: (M, 3) points that the views of the four poses must contain, baselines.
        operators: names, for views of each operator's keypoints.
        points: number of points of the cloud; the more, the smaller are their dots in photographs.
        prefix: of the entity paths.
    """

    sizes_wh: tuple[Size, Size] | None = None
    seen: np.ndarray | None = None
    near: np.ndarray | None = None
    operators: tuple[str, ...] = ()
    points: int = 20_000
    cloud: bool = True
    covariance: bool = True
    history: bool = True
    prefix: str = ""

    @property
    def root(self) -> str:
        """The prefix as the start of an entity path."""
        return f"/{self.prefix.strip('/')}" if self.prefix.strip("/") else ""


def layout_of(result: Reconstruction, prefix: str = "") -> Layout:
    """The layout of a reconstruction."""
    view, cloud = result.two_view, result.cloud
    return Layout(
        sizes_wh=(result.images[0].size_wh, result.images[1].size_wh),
        seen=seen_points(result),
        near=near_points(result),
        operators=result.correspondences.operators,
        points=0 if cloud is None else len(cloud),
        cloud=cloud is not None,
        covariance=cloud is not None and cloud.covariance is not None,
        history=bool(view.history),
        prefix=prefix,
    )


def default_blueprint(result: Reconstruction, prefix: str = "") -> rrb.Blueprint:
    """Lay out a reconstruction: *Overview* to *Account*, made for 1280 x 800 and more.

    Views of what the result does not have (no cloud, no covariance) are left out.
    """
    layout = layout_of(result, prefix)
    names = ["Overview", "Keypoints", "Matches", "Epipolar geometry", "Cloud", "Account"]
    return make_blueprint([n for n in names if layout.cloud or n != "Cloud"], layout)


def explorer_blueprint(result: Reconstruction) -> rrb.Blueprint:
    """Lay out a reconstruction for a notebook: the page *Explore* before the others.

    The selection panel is closed, because the notebook shows the answer to a selection.
    """
    layout = layout_of(result)
    names = ["Explore", "Matches", "Epipolar geometry", "Cloud"]
    names = [n for n in names if layout.cloud or n != "Cloud"]
    return make_blueprint(names, layout, selection="collapsed")


def make_blueprint(
    pages: Sequence[str | tuple[str, Layout]],
    layout: Layout | None = None,
    *,
    selection: Literal["expanded", "collapsed"] = "expanded",
) -> rrb.Blueprint:
    """Lay out pages, the first of them open.

    Args:
        pages: names out of :data:`PAGES`, or (name, layout) for a page with a layout of its own.
        layout: what is known of the recording; default: everything may be there.
        selection: state of the selection panel.

    Raises:
        InputError: an unknown page.
    """
    known = layout or Layout()
    chosen = [(page, known) if isinstance(page, str) else page for page in pages]
    for name, _ in chosen:
        if name not in PAGES:
            raise InputError(f"there is no page {name!r}; the pages are {', '.join(PAGES)}")
    tabs = [_with_legend(PAGES[name](own), name, own) for name, own in chosen]
    # The viewer chooses the timeline `stage` itself; naming it here makes the viewer warn until the
    # first value has arrived.
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.TimePanel(state="collapsed", fps=1),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state=selection),
    )


def _with_legend(page: Any, name: str, layout: Layout) -> rrb.Vertical:
    """The views of a page above the legend and the colour bars of its quantities."""
    legend = _strip(f"{layout.root}/legend", "Colours", LEGEND_BOUNDS)
    scales = [
        _strip(f"{layout.root}/scale/{quantity}", words, BAR_BOUNDS)
        for quantity, words in SCALES.get(name, {}).items()
        if (layout.covariance or quantity != "uncertainty")
        and (layout.operators or quantity != "coverage")
    ]
    shares = [4, *[3] * len(scales)]
    below = rrb.Horizontal(legend, *scales, column_shares=shares) if scales else legend
    return rrb.Vertical(page, below, row_shares=[LEGEND_SHARE, 1], name=name)


def _strip(
    origin: str, name: str, bounds: tuple[tuple[float, float], tuple[float, float]]
) -> rrb.Spatial2DView:
    fixed = rrb.VisualBounds2D(x_range=bounds[0], y_range=bounds[1])
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=fixed)


def _image(layout: Layout, number: int, name: str, *what: str) -> rrb.Spatial2DView:
    """Photograph `number` with entities below it; paths that start with / are projected onto it."""
    origin = f"{layout.root}/world/cam{number}/image"
    contents = [f"{origin}/photo", *(e if e.startswith("/") else f"{origin}/{e}" for e in what)]
    bounds = None
    if layout.sizes_wh is not None:
        w, h = layout.sizes_wh[number - 1]
        bounds = rrb.VisualBounds2D(x_range=(-0.5, w - 0.5), y_range=(-0.5, h - 0.5))
    # Dots of the whole cloud would hide the photograph.
    thin = rr.Points3D.from_fields(radii=dot_size(layout.points))
    return rrb.Spatial2DView(
        origin=origin,
        contents=contents,
        name=name,
        visual_bounds=bounds,
        overrides={e: thin for e in what if e.startswith("/")},
    )


def _space(layout: Layout, name: str, *what: str, near: bool = False) -> rrb.Spatial3DView:
    """The scene from behind and above the cameras; only the cameras' surroundings if `near`."""
    world = f"{layout.root}/world"
    cameras = [f"{world}/cam{i}{rest}" for i in (1, 2) for rest in ("", "/image", "/image/photo")]
    seen = layout.seen
    if near:
        box = [[x, y, z] for x in (-1.3, 1.3) for y in (-1.3, 0.6) for z in (-0.6, 0.6)]
        seen = np.array(box) if layout.near is None else layout.near
    eye = None
    if seen is not None:
        position, target = eye_for(seen)
        eye = rrb.EyeControls3D(position=position, look_target=target, eye_up=UP)
    return rrb.Spatial3DView(
        origin=world,
        contents=[world, *cameras, *(f"{world}/{e}" for e in what)],
        name=name,
        eye_controls=eye,
        line_grid=False,
    )


def _side_by_side(layout: Layout, name: str, what: str) -> rrb.Spatial2DView:
    origin = f"{layout.root}/matches"
    bounds = None
    if layout.sizes_wh is not None:
        (w1, h1), (w2, h2) = layout.sizes_wh
        bounds = rrb.VisualBounds2D(
            x_range=(-0.5, beside(w1) + w2 - 0.5), y_range=(-0.5, max(h1, h2) - 0.5)
        )
    return rrb.Spatial2DView(
        origin=origin,
        contents=[f"{origin}/photo1", f"{origin}/photo2", f"{origin}/{what}/**"],
        name=name,
        visual_bounds=bounds,
    )


def _overview(layout: Layout) -> rrb.Horizontal:
    left = ("survivors", "chosen", f"{layout.root}/world/points/operator")
    return rrb.Horizontal(
        rrb.Vertical(
            _space(layout, "Scene", "points/photograph", "rays", "baseline", "note"),
            _side_by_side(layout, "Matches at this stage, a sample", "current"),
            row_shares=[3, 2],
        ),
        rrb.Vertical(
            _image(layout, 1, "Image 1 at this stage", *left),
            _image(layout, 2, "Image 2 at this stage", *left),
            rrb.TextDocumentView(origin=f"{layout.root}/story", name="Stage"),
            row_shares=[8, 8, 7],
        ),
        column_shares=[3, 2],
    )


def _explore(layout: Layout) -> rrb.Horizontal:
    ray = "explored/**"
    return rrb.Horizontal(
        _image(layout, 1, "Image 1: click a keypoint", "keypoints/**"),
        _space(layout, "Scene: the ray of the keypoint", "points/photograph", "baseline", ray),
    )


def _keypoints(layout: Layout) -> rrb.Vertical:
    regions = [
        _image(layout, i, f"Image {i}: strongest, with scale and orientation", "regions/**")
        for i in (1, 2)
    ]
    if layout.operators:
        below = [
            _image(
                layout,
                1,
                f"{name}, image 1",
                f"coverage/{rr.escape_entity_path_part(name)}",
            )
            for name in layout.operators
        ]
    else:
        below = [_image(layout, i, f"Image {i}: all keypoints", "keypoints/**") for i in (1, 2)]
    return rrb.Vertical(rrb.Horizontal(*regions), rrb.Grid(*below, grid_columns=min(len(below), 3)))


def _matches(layout: Layout) -> rrb.Grid:
    return rrb.Grid(
        _side_by_side(layout, "Tentative, a sample", "tentative"),
        _side_by_side(layout, "Merged duplicates, a sample", "merged"),
        _side_by_side(layout, "Inliers, a sample", "inliers"),
        _side_by_side(layout, "Outliers, a sample", "outliers"),
        grid_columns=2,
    )


def _fusion(layout: Layout) -> rrb.Vertical:
    return rrb.Vertical(
        _side_by_side(layout, "Tentative, a sample", "tentative"),
        _side_by_side(layout, "Merged duplicates, a sample", "merged"),
    )


def _homography(layout: Layout) -> rrb.Vertical:
    views = [_image(layout, i, f"Image {i}: the other's outline", "homography") for i in (1, 2)]
    return rrb.Vertical(
        rrb.Horizontal(*views),
        rrb.Horizontal(
            _side_by_side(layout, "Inliers, a sample", "inliers"),
            _side_by_side(layout, "Outliers, a sample", "outliers"),
        ),
    )


def _epipolar(layout: Layout) -> rrb.Vertical:
    what = ("epipolar/**", "epipole", "homography")
    root = layout.root
    charts = [
        _improvements(layout, "Inliers, one bar per improvement"),
        rrb.TimeSeriesView(origin=f"{root}/estimation", name="Iterations"),
    ]
    return rrb.Vertical(
        rrb.Horizontal(*(_image(layout, i, f"Image {i}: epipolar lines", *what) for i in (1, 2))),
        rrb.Horizontal(
            _space(
                layout, "Four poses: points in front (green: chosen)", "poses/**", "note", near=True
            ),
            rrb.Tabs(
                *(charts if layout.history else []),
                rrb.TextDocumentView(origin=f"{root}/verdict", name="Verdict"),
                active_tab=0,
            ),
        ),
    )


def _improvements(layout: Layout, name: str) -> rrb.BarChartView:
    origin = f"{layout.root}/estimation/improvements"
    return rrb.BarChartView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def _motion(layout: Layout) -> rrb.Horizontal:
    return rrb.Horizontal(
        _space(
            layout, "Four poses: points in front (green: chosen)", "poses/**", "note", near=True
        ),
        _space(layout, "Chosen pose", "baseline", near=True),
    )


def _rivals(layout: Layout) -> rrb.Horizontal:
    views = []
    for name, title in (("best", "Best motion"), ("rival", "Rival: another motion that fits")):
        own = replace(layout, prefix=f"{layout.prefix}/{name}")
        views.append(_space(own, title, "points/operator", "baseline"))
    return rrb.Horizontal(*views)


def _cloud(layout: Layout) -> rrb.Grid:
    views = [
        _space(layout, "Photograph", "points/photograph", "points/note"),
        _space(layout, "Operator", "points/operator", "points/note"),
        _space(layout, "Density: points per volume", "points/density", "points/note"),
    ]
    if layout.covariance:
        what = ("points/uncertainty", "ellipsoids", "points/note")
        views.append(_space(layout, "Uncertainty: standard deviation", *what))
    else:
        views.append(_image(layout, 1, "Residuals, 50 times longer", "residuals"))
    return rrb.Grid(*views, grid_columns=2)


def _triangulation(layout: Layout) -> rrb.Horizontal:
    return rrb.Horizontal(
        _space(layout, "Two rays meet in a point", "points/photograph", "rays", "baseline"),
        _space(layout, "Parallax: angle between the rays", "points/parallax", "baseline"),
    )


def _refinement(layout: Layout) -> rrb.Horizontal:
    what = ("points/uncertainty", "ellipsoids", "refinement/**")
    return rrb.Horizontal(
        _space(layout, "Uncertainty of the points, and camera 2", *what),
        rrb.TimeSeriesView(origin=f"{layout.root}/refinement", name="Cost, on the timeline step"),
    )


def _robust(layout: Layout) -> rrb.Vertical:
    images = [_image(layout, i, f"Image {i}: epipolar lines", "epipolar/**") for i in (1, 2)]
    root = layout.root
    return rrb.Vertical(
        rrb.Horizontal(*images),
        rrb.Horizontal(
            _improvements(layout, "Inliers, one bar per improvement"),
            rrb.TimeSeriesView(origin=f"{root}/estimation", name="On the timeline iteration"),
        ),
    )


def _runs(layout: Layout) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TimeSeriesView(origin=f"{layout.root}/runs", name="On the timeline run"),
        rrb.TextDocumentView(origin=f"{layout.root}/runs/row", name="The run"),
        column_shares=[2, 1],
    )


def _account(layout: Layout) -> rrb.Horizontal:
    root, hidden = layout.root, rrb.PlotLegend(visible=False)
    bars = [
        rrb.BarChartView(
            origin=f"{root}/account/chart/{quantity}",
            name=quantity,
            plot_legend=hidden,
        )
        for quantity in QUANTITIES
    ]
    times = rrb.BarChartView(origin=f"{root}/timings", name="seconds", plot_legend=hidden)
    return rrb.Horizontal(
        rrb.TextDocumentView(origin=f"{root}/summary", name="Per-operator statistics"),
        rrb.Grid(*bars, times, grid_columns=2),
        column_shares=[3, 2],
    )


# what the bars of the page *Account* count
QUANTITIES = ("keypoints", "matches", "fused", "inliers", "points")

# page -> the quantities that it shows as colours, and the titles of their colour bars
SCALES = {
    "Keypoints": {"coverage": "Keypoints per cell"},
    "Cloud": {
        "density": "Points per cubic baseline",
        "uncertainty": "Standard deviation, baselines",
    },
    "Triangulation": {"parallax": "Parallax, degrees"},
    "Refinement": {"uncertainty": "Standard deviation, baselines"},
}

#: name of a page -> its views
PAGES: dict[str, Callable[[Layout], Any]] = {
    "Overview": _overview,
    "Explore": _explore,
    "Keypoints": _keypoints,
    "Matches": _matches,
    "Fusion": _fusion,
    "Homography": _homography,
    "Robust estimation": _robust,
    "Epipolar geometry": _epipolar,
    "Motion": _motion,
    "Rivals": _rivals,
    "Triangulation": _triangulation,
    "Cloud": _cloud,
    "Refinement": _refinement,
    "Runs": _runs,
    "Account": _account,
}
