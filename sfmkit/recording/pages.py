"""A recording of single runs on several pairs of images, side by side: one page per pair.

``case1/worst``, ``case1/best`` and so on hold one run each, on the timeline ``run``. Homographies
have ``matches`` (as in any recording) and ``image2`` with the outline of image 1 where the truth
(white) and the estimate (magenta) map it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import torch

from .._utils.labels import label
from .._utils.writing import atomic_write
from ..geometry.homography import transfer
from ..io.images import Image
from ..pipeline.reconstruction import Reconstruction
from ..pipeline.registration import Registration
from . import marks
from .log import log_run
from .scales import log_legend
from .stream import GREY, MAGENTA, drain, new_stream, put, strokes

MAX_LINES = 80  # per operator, spread evenly over image 1
WHITE = (255, 255, 255)
# the viewer's image begins at a corner of the first pixel, not at its centre
_CORNER = rr.Transform3D(translation=[-0.5, -0.5, 0])


@dataclass(frozen=True, eq=False)
class RunPage:
    """One run to be recorded.

    Attributes:
        name: The prefix of its entities below that of its page: ``worst``.
        text: What the run was, as Markdown.
        images: The two images.
        result: What the run gave; None where it failed.
        H_true: (3, 3) true homography from pixels of image 1 to image 2, where known.
    """

    name: str
    text: str
    images: tuple[Image, Image]
    result: Reconstruction | Registration | None
    H_true: np.ndarray | None = None


def save_pages(
    path: str | Path, title: str, pages: Iterable[tuple[str, Sequence[RunPage]]]
) -> None:
    """Write one page per pair, with the runs of the pair side by side, to one .rrd file.

    Args:
        path: The file; it appears complete or not at all.
        title: The name of the recording.
        pages: Title and one or two runs of every page.

    Raises:
        OutputError: The file cannot be written.
    """
    with atomic_write(path) as temporary:
        rec = new_stream(label(Path(path).stem))
        try:
            rec.send_recording_name(title)
            views = [
                _log_page(rec, number, page, runs)
                for number, (page, runs) in enumerate(pages, start=1)
            ]
            rec.send_blueprint(
                rrb.Blueprint(
                    rrb.Tabs(*views, active_tab=0),
                    rrb.TimePanel(state="collapsed"),
                    rrb.BlueprintPanel(state="collapsed"),
                    rrb.SelectionPanel(state="collapsed"),
                )
            )
            temporary.write_bytes(drain(rec))
        finally:
            rec.disconnect()


def _log_page(
    rec: rr.RecordingStream, number: int, title: str, runs: Sequence[RunPage]
) -> rrb.Container:
    columns = []
    for index, run in enumerate(runs):
        prefix = f"case{number}/{run.name}"
        if isinstance(run.result, Reconstruction):
            log_run(rec, run.result, index, prefix)
        elif isinstance(run.result, Registration):
            log_registration(rec, run.images, run.result, index, prefix, H_true=run.H_true)
        put(rec, prefix, "about", rr.TextDocument(run.text, media_type="text/markdown"))
        columns.append(_views(f"/{prefix}", run.name, run))
    name = f"{number}: {title}"
    if len(columns) == 1:
        return rrb.Grid(*columns[0], grid_columns=2, name=name)
    return rrb.Horizontal(*(rrb.Vertical(*c, row_shares=[4, 5, 5, 6]) for c in columns), name=name)


def log_registration(
    rec: rr.RecordingStream,
    images: tuple[Image, Image],
    result: Registration,
    run: int,
    prefix: str = "",
    *,
    H_true: np.ndarray | None = None,
) -> None:
    """A homography at `run` on the timeline ``run``: matches side by side, and image 1's outline in
    image 2.

    Args:
        H_true: (3, 3) pixels of image 1 to image 2.
    """
    rec.set_time("run", sequence=run)
    corr, (w, h) = result.correspondences, images[0].size_wh
    shift = w + round(0.01 * (w + images[1].size_wh[0]))
    log_legend(rec, corr.operators, prefix)
    place = rr.Transform3D(translation=[shift - 0.5, -0.5, 0])
    for at, image, where in (
        ("matches/photo1", images[0], _CORNER),
        ("matches/photo2", images[1], place),
        ("image2/photo", images[1], _CORNER),
    ):
        put(rec, prefix, at, rr.Image(image.rgb, draw_order=-10).compress(jpeg_quality=80), where)
    x1, x2 = corr.x1.numpy(), corr.x2.numpy()
    inliers, operator = result.inliers.numpy(), corr.operator_id.numpy()
    for what, chosen in (("inliers", inliers), ("outliers", ~inliers)):
        for k, name in enumerate(corr.operators):
            rows = np.flatnonzero(chosen & (operator == k))
            rows = rows[marks.spread(x1[rows], MAX_LINES)] if len(rows) else rows
            look: dict[str, Any] = {"class_ids": k} if what == "inliers" else {"colors": GREY}
            lines = np.stack([x1[rows], x2[rows] + [shift, 0]], axis=1)
            put(
                rec,
                prefix,
                ["matches", what, name],
                strokes(lines, width=0.6, **look),
                stage="estimate",
            )
    for name, H, colour in (("truth", H_true, WHITE), ("estimate", result.H, MAGENTA)):
        if H is not None:
            outline = _outline(torch.as_tensor(H, dtype=torch.float64), (w, h))
            border = rr.LineStrips2D([outline], colors=colour, radii=rr.Radius.ui_points(1.2))
            put(rec, prefix, ["image2/outline", name], border, stage="estimate")
    rec.disable_timeline("run")


def _outline(H: torch.Tensor, size_wh: tuple[int, int]) -> np.ndarray:
    """(N, 2) the border of image 1 in image 2, as far as it is not sent to infinity or far beyond
    anything visible."""
    w, h = size_wh
    corners = torch.tensor(
        [[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1], [0, 0]], dtype=torch.float64
    )
    steps = torch.linspace(0, 1, 33, dtype=torch.float64)[:, None]
    border = torch.cat([a + steps * (b - a) for a, b in pairwise(corners)])
    y = transfer(H, border).numpy()
    return y[np.isfinite(y).all(1) & (np.abs(y).max(1) < 10 * max(w, h))]


def _views(origin: str, name: str, run: RunPage) -> list[Any]:
    """The views of one run: what it was, inliers, outliers, and the outline or the cloud."""
    (w1, h1), (w2, h2) = (image.size_wh for image in run.images)
    width, height = w1 + round(0.01 * (w1 + w2)) + w2, max(h1, h2)
    sides = [
        rrb.Spatial2DView(
            origin=f"{origin}/matches",
            contents=[
                f"{origin}/matches/photo1",
                f"{origin}/matches/photo2",
                f"{origin}/matches/{what}/**",
            ],
            name=f"{name}: {what}",
            visual_bounds=rrb.VisualBounds2D(
                x_range=(-0.5, width - 0.5), y_range=(-0.5, height - 0.5)
            ),
        )
        for what in ("inliers", "outliers")
    ]
    if isinstance(run.result, Registration):
        bounds = rrb.VisualBounds2D(x_range=(-0.2 * w2, 1.2 * w2), y_range=(-0.2 * h2, 1.2 * h2))
        outline = rrb.Spatial2DView(
            origin=f"{origin}/image2", name=f"{name}: outline, true white", visual_bounds=bounds
        )
        views: list[Any] = [*sides, outline]
    else:
        world = f"{origin}/world"
        seen = [
            "",
            "/cam1",
            "/cam1/image",
            "/cam1/image/photo",
            "/cam2",
            "/cam2/image",
            "/cam2/image/photo",
            "/points/operator",
        ]
        views = [
            *sides,
            rrb.Spatial3DView(
                origin=world, contents=[world + e for e in seen], name=f"{name}: cloud"
            ),
        ]
    return [rrb.TextDocumentView(origin=f"{origin}/about", name=name), *views]
