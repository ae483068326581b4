"""Interactive views for JupyterLab: click a photograph, or a keypoint in the embedded Rerun viewer.

A photograph is an SVG whose user units are the photograph's pixels, so clicks and drawn lines are
exact at any size on the screen. Nothing is fetched from a network.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

import anywidget
import ipywidgets
import numpy as np
import PIL.Image
import traitlets
from matplotlib.figure import Figure

from ..errors import InputError
from ..pipeline.explorer import Candidate, EpipolarExplorer, EpipolarView
from ..pipeline.reconstruction import Reconstruction
from ..viz.colours import operator_colour
from ..viz.from_above import scene_from_above

if TYPE_CHECKING:
    from .embedded import NotebookExplorer

__all__ = [
    "Candidate",
    "EpipolarExplorer",
    "EpipolarView",
    "EpipolarWidget",
    "FigureSlider",
    "Picture",
]

MAX_DRAWN = 400  # candidates; more hide the photograph
_WIDEST = 1600  # pixels of the picture sent to the browser
_INK = {"pixel": "#F0E442", "line": "#F0E442", "match": "#FFFFFF"}


class Picture(anywidget.AnyWidget):
    """A picture with an overlay, which reports the position of clicks.

    Attributes:
        kind: ``photograph``, which can be clicked, or ``map``, which cannot; the class of the
            element is ``sfmkit-<kind>``.
        clicked: [x, y] of the last click in pixels of the picture, empty before the first.
        overlay: SVG elements in pixels of the picture.
    """

    _esm = """
    function render({ model, el }) {
      const ns = "http://www.w3.org/2000/svg";
      const [w, h] = model.get("size");
      const svg = document.createElementNS(ns, "svg");
      svg.setAttribute("viewBox", `-0.5 -0.5 ${w} ${h}`);
      const kind = model.get("kind");
      svg.setAttribute("class", `sfmkit-${kind}`);
      const cursor = kind === "photograph" ? "crosshair" : "default";
      svg.style.cssText = `width: 100%; display: block; cursor: ${cursor}`;
      const image = document.createElementNS(ns, "image");
      for (const [k, v] of Object.entries({ x: -0.5, y: -0.5, width: w, height: h }))
        image.setAttribute(k, v);
      const url = URL.createObjectURL(new Blob([model.get("jpeg")], { type: "image/jpeg" }));
      image.setAttribute("href", url);
      const overlay = document.createElementNS(ns, "g");
      const draw = () => { overlay.innerHTML = model.get("overlay"); };
      svg.append(image, overlay);
      svg.addEventListener("click", (event) => {
        const to_pixels = svg.getScreenCTM().inverse();
        const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(to_pixels);
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
    kind = traitlets.Unicode("photograph").tag(sync=True)
    jpeg = traitlets.Bytes().tag(sync=True)
    size = traitlets.List(traitlets.Int()).tag(sync=True)
    overlay = traitlets.Unicode("").tag(sync=True)
    clicked = traitlets.List(traitlets.Float()).tag(sync=True)

    def __init__(self, rgb: np.ndarray, **settings: Any):
        super().__init__(jpeg=_jpeg(rgb), size=[rgb.shape[1], rgb.shape[0]], **settings)


class FigureSlider(ipywidgets.VBox):
    """A slider above a picture that is redrawn when the value changes.

    Args:
        draw: makes a matplotlib Figure from the slider's value.
        name: of the value.
        value, low, high, step: of the slider; if all are int, so is the slider's value.
        dpi: of the picture; a smaller number is faster.
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
        self.slider = kind(
            value=value, min=low, max=high, step=step, description=name, continuous_update=False
        )
        self.picture = ipywidgets.Image(format="png")
        self.slider.observe(self._drawn, "value")
        self._drawn()
        super().__init__([self.slider, self.picture])

    def _drawn(self, _change: Any = None) -> None:
        memory = io.BytesIO()
        self.draw(self.slider.value).savefig(memory, dpi=self.dpi)
        self.picture.value = memory.getvalue()


class EpipolarWidget(ipywidgets.VBox):
    """Both photographs and the scene from above; a click on the left one updates the others.

    Image 2 shows the pixel's epipolar line, the candidates along it and the match; the scene from
    above shows the pixel's ray and the match's point.

    Args:
        result: a reconstruction, or an :class:`EpipolarExplorer`.

    Attributes:
        view: the view of the last pixel, None before the first.
    """

    def __init__(self, result: Reconstruction | EpipolarExplorer):
        self.explorer = result if isinstance(result, EpipolarExplorer) else EpipolarExplorer(result)
        self.view: EpipolarView | None = None
        self._viewer: Any = None
        result = self.explorer.result
        self.left, self.right = (Picture(image.rgb) for image in result.images)
        self.band = ipywidgets.FloatSlider(
            self.explorer.band_px, min=0.25, max=10, step=0.25, description="band (px)"
        )
        self.reach = ipywidgets.FloatSlider(
            self.explorer.reach_px, min=1, max=60, step=1, description="reach (px)"
        )
        self.words = ipywidgets.HTML("Click a pixel of image 1.")
        self.left.observe(lambda change: self.look(change["new"]), "clicked")
        for slider in (self.band, self.reach):
            slider.observe(self._changed, "value")
        self.above: Picture | None = None
        if result.cloud is not None and len(result.cloud):
            rgb, self._pixels = scene_from_above(result.cloud, result.two_view)
            self.above = Picture(rgb, kind="map")
        explained = ipywidgets.HTML(
            "<small><b>band</b>: largest distance of a drawn keypoint from the line.<br>"
            "<b>reach</b>: largest distance of a match from the click.</small>"
        )
        controls = ipywidgets.VBox([self.words, self.band, self.reach, explained])
        below = [_share(controls, 45)] + ([] if self.above is None else [_share(self.above, 55)])
        super().__init__(
            [
                ipywidgets.HBox(
                    [
                        _share(
                            ipywidgets.VBox(
                                [ipywidgets.HTML("<b>image 1</b>: click it"), self.left]
                            ),
                            50,
                        ),
                        _share(
                            ipywidgets.VBox([ipywidgets.HTML("<b>image 2</b>"), self.right]), 50
                        ),
                    ]
                ),
                ipywidgets.HBox(below),
            ]
        )

    def look(self, x1: Any) -> EpipolarView | None:
        """Show the epipolar line, candidates and match of pixel x1 = (x, y) of image 1.

        For a pixel outside the image, only a message is shown and None is returned.
        """
        try:
            self.view = self.explorer.look(x1)
        except InputError as error:
            self.words.value = escape(str(error))
            return None
        self.left.overlay, self.right.overlay = overlays(self.view, self.explorer.result)
        ray = np.stack([np.zeros(3), self.view.ray * self.explorer.far / self.view.ray[2]])
        if self.above is not None:
            point = None if self.view.X is None else self._pixels(self.view.X[None])[0]
            self.above.overlay = ray_overlay(self._pixels(ray), point)
        if self._viewer is not None:
            self._viewer.show_ray(ray, self.view.X)
        lines = "<br>".join(escape(line) for line in self.view.describe().split("; "))
        self.words.value = f'<div style="line-height: 1.4">{lines}</div>'
        return self.view

    def follow(self, viewer: NotebookExplorer) -> NotebookExplorer:
        """Treat a keypoint of image 1 selected in an embedded Rerun viewer as a click.

        The ray is also drawn in the viewer. Returns the viewer.
        """
        self._viewer = viewer
        viewer.on_event(self.on_viewer_event)
        return viewer

    def on_viewer_event(self, event: Any) -> None:
        """Treat a selected keypoint of image 1 in the viewer as a click on its pixel."""
        for item in getattr(event, "items", ()):
            pixel = self.explorer.selected(
                getattr(item, "entity_path", ""), getattr(item, "instance_id", None)
            )
            if pixel is not None:
                self.look(pixel)
                return

    def _changed(self, _change: Any) -> None:
        self.explorer.band_px, self.explorer.reach_px = self.band.value, self.reach.value
        if self.view is not None:
            self.look(self.view.x1)


def overlays(view: EpipolarView, result: Reconstruction) -> tuple[str, str]:
    """Draw the SVG overlays of image 1 and image 2, in pixels of the photographs."""
    size = max(result.images[0].size_wh) / 120
    left = _circle(view.x1, size, _INK["pixel"], "pixel")
    right = ""
    if len(view.curve):
        right += _polyline(" ".join(f"{x:.3f},{y:.3f}" for x, y in view.curve), "epipolar-line")
    right += "".join(
        _circle(c.x2, 0.5 * size, operator_colour(c.operator), "candidate")
        for c in view.candidates[:MAX_DRAWN]
    )
    if view.x1_match is not None and view.x2_match is not None:
        left += _circle(view.x1_match, 0.6 * size, _INK["match"], "match")
        right += _circle(view.x2_match, size, _INK["match"], "match")
    return left, right


def ray_overlay(ray: np.ndarray, point: np.ndarray | None) -> str:
    """Draw the SVG overlay of the scene from above.

    Args:
        ray: (2, 2) ends of the ray, pixels of the picture.
        point: (2,) the match's point, pixels of the picture; None for none.
    """
    drawn = _polyline(" ".join(f"{x:.3f},{y:.3f}" for x, y in ray), "ray")
    return drawn if point is None else drawn + _circle(point, 8, "#000000", "point")


def _polyline(points: str, kind: str) -> str:
    """Draw a line in yellow on black, which is visible on any photograph."""
    return "".join(
        f'<polyline class="{name}" points="{points}" fill="none" stroke="{colour}" '
        f'stroke-width="{width}" vector-effect="non-scaling-stroke"/>'
        for name, colour, width in (("casing", "#000000", 3.5), (kind, _INK["line"], 1.5))
    )


def _share(widget: Any, percent: int) -> Any:
    """Set the width of a widget in its row, with a margin on its right."""
    widget.layout = ipywidgets.Layout(width=f"{percent}%", padding="0 8px 0 0")
    return widget


def _circle(x: Any, radius: float, colour: str, kind: str) -> str:
    return (
        f'<circle class="{kind}" cx="{x[0]:.3f}" cy="{x[1]:.3f}" r="{radius:.2f}" '
        f'fill="none" stroke="{colour}" stroke-width="2" vector-effect="non-scaling-stroke"/>'
    )


def _jpeg(rgb: np.ndarray) -> bytes:
    picture = PIL.Image.fromarray(rgb)
    picture.thumbnail((_WIDEST, _WIDEST))
    memory = io.BytesIO()
    picture.save(memory, "JPEG", quality=85)
    return memory.getvalue()
