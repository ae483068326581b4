"""The Rerun viewer inside a notebook, without a network."""

from __future__ import annotations

import os
from contextlib import redirect_stdout
from typing import Any

import anywidget
import numpy as np
from IPython.display import display

from ..pipeline.reconstruction import Reconstruction

# Read when rerun_notebook is imported: the viewer's page comes from this machine instead of the
# web.
os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")

import rerun as rr

with redirect_stdout(
    None
):  # it says that it serves the page, which is no result of a notebook's cell
    from rerun import notebook

from ..recording.blueprint import explorer_blueprint
from ..recording.log import log_reconstruction

_RAY = "world/explored"


class _KeptFocus(anywidget.AnyWidget):
    """Keeps the keyboard where it is when the viewer has loaded and takes it: else Ctrl+S saves the
    wrong thing."""

    _esm = """
    let meant = 0, last = null;
    document.addEventListener("pointerdown", (e) => { if (e.target.tagName === "CANVAS") meant = performance.now(); }, true);
    document.addEventListener("keydown", (e) => { if (e.key === "Tab") meant = performance.now(); }, true);
    document.addEventListener("focusin", (e) => {
      if (e.target.tagName !== "CANVAS" || performance.now() - meant < 500) last = e.target;
      else if (last !== null && last.isConnected) last.focus({ preventScroll: true });
      else e.target.blur();
    }, true);
    function render({ el }) { last = document.activeElement; el.style.display = "none"; }
    export default { render };
    """


class RecordingViewer(notebook.Viewer):
    """The viewer of a reconstruction, into which a ray can be drawn; ``.on_event`` tells what is
    selected in it."""

    def __init__(self, result: Reconstruction, *, width: Any, height: Any):
        self._rec = rr.RecordingStream("sfmkit", send_properties=False)
        super().__init__(
            width=width, height=height, recording=self._rec, blueprint=explorer_blueprint(result)
        )
        log_reconstruction(self._rec, result)

    def show_ray(self, ray: np.ndarray, point: np.ndarray | None) -> None:
        """Draw the ray between two points (2, 3) and, if there is one, a point on it (3,), in place
        of the last."""
        self._rec.log(
            f"{_RAY}/ray",
            rr.LineStrips3D([ray], colors=(0, 0, 0), radii=rr.Radius.ui_points(1.2)),
            static=True,
        )
        points = np.zeros((0, 3)) if point is None else point[None]
        dot = rr.Points3D(points, colors=(0, 0, 0), radii=rr.Radius.ui_points(5))
        self._rec.log(f"{_RAY}/point", dot, static=True)
        self._rec.flush()

    def _ipython_display_(self) -> None:
        display(_KeptFocus())
        super()._ipython_display_()


def recording_viewer(
    result: Reconstruction, *, width: Any = "auto", height: Any = 560
) -> RecordingViewer:
    """A widget that shows the whole reconstruction.

    Args:
        width, height: of the viewer, in pixels of the page; a width of ``"auto"`` is the cell's.
    """
    return RecordingViewer(result, width=width, height=height)
