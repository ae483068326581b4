"""The Rerun viewer inside a notebook, without a network."""

from __future__ import annotations

import os
from typing import Any

from ..pipeline import Reconstruction

# Read when rerun_notebook is imported: the viewer's page comes from this machine instead of the web.
os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")

import rerun as rr
from rerun import notebook

from .blueprint import default_blueprint
from .rerun import log_reconstruction


def recording_viewer(result: Reconstruction, *, width: int = 1000, height: int = 640) -> Any:
    """A widget that shows the whole reconstruction; ``.on_event`` tells what is selected in it.

    Args:
        width, height: of the viewer, in pixels of the page.
    """
    rec = rr.RecordingStream("sfmkit", send_properties=False)
    viewer = notebook.Viewer(width=width, height=height, recording=rec, blueprint=default_blueprint(result))
    log_reconstruction(rec, result)
    return viewer
