"""The Rerun viewer as a notebook widget, served from this machine."""

from __future__ import annotations

import os
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

# rerun_notebook reads this when it is imported: it serves the viewer's page from this machine
# instead of fetching it from the web.
os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")

import rerun as rr

with redirect_stdout(None):  # it prints its address, which is not a result of the cell
    from rerun import notebook

from ..pipeline.reconstruction import Reconstruction
from .blueprint import explorer_blueprint
from .log import log_reconstruction
from .stream import APPLICATION, drain

_RAY = "world/explored"


class RecordingViewer(notebook.Viewer):
    """A viewer in a notebook; ``.on_event`` registers a callback for selections in it."""

    def __init__(self, *, width: Any = "auto", height: Any = 560, **settings: Any):
        super().__init__(width=width, height=height, **settings)

    @classmethod
    def of_file(cls, path: str | Path, **settings: Any) -> RecordingViewer:
        """A viewer of an .rrd file, with the layout that the file holds."""
        viewer = cls(use_global_recording=False, **settings)
        viewer._viewer.send_rrd(Path(path).read_bytes())
        return viewer


class ExplorerViewer(RecordingViewer):
    """A viewer of a reconstruction, into which rays can be drawn.

    The reconstruction and its layout are sent as one message by the calling thread. A stream that
    is connected to the viewer sends from a thread of its own, whose first messages can be lost or
    arrive after others while the viewer starts. Only the rays are sent that way.
    """

    def __init__(self, result: Reconstruction, **settings: Any):
        self._rec = rr.RecordingStream(APPLICATION, send_properties=False)
        log_reconstruction(self._rec, result)
        content = drain(self._rec, explorer_blueprint(result))
        super().__init__(use_global_recording=False, **settings)
        self._viewer.send_rrd(content)
        self.add_recording(self._rec)

    def show_ray(self, ray: np.ndarray, point: np.ndarray | None) -> None:
        """Draw a ray in place of the last one.

        Args:
            ray: (2, 3) its ends.
            point: (3,) a point on it, or None.
        """
        self._rec.log(
            f"{_RAY}/ray",
            rr.LineStrips3D([ray], colors=(0, 0, 0), radii=rr.Radius.ui_points(1.2)),
            static=True,
        )
        points = np.zeros((0, 3)) if point is None else point[None]
        dot = rr.Points3D(points, colors=(0, 0, 0), radii=rr.Radius.ui_points(5))
        self._rec.log(f"{_RAY}/point", dot, static=True)
        self._rec.flush()
