"""Rendered scenes as a data set."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from typing import Any

from .generated import generated
from .pair import Pair
from .synthetic import SCENES, render


@generated(SCENES)
def synthetic(
    root: str | os.PathLike | None = None,
    sequences: Iterable[str] | None = None,
    **settings: Any,
) -> Iterator[Pair]:
    """Yield a rendered pair for each scene, with cameras and pose.

    Args:
        root: Ignored: nothing is read from the disk.
        sequences: Names of scenes; None for all.
        settings: Arguments of :func:`sfmkit.datasets.synthetic.render`.

    Raises:
        InputError: A scene or setting is unknown.
    """
    for name in SCENES if sequences is None else tuple(sequences):
        p = render(name, **settings)
        yield Pair("synthetic", name, "1-2", p.image1, p.image2, p.camera1, p.camera2, R=p.R, t=p.t)
