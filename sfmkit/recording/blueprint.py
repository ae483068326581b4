"""How a recording is arranged in the viewer: pages of named views, one for each question."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import rerun.blueprint as rrb

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction

_UP = (0, -1, 0)  # the frame of camera 1 has y down
_FORWARD = np.array(
    [-0.35, 0.42, 0.84]
)  # the direction of the look into the scene: from behind, above, the right


def default_blueprint(result: Reconstruction, prefix: str = "") -> rrb.Blueprint:
    """Pages *Overview*, *Keypoints*, *Matches*, *Epipolar geometry*, *Cloud* and *Account*.

    Made for 1280 x 800 and more. Views of what the result does not have (no cloud, no covariance)
    are left out.
    """
    p = f"/{prefix.strip('/')}" if prefix.strip("/") else ""
    pages = [
        _overview(result, p),
        _keypoints(result, p),
        _matches(result, p),
        _epipolar(result, p),
        *([_cloud(result, p)] if result.cloud is not None else []),
        _account(p),
    ]
    return _arranged(pages)


def explorer_blueprint(result: Reconstruction) -> rrb.Blueprint:
    """For a notebook: the page *Explore*, where a keypoint of image 1 is clicked beside the scene,
    before the others.

    The panel of the selection is closed: what is selected is answered in the notebook.
    """
    ray = "explored/**"
    explore = rrb.Horizontal(
        _image(result, "", 1, "Image 1: click a keypoint", "keypoints/**"),
        _space(result, "", "Scene: the ray of the keypoint", "points/photograph", "baseline", ray),
        name="Explore",
    )
    others = [_matches(result, ""), _epipolar(result, "")]
    others += [] if result.cloud is None else [_cloud(result, "")]
    return _arranged([explore, *others], selection="collapsed")


def _arranged(
    pages: list[Any], selection: Literal["expanded", "collapsed"] = "expanded"
) -> rrb.Blueprint:
    # The viewer chooses the timeline `stage` by itself; named here, it warns until the first of it
    # has arrived.
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0),
        rrb.TimePanel(state="collapsed", fps=1),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state=selection),
    )


def _image(result: Reconstruction, p: str, number: int, name: str, *what: str) -> rrb.Spatial2DView:
    """Photograph `number` with some of the entities below it, or anywhere (they start with /)
    projected onto it."""
    origin = f"{p}/world/cam{number}/image"
    w, h = result.images[number - 1].size_wh
    contents = [f"{origin}/photo", *(e if e.startswith("/") else f"{origin}/{e}" for e in what)]
    return rrb.Spatial2DView(
        origin=origin,
        contents=contents,
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, w - 0.5), y_range=(-0.5, h - 0.5)),
    )


def _space(
    result: Reconstruction, p: str, name: str, *what: str, near: bool = False
) -> rrb.Spatial3DView:
    """The scene seen from behind and above the cameras; only their neighbourhood if `near`."""
    world = f"{p}/world"
    cameras = [f"{world}/cam{i}{rest}" for i in (1, 2) for rest in ("", "/image", "/image/photo")]
    corners = np.array([[-1.5, -1, -1], [1.5, 1, 1]]) if near else _extent(result)
    centre, radius = corners.mean(0), float(np.linalg.norm(np.ptp(corners, axis=0))) / 2
    # The viewer's field of view is about 55 degrees high; most of the box's corners are empty, so a
    # bit may be cut.
    eye = rrb.EyeControls3D(
        position=centre - 1.5 * radius * _FORWARD, look_target=centre, eye_up=_UP
    )
    return rrb.Spatial3DView(
        origin=world,
        contents=[world, *cameras, *(f"{world}/{e}" for e in what)],
        name=name,
        eye_controls=eye,
        line_grid=False,
    )


def _extent(result: Reconstruction) -> np.ndarray:
    """(2, 3) opposite corners of a box around both cameras and all but the outermost points."""
    view, cloud = result.two_view, result.cloud
    inside = [np.zeros((1, 3))]
    if view.R is not None and view.t is not None:
        inside.append(-(view.R.T @ view.t).numpy()[None])
    if cloud is not None and len(cloud):
        inside.append(np.percentile(cloud.xyz.numpy(), (3, 97), axis=0))
    everything = np.concatenate(inside)
    return np.stack([everything.min(0), everything.max(0)])


def _side_by_side(result: Reconstruction, p: str, name: str, what: str) -> rrb.Spatial2DView:
    from .stream import beside

    view = result.two_view
    width = beside((view.camera1, view.camera2)) + view.camera2.size_wh[0]
    height = max(view.camera1.size_wh[1], view.camera2.size_wh[1])
    origin = f"{p}/matches"
    return rrb.Spatial2DView(
        origin=origin,
        contents=[f"{origin}/photo1", f"{origin}/photo2", f"{origin}/{what}/**"],
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, width - 0.5), y_range=(-0.5, height - 0.5)),
    )


def _overview(result: Reconstruction, p: str) -> rrb.Horizontal:
    seen = ("survivors", "chosen", f"{p}/world/points/operator")
    return rrb.Horizontal(
        rrb.Vertical(
            _space(result, p, "Scene", "points/photograph", "rays", "baseline"),
            _side_by_side(result, p, "Inliers by operator", "inliers"),
            row_shares=[3, 2],
        ),
        rrb.Vertical(
            _image(result, p, 1, "Image 1: what is left at this stage", *seen),
            _image(result, p, 2, "Image 2: what is left at this stage", *seen),
            rrb.TextDocumentView(origin=f"{p}/story", name="Stage"),
            row_shares=[9, 9, 5],
        ),
        column_shares=[3, 2],
        name="Overview",
    )


def _keypoints(result: Reconstruction, p: str) -> rrb.Vertical:
    regions = [
        _image(result, p, i, f"Image {i}: strongest, with scale and orientation", "regions/**")
        for i in (1, 2)
    ]
    every = [_image(result, p, i, f"Image {i}: all keypoints", "keypoints/**") for i in (1, 2)]
    return rrb.Vertical(rrb.Horizontal(*regions), rrb.Horizontal(*every), name="Keypoints")


def _matches(result: Reconstruction, p: str) -> rrb.Grid:
    return rrb.Grid(
        _side_by_side(result, p, "Tentative", "tentative"),
        _side_by_side(result, p, "Merged duplicates", "merged"),
        _side_by_side(result, p, "Inliers", "inliers"),
        _side_by_side(result, p, "Outliers", "outliers"),
        grid_columns=2,
        name="Matches",
    )


def _epipolar(result: Reconstruction, p: str) -> rrb.Vertical:
    what = ("epipolar/**", "epipole", "homography")
    charts = [
        rrb.BarChartView(
            origin=f"{p}/estimation/improvements", name="Inliers, improvement by improvement"
        ),
        rrb.TimeSeriesView(origin=f"{p}/estimation", name="On the timeline iteration"),
    ]
    return rrb.Vertical(
        rrb.Horizontal(
            *(_image(result, p, i, f"Image {i}: epipolar lines", *what) for i in (1, 2))
        ),
        rrb.Horizontal(
            _space(
                result, p, "Four poses: points in front", "poses/**", "points/photograph", near=True
            ),
            rrb.Tabs(
                *(charts if result.two_view.history else []),
                rrb.TextDocumentView(origin=f"{p}/verdict", name="Verdict and evidence"),
                active_tab=0,
            ),
        ),
        name="Epipolar geometry",
    )


def _cloud(result: Reconstruction, p: str) -> rrb.Grid:
    views = [
        _space(result, p, "Photograph", "points/photograph"),
        _space(result, p, "Operator", "points/operator"),
        _space(result, p, "Density (yellow: dense)", "points/density"),
    ]
    if result.cloud is not None and result.cloud.covariance is not None:
        views.append(
            _space(result, p, "Uncertainty (yellow: uncertain)", "points/uncertainty", "ellipsoids")
        )
    else:
        views.append(_image(result, p, 1, "Residuals, 50 times longer", "residuals"))
    return rrb.Grid(*views, grid_columns=2, name="Cloud")


def _account(p: str) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(origin=f"{p}/summary", name="Account"),
        rrb.Vertical(
            rrb.BarChartView(
                origin=f"{p}/account/chart",
                name="Keypoints of image 1, matches, fused, inliers, points",
                plot_legend=rrb.PlotLegend(visible=True),
            ),
            rrb.BarChartView(
                origin=f"{p}/timings", name="Seconds", plot_legend=rrb.PlotLegend(visible=True)
            ),
        ),
        column_shares=[3, 2],
        name="Account",
    )
