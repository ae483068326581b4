"""How a recording is arranged in the viewer: pages of named views, one for each question."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun.blueprint as rrb

if TYPE_CHECKING:
    from ..pipeline import Reconstruction

_UP = (0, -1, 0)  # the frame of camera 1 has y down


def default_blueprint(result: Reconstruction, prefix: str = "", *, history: bool = False) -> rrb.Blueprint:
    """Pages *Overview*, *Keypoints*, *Matches*, *Epipolar geometry*, *Cloud* and *Account*.

    Made for 1280 x 800 and more. Views of what the result does not have (no cloud, no covariance) are left out.

    Args:
        history: whether the improvements of the robust estimator were logged.
    """
    p = f"/{prefix.strip('/')}" if prefix.strip("/") else ""
    pages = [
        _overview(result, p),
        _keypoints(result, p),
        _matches(result, p),
        _epipolar(result, p, history),
        *([_cloud(result, p)] if result.cloud is not None else []),
        _account(p),
    ]
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0),
        rrb.TimePanel(state="collapsed", timeline="stage", fps=1),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="expanded"),
    )


def _image(result: Reconstruction, p: str, number: int, name: str, *what: str) -> rrb.Spatial2DView:
    """Photograph `number` with some of the entities below it, or anywhere (they start with /) projected onto it."""
    origin = f"{p}/world/cam{number}/image"
    w, h = result.images[number - 1].size_wh
    contents = [f"{origin}/photo", *(e if e.startswith("/") else f"{origin}/{e}" for e in what)]
    return rrb.Spatial2DView(
        origin=origin, contents=contents, name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, w - 0.5), y_range=(-0.5, h - 0.5)),
    )  # fmt: skip


def _space(result: Reconstruction, p: str, name: str, *what: str, back: float = 1.0) -> rrb.Spatial3DView:
    """The scene seen from behind and above the cameras."""
    world = f"{p}/world"
    cameras = [f"{world}/cam{i}{rest}" for i in (1, 2) for rest in ("", "/image", "/image/photo")]
    cloud = result.cloud
    target = np.array([0, 0, 4.0])
    if cloud is not None and len(cloud):
        target = np.median(cloud.xyz.numpy(), axis=0)
    # Behind the cameras, above and to their right; what is looked at lies between them and the scene.
    depth = float(np.linalg.norm(target))
    eye = rrb.EyeControls3D(position=back * depth * np.array([0.4, -0.35, -0.4]), look_target=0.65 * target, eye_up=_UP)
    return rrb.Spatial3DView(
        origin=world, contents=[world, *cameras, *(f"{world}/{e}" for e in what)], name=name, eye_controls=eye,
        line_grid=False,
    )  # fmt: skip


def _side_by_side(result: Reconstruction, p: str, name: str, what: str) -> rrb.Spatial2DView:
    from .stream import beside

    view = result.two_view
    width = beside((view.camera1, view.camera2)) + view.camera2.size_wh[0]
    height = max(view.camera1.size_wh[1], view.camera2.size_wh[1])
    origin = f"{p}/matches"
    return rrb.Spatial2DView(
        origin=origin, contents=[f"{origin}/photo1", f"{origin}/photo2", f"{origin}/{what}/**"], name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.5, width - 0.5), y_range=(-0.5, height - 0.5)),
    )  # fmt: skip


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
    regions = [_image(result, p, i, f"Image {i}: strongest, with scale and orientation", "regions/**") for i in (1, 2)]
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


def _epipolar(result: Reconstruction, p: str, history: bool) -> rrb.Vertical:
    what = ("epipolar/**", "epipole", "homography")
    charts = [
        rrb.BarChartView(origin=f"{p}/estimation/improvements", name="Inliers, improvement by improvement"),
        rrb.TimeSeriesView(origin=f"{p}/estimation", name="On the timeline iteration"),
    ]
    return rrb.Vertical(
        rrb.Horizontal(*(_image(result, p, i, f"Image {i}: epipolar lines", *what) for i in (1, 2))),
        rrb.Horizontal(
            _space(result, p, "Four poses: points in front", "poses/**", "points/photograph", back=1.6),
            rrb.Tabs(
                *(charts if history else []),
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
        views.append(_space(result, p, "Uncertainty (yellow: uncertain)", "points/uncertainty", "ellipsoids"))
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
            rrb.BarChartView(origin=f"{p}/timings", name="Seconds", plot_legend=rrb.PlotLegend(visible=True)),
        ),
        column_shares=[3, 2],
        name="Account",
    )
