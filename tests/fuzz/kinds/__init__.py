"""The kinds of inputs, one module per group."""

from __future__ import annotations

from fuzz.engine import Kind

from . import cameras, files, images, models, tensors

KINDS: dict[str, Kind] = {
    kind.name: kind for module in (cameras, images, models, files, tensors) for kind in module.KINDS
}
