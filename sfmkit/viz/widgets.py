"""Interactive views for JupyterLab: click a photograph, or a keypoint in the embedded Rerun viewer.

A photograph is an SVG whose user units are the photograph's pixels, so that a click and a drawn line are exact at any
size on the screen. Nothing is fetched from a network.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from html import escape
from typing import Any

import anywidget
import ipywidgets
import numpy as np
import PIL.Image
import traitlets
from matplotlib.figure import Figure

from ..errors import InputError
from ..images import Image
from ..pipeline import Reconstruction
from .colours import operator_colour
from .explorer import Candidate, EpipolarExplorer, EpipolarView

__all__ = ["Candidate", "EpipolarExplorer", "EpipolarView", "EpipolarWidget", "FigureSlider", "Photograph"]

MAX_DRAWN = 400  # candidates; more hide the photograph
_WIDEST = 1600  # pixels of the picture sent to the browser
_INK = {"pixel": "#F0E442", "line": "#F0E442", "match": "#FFFFFF"}


class Photograph(anywidget.AnyWidget):
    """A photograph that tells where it was clicked, with a drawing over it.

    Attributes:
        clicked: [x, y] of the last click in pixels of the photograph, empty before the first.
        overlay: SVG elements in pixels of the photograph.
    """

    _esm = """
    function render({ model, el }) {
      const ns = "http://www.w3.org/2000/svg";
      const [w, h] = model.get("size");
      const svg = document.createElementNS(ns, "svg");
      svg.setAttribute("viewBox", `-0.5 -0.5 ${w} ${h}`);
      svg.setAttribute("class", "sfmkit-photograph");
      svg.style.cssText = "width: 100%; cursor: crosshair; display: block";
      const image = document.createElementNS(ns, "image");
      for (const [k, v] of Object.entries({ x: -0.5, y: -0.5, width: w, height: h })) image.setAttribute(k, v);
      const url = URL.createObjectURL(new Blob([model.get("jpeg")], { type: "image/jpeg" }));
      image.setAttribute("href", url);
      const overlay = document.createElementNS(ns, "g");
      const draw = () => { overlay.innerHTML = model.get("overlay"); };
      svg.append(image, overlay);
      svg.addEventListener("click", (event) => {
        const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
        model.set("clicked", [p.x, p.y]);
        model.save_changes();
      });
      model.on("change:overlay", draw);
      draw();
      el.append(svg);
      return () => { model.off("change:overlay", draw); URL.revokeObjectURL(url); };
    }
    export default { render };
    """
    jpeg = traitlets.Bytes().tag(sync=True)
    size = traitlets.List(traitlets.Int()).tag(sync=True)
    overlay = traitlets.Unicode("").tag(sync=True)
    clicked = traitlets.List(traitlets.Float()).tag(sync=True)

    def __init__(self, image: Image, **settings: Any):
        super().__init__(jpeg=_jpeg(image.rgb), size=list(image.size_wh), **settings)


class FigureSlider(ipywidgets.VBox):
    """A slider above a picture that is drawn anew for each of its values.

    Args:
        draw: makes a matplotlib Figure of the slider's value.
        name: of the value.
        value, low, high, step: of the slider; whole numbers make a whole slider.
        dpi: of the picture; fewer are faster.
    """

    def __init__(
        self,
        draw: Callable[[Any], Figure],
        name: str,
        value: float,
        low: float,
        high: float,
        step: float,
        dpi: int = 70,
    ):
        whole = all(isinstance(v, int) for v in (value, low, high, step))
        kind = ipywidgets.IntSlider if whole else ipywidgets.FloatSlider
        self.draw, self.dpi = draw, dpi
        self.slider = kind(value=value, min=low, max=high, step=step, description=name, continuous_update=False)
        self.picture = ipywidgets.Image(format="png")
        self.slider.observe(self._drawn, "value")
        self._drawn()
        super().__init__([self.slider, self.picture])

    def _drawn(self, _change: Any = None) -> None:
        memory = io.BytesIO()
        self.draw(self.slider.value).savefig(memory, dpi=self.dpi)
        self.picture.value = memory.getvalue()


class EpipolarWidget(ipywidgets.VBox):
    """Both photographs: click the left one, and the right one shows the epipolar line, the candidates and the match.

    Args:
        result: a reconstruction, or an :class:`EpipolarExplorer`.

    Attributes:
        view: what the last pixel said, None before the first.
    """

    def __init__(self, result: Reconstruction | EpipolarExplorer):
        self.explorer = result if isinstance(result, EpipolarExplorer) else EpipolarExplorer(result)
        self.view: EpipolarView | None = None
        images = self.explorer.result.images
        half = ipywidgets.Layout(width="50%")
        self.left, self.right = Photograph(images[0], layout=half), Photograph(images[1], layout=half)
        self.band = ipywidgets.FloatSlider(self.explorer.band_px, min=0.25, max=10, step=0.25, description="band (px)")
        self.reach = ipywidgets.FloatSlider(self.explorer.reach_px, min=1, max=60, step=1, description="reach (px)")
        self.words = ipywidgets.HTML("Click a pixel of the left photograph.")
        self.left.observe(lambda change: self.look(change["new"]), "clicked")
        for slider in (self.band, self.reach):
            slider.observe(self._changed, "value")
        super().__init__(
            [ipywidgets.HBox([self.left, self.right]), ipywidgets.HBox([self.band, self.reach]), self.words]
        )

    def look(self, x1: Any) -> EpipolarView | None:
        """Show what pixel x1 = (x, y) of image 1 says; a pixel outside the image is answered in words only."""
        try:
            self.view = self.explorer.look(x1)
        except InputError as error:
            self.words.value = escape(str(error))
            return None
        self.left.overlay, self.right.overlay = overlays(self.view, self.explorer.result)
        self.words.value = escape(self.view.describe())
        return self.view

    def follow(self, viewer: Any) -> Any:
        """Also answer keypoints of image 1 that are selected in an embedded Rerun viewer; returns the viewer."""
        viewer.on_event(self.on_viewer_event)
        return viewer

    def on_viewer_event(self, event: Any) -> None:
        """Take a selection in the viewer for a click, where it is a keypoint of image 1."""
        for item in getattr(event, "items", ()):
            pixel = self.explorer.selected(getattr(item, "entity_path", ""), getattr(item, "instance_id", None))
            if pixel is not None:
                self.look(pixel)
                return

    def _changed(self, _change: Any) -> None:
        self.explorer.band_px, self.explorer.reach_px = self.band.value, self.reach.value
        if self.view is not None:
            self.look(self.view.x1)


def overlays(view: EpipolarView, result: Reconstruction) -> tuple[str, str]:
    """The SVG over image 1 and over image 2, in pixels of the photographs."""
    size = max(result.images[0].size_wh) / 150
    left = _circle(view.x1, size, _INK["pixel"], "pixel")
    right = "".join(
        _circle(c.x2, 0.5 * size, operator_colour(c.operator), "candidate") for c in view.candidates[:MAX_DRAWN]
    )
    if len(view.curve):
        points = " ".join(f"{x:.3f},{y:.3f}" for x, y in view.curve)
        right += (
            f'<polyline class="epipolar-line" points="{points}" fill="none" stroke="{_INK["line"]}" '
            'stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
        )
    if view.x1_match is not None and view.x2_match is not None:
        left += _circle(view.x1_match, 0.6 * size, _INK["match"], "match")
        right += _circle(view.x2_match, size, _INK["match"], "match")
    return left, right


def _circle(x: Any, radius: float, colour: str, kind: str) -> str:
    return (
        f'<circle class="{kind}" cx="{x[0]:.3f}" cy="{x[1]:.3f}" r="{radius:.2f}" fill="none" stroke="{colour}" '
        'stroke-width="2" vector-effect="non-scaling-stroke"/>'
    )


def _jpeg(rgb: np.ndarray) -> bytes:
    picture = PIL.Image.fromarray(rgb)
    picture.thumbnail((_WIDEST, _WIDEST))
    memory = io.BytesIO()
    picture.save(memory, "JPEG", quality=85)
    return memory.getvalue()
