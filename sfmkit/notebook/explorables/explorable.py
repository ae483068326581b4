"""The base class of the explorables, widgets that run in the browser without a kernel."""

from __future__ import annotations

import base64
import html
import io
import json
from pathlib import Path
from typing import Any, ClassVar

import anywidget
import numpy as np
import PIL.Image
import traitlets

from ..._utils.writing import atomic_write
from .bundle import style

__all__ = ["Explorable", "photograph_data", "rounded"]

_WIDEST = 800  # pixels of a photograph in a page
_PAGE = """<!doctype html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>body {{ margin: 0; background: #ffffff }}
{style}</style></head>
<body><main></main>
<script type="application/json" id="data">{data}</script>
<script type="module">
{module}
const values = {{ data: JSON.parse(document.getElementById("data").textContent), state: {{}} }};
const model = {{
  get: (name) => values[name],
  set: (name, value) => {{ values[name] = value; }},
  save_changes() {{}}, on() {{}}, off() {{}},
}};
page.render({{ model, el: document.querySelector("main") }});
</script></body></html>
"""


class Explorable(anywidget.AnyWidget):
    """An interactive figure whose JavaScript computes the geometry.

    A click or a drag is answered in the browser, so that it needs no kernel. In a notebook the
    chosen values come back in `state`. Where widgets are not available (an HTML export, the
    documentation), the same modules run in a frame of the page.

    Attributes:
        title: of the figure.
        data: what it shows; JSON.
        state: what was chosen in the browser; written by the browser.
        height: of the frame in a page without widgets, pixels.
    """

    title: ClassVar[str]
    height: ClassVar[int] = 860
    _css = style()
    data = traitlets.Dict().tag(sync=True)
    state = traitlets.Dict().tag(sync=True)

    def page(self) -> str:
        """Return a self-contained HTML page, which loads nothing else."""
        return _PAGE.format(
            title=html.escape(self.title),
            style=style(),
            # "<" would end the element in "</script>"
            data=json.dumps(self.data, separators=(",", ":")).replace("<", "\\u003c"),
            module=str(self._esm).replace("export default", "const page ="),
        )

    def to_html(self, path: str | Path) -> Path:
        """Write :meth:`page` to a file, whole or not at all.

        Raises:
            OutputError: the file cannot be written.
        """
        with atomic_write(path) as temporary:
            temporary.write_text(self.page(), encoding="utf-8")
        return Path(path)

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        """Add the page to the widget, for readers that have no widgets."""
        shown = super()._repr_mimebundle_(**kwargs)
        if shown is None:
            return None
        content, metadata = shown
        frame = (
            f'<iframe title="{html.escape(self.title)}" srcdoc="{html.escape(self.page())}" '
            f'style="width: 100%; height: {self.height}px; border: 0"></iframe>'
        )
        return {**content, "text/html": frame}, metadata


def photograph_data(rgb: np.ndarray) -> dict[str, Any]:
    """Return a photograph as JSON: its size (w, h) in pixels and a reduced JPEG as a data URL.

    Args:
        rgb: (H, W, 3) uint8.
    """
    picture = PIL.Image.fromarray(rgb)
    size = [picture.width, picture.height]
    picture.thumbnail((_WIDEST, _WIDEST))
    memory = io.BytesIO()
    picture.save(memory, "JPEG", quality=82)
    url = "data:image/jpeg;base64," + base64.b64encode(memory.getvalue()).decode()
    return {"size": size, "href": url}


def rounded(values: Any, digits: int = 6) -> list[Any]:
    """Return an array as nested lists of numbers with `digits` significant digits."""
    array = np.asarray(values, dtype=np.float64)
    if not array.ndim:
        raise ValueError("a scalar is not a list")
    numbers = [float(f"{v:.{digits}g}") for v in array.ravel()]
    return np.array(numbers).reshape(array.shape).tolist()
