"""The layout of a recording in the viewer: pages of named views, one page per question."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import rerun.blueprint as rrb

from ..errors import InputError
from .stream import Size, beside

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction

_UP = (0, -1, 0)  # the frame of camera 1 has y down
# Direction of view into the scene, from behind, above and the left of the cameras.
_FORWARD = np.array([-0.35, 0.42, 0.84])
_FIELD = np.tan(np.radians(55 / 2))  # half the viewer's vertical field of view
_ASPECT = 1.25  # width over height of the narrowest 3-D view at 1280 x 800
LEGEND_SHARE = 6  # a page is this many times higher than its legend


@dataclass(frozen=True, eq=False)
class Layout:
    """What the layout of the views depends on; the viewer fits views for which it is not given.

    Attributes:
        sizes_wh: sizes of both images, pixels.
        seen: (M, 3) points that the 3-D views must contain, baselines.
        cloud, covariance, history: whether there are a cloud, covariances of its points and a
            history of the robust estimate.
        prefix: of the entity paths.
    """

    sizes_wh: tuple[Size, Size] | None = None
    seen: np.ndarray | None = None
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
        seen=_seen(result),
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
    legend = rrb.Spatial2DView(origin=f"{layout.root}/legend", name="Colours")
    return rrb.Vertical(page, legend, row_shares=[LEGEND_SHARE, 1], name=name)


def _image(layout: Layout, number: int, name: str, *what: str) -> rrb.Spatial2DView:
    """Photograph `number` with entities below it; paths that start with / are projected onto it."""
    origin = f"{layout.root}/world/cam{number}/image"
    contents = [f"{origin}/photo", *(e if e.startswith("/") else f"{origin}/{e}" for e in what)]
    bounds = None
    if layout.sizes_wh is not None:
        w, h = layout.sizes_wh[number - 1]
        bounds = rrb.VisualBounds2D(x_range=(-0.5, w - 0.5), y_range=(-0.5, h - 0.5))
    return rrb.Spatial2DView(origin=origin, contents=contents, name=name, visual_bounds=bounds)


def _space(layout: Layout, name: str, *what: str, near: bool = False) -> rrb.Spatial3DView:
    """The scene from behind and above the cameras; only the cameras' surroundings if `near`."""
    world = f"{layout.root}/world"
    cameras = [f"{world}/cam{i}{rest}" for i in (1, 2) for rest in ("", "/image", "/image/photo")]
    seen = layout.seen
    if near:
        seen = np.array([[x, y, z] for x in (-1.3, 1.3) for y in (-0.6, 0.6) for z in (-0.6, 0.6)])
    eye = None
    if seen is not None:
        position, target = eye_for(seen)
        eye = rrb.EyeControls3D(position=position, look_target=target, eye_up=_UP)
    return rrb.Spatial3DView(
        origin=world,
        contents=[world, *cameras, *(f"{world}/{e}" for e in what)],
        name=name,
        eye_controls=eye,
        line_grid=False,
    )


