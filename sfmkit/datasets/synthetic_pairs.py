"""The rendered scenes as pairs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from .pair import Pair
from .synthetic import SCENES, render


def synthetic(sequences: Iterable[str] | None = None, **settings: Any) -> Iterator[Pair]:
    """A rendered pair for each scene, with cameras and pose.

    Args:
        sequences: names of scenes; None for all.
        settings: of :func:`sfmkit.datasets.synthetic.render`.

    Raises:
        InputError: unknown scene or setting.
    """
    for name in SCENES if sequences is None else tuple(sequences):
        p = render(name, **settings)
        yield Pair("synthetic", name, "1-2", p.image1, p.image2, p.camera1, p.camera2, R=p.R, t=p.t)
