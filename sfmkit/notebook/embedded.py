"""Recordings inside a notebook, without a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import anywidget
from IPython.display import display

from ..pipeline.reconstruction import Reconstruction
from ..recording import (
    Layout,
    make_blueprint,
    merge_recordings,
    recording_ids,
    write_stream,
)
from ..recording.embedded import ExplorerViewer, RecordingViewer

FOLDER = Path("out")  # where a notebook writes its recording
STORY = "story"  # the recordings of all lessons in one
PLANE = "plane"  # prefix of the lesson on homographies, whose photographs are others
FLOOR = "floor"  # prefix of the tiled floor, whose motion is ambiguous
STORY_PAGES = (
    "Keypoints",
    "Fusion",
    ("Homography", Layout(prefix=PLANE)),
    "Epipolar geometry",
    "Motion",
    ("Rivals", Layout(prefix=FLOOR)),
    "Triangulation",
    "Cloud",
    "Refinement",
)


class _KeptFocus(anywidget.AnyWidget):
    """Keeps the keyboard focus when the viewer has loaded and takes it.

    Without this, Ctrl+S after running a cell goes to the viewer instead of the notebook.
    """

    _esm = """
    let meant = 0, last = null;
    document.addEventListener("pointerdown", (e) => {
      if (e.target.tagName === "CANVAS") meant = performance.now();
    }, true);
    document.addEventListener("keydown", (e) => {
      if (e.key === "Tab") meant = performance.now();
    }, true);
    document.addEventListener("focusin", (e) => {
      if (e.target.tagName !== "CANVAS" || performance.now() - meant < 500) last = e.target;
      else if (last !== null && last.isConnected) last.focus({ preventScroll: true });
      else e.target.blur();
    }, true);
    function render({ el }) { last = document.activeElement; el.style.display = "none"; }
    export default { render };
    """


class _KeepsFocus:
    """Leaves the keyboard focus with the notebook when the viewer is displayed."""

    def _ipython_display_(self) -> None:
        display(_KeptFocus())
        super()._ipython_display_()  # type: ignore[misc]


class NotebookViewer(_KeepsFocus, RecordingViewer):
    """A recording in a notebook."""


class NotebookExplorer(_KeepsFocus, ExplorerViewer):
    """A reconstruction in a notebook, into which rays can be drawn."""


def recording_viewer(
    result: Reconstruction, *, width: Any = "auto", height: Any = 560
) -> NotebookExplorer:
    """Make a widget that shows a whole reconstruction.

    Args:
        width, height: of the viewer, in pixels of the page; a width of ``"auto"`` is the cell's.
    """
    return NotebookExplorer(result, width=width, height=height)


def save_lesson(
    rec: Any,
    name: str,
    pages: Sequence[str | tuple[str, Layout]],
    layout: Layout | None = None,
) -> Path:
    """Write what was logged to ``out/NAME.rrd``, and print the command that opens it.

    The recordings of all notebooks whose streams have the same name are also merged to
    ``out/story.rrd``, so that the lessons add up to one recording.

    Args:
        rec: stream of :func:`sfmkit.recording.new_stream`.
        name: of the file.
        pages: pages of the viewer, the first one open (:data:`sfmkit.recording.PAGES`).
        layout: what is known of the recording.

    Raises:
        InputError: an unknown page.
        OutputError: the file cannot be written.
    """
    blueprint = make_blueprint(pages, layout, selection="collapsed")
    FOLDER.mkdir(exist_ok=True)
    path = write_stream(rec, FOLDER / f"{name}.rrd", blueprint)
    print(f"sfmkit view {path}")
    parts = [p for p in sorted(FOLDER.glob("*.rrd")) if p.stem != STORY]
    parts = [p for p in parts if recording_ids(p) == {rec.get_recording_id()}]
    if len(parts) > 1:
        story = merge_recordings(FOLDER / f"{STORY}.rrd", parts, make_blueprint(STORY_PAGES))
        print(f"sfmkit view {story}   # {len(parts)} notebooks in one recording")
    return path


def show_recording(
    rec: Any,
    name: str,
    pages: Sequence[str | tuple[str, Layout]],
    layout: Layout | None = None,
    *,
    height: Any = 560,
) -> NotebookViewer:
    """Write a recording as :func:`save_lesson` does, and show it.

    Args:
        height: of the viewer, pixels of the page.
    """
    return NotebookViewer.of_file(save_lesson(rec, name, pages, layout), height=height)
