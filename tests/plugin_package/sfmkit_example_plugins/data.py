"""A data set."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from sfmkit.datasets import Pair
from sfmkit.types import Camera


def read_pairs(root: Path, sequences: Iterable[str] | None = None) -> Iterator[Pair]:
    """The pairs that ``example.json`` in `root` lists, with cameras and pose."""
    for name, entry in json.loads((Path(root) / "example.json").read_text()).items():
        if sequences is None or name in sequences:
            camera = Camera(np.array(entry["K"]), tuple(entry["size_wh"]))
            images = (Path(root) / entry["image1"], Path(root) / entry["image2"])
            R, t = np.array(entry["R"]), np.array(entry["t"])
            yield Pair("example", name, "1-2", *images, camera, camera, R=R, t=t)