def eye_for(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place the eye so that all points (M, 3) are inside the view.

    Returns:
        position and target (3,) of the eye.
    """
    forward = _FORWARD / np.linalg.norm(_FORWARD)
    right = np.cross(forward, _UP)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    local = points @ np.stack([right, up, forward], axis=1)
    middle = (local.min(0) + local.max(0)) / 2
    x, y, z = (local - middle).T
    distance = max((np.abs(x) / (_FIELD * _ASPECT) - z).max(), (np.abs(y) / _FIELD - z).max())
    target = np.stack([right, up, forward], axis=1) @ middle
    return target - 1.05 * distance * forward, target


def _seen(result: Reconstruction) -> np.ndarray:
    """Points that the 3-D views must contain: both cameras as drawn, and the middle of the cloud.

    The outermost 3 % of the cloud in each direction may lie outside.
    """
    view, cloud = result.two_view, result.cloud
    depth = float(cloud.xyz[:, 2].median()) if cloud is not None and len(cloud) else 4.0
    inside = []
    for camera, R, t in ((view.camera1, None, None), (view.camera2, view.R, view.t)):
        w, h = camera.size_wh
        corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1.0]])
        frustum = 0.15 * depth * corners @ np.linalg.inv(camera.K).T
        frustum = np.concatenate([np.zeros((1, 3)), frustum])
        if R is not None:
            frustum = (frustum - (0 if t is None else t.numpy())) @ R.numpy()
        inside.append(frustum)
    if cloud is not None and len(cloud):
        low, high = np.percentile(cloud.xyz.numpy(), (3, 97), axis=0)
        xyz = cloud.xyz.numpy()
        inside.append(xyz[((xyz >= low) & (xyz <= high)).all(1)])
    return np.concatenate(inside)


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
            _image(layout, 1, "Image 1: what is left at this stage", *left),
            _image(layout, 2, "Image 2: what is left at this stage", *left),
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
    every = [_image(layout, i, f"Image {i}: all keypoints", "keypoints/**") for i in (1, 2)]
    return rrb.Vertical(rrb.Horizontal(*regions), rrb.Horizontal(*every))


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
        rrb.BarChartView(origin=f"{root}/estimation/improvements", name="Inliers per improvement"),
        rrb.TimeSeriesView(origin=f"{root}/estimation", name="On the timeline iteration"),
    ]
    return rrb.Vertical(
        rrb.Horizontal(*(_image(layout, i, f"Image {i}: epipolar lines", *what) for i in (1, 2))),
        rrb.Horizontal(
            _space(layout, "Four poses: points in front", "poses/**", near=True),
            rrb.Tabs(
                *(charts if layout.history else []),
                rrb.TextDocumentView(origin=f"{root}/verdict", name="Verdict and evidence"),
                active_tab=0,
            ),
        ),
    )


def _motion(layout: Layout) -> rrb.Horizontal:
    return rrb.Horizontal(
        _space(layout, "Four poses: points in front of both", "poses/**", near=True),
        _space(layout, "Chosen pose", "baseline", near=True),
    )


def _cloud(layout: Layout) -> rrb.Grid:
    views = [
        _space(layout, "Photograph", "points/photograph"),
        _space(layout, "Operator", "points/operator"),
        _space(layout, "Density (yellow: dense)", "points/density"),
    ]
    if layout.covariance:
        what = ("points/uncertainty", "ellipsoids")
        views.append(_space(layout, "Uncertainty (yellow: uncertain)", *what))
    else:
        views.append(_image(layout, 1, "Residuals, 50 times longer", "residuals"))
    return rrb.Grid(*views, grid_columns=2)


def _triangulation(layout: Layout) -> rrb.Horizontal:
    return rrb.Horizontal(
        _space(layout, "Two rays meet in a point", "points/photograph", "rays", "baseline"),
        _space(layout, "Parallax (yellow: large)", "points/parallax", "baseline"),
    )


def _refinement(layout: Layout) -> rrb.Horizontal:
    what = ("points/uncertainty", "ellipsoids", "refinement/**")
    return rrb.Horizontal(
        _space(layout, "Uncertainty (yellow: uncertain) and camera 2", *what),
        rrb.TimeSeriesView(origin=f"{layout.root}/refinement", name="Cost, on the timeline step"),
    )


def _robust(layout: Layout) -> rrb.Vertical:
    images = [_image(layout, i, f"Image {i}: epipolar lines", "epipolar/**") for i in (1, 2)]
    root = layout.root
    return rrb.Vertical(
        rrb.Horizontal(*images),
        rrb.Horizontal(
            rrb.BarChartView(origin=f"{root}/estimation/improvements", name="Inliers"),
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
    root = layout.root
    bars = [
        rrb.BarChartView(
            origin=f"{root}/account/chart/{quantity}",
            name=quantity,
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for quantity in QUANTITIES
    ]
    times = rrb.BarChartView(
        origin=f"{root}/timings", name="seconds", plot_legend=rrb.PlotLegend(visible=True)
    )
    return rrb.Horizontal(
        rrb.TextDocumentView(origin=f"{root}/summary", name="Per-operator statistics"),
        rrb.Grid(*bars, times, grid_columns=2),
        column_shares=[3, 2],
    )


# what the bars of the page *Account* count
QUANTITIES = ("keypoints", "matches", "fused", "inliers", "points")

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
    "Triangulation": _triangulation,
    "Cloud": _cloud,
    "Refinement": _refinement,
    "Runs": _runs,
    "Account": _account,
}
