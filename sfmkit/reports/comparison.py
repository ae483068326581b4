"""A comparison of two clouds as a folder of files."""

from __future__ import annotations

import json
from pathlib import Path

import torch

from .._utils.writing import staged_folder
from ..clouds.comparison import Comparison
from ..io.ply import write_ply
from ..viz.comparison_figures import comparison_figure
from ..viz.figures import save


def write_comparison(comparison: Comparison, folder: Path, *, overwrite: bool = False) -> None:
    """Write ``compare.json``, ``compare.png`` and ``second.ply``, all or none.

    ``second.ply`` is the second cloud in the first one's frame and unit; its points carry
    ``distance`` and ``neighbours``.

    Raises:
        OutputError: the folder exists or cannot be written.
    """
    with staged_folder(folder, overwrite=overwrite) as staged:
        (staged / "compare.json").write_text(
            json.dumps(comparison.numbers(), indent=1), encoding="utf-8"
        )
        fields = {
            "distance": comparison.to_first,
            "neighbours": comparison.density_second.neighbours,
        }
        write_ply(
            staged / "second.ply",
            comparison.second,
            {k: torch.from_numpy(v) for k, v in fields.items()},
        )
        save(comparison_figure(comparison), staged / "compare.png")
