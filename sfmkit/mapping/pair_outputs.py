"""Files of a matched folder: table, picture of the graph, and summary."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._utils.versions import all_versions
from ..viz.figures import save
from ..viz.pair_graph import pair_graph
from .choice import local_positions
from .matched_folder import MatchedFolder
from .pair_table import write_pair_table

__all__ = ["connected_parts", "describe_pairs", "write_pair_files"]


def write_pair_files(matched: MatchedFolder, folder: Path) -> dict[str, Any]:
    """Write ``pairs.parquet``, ``pairs.csv``, ``graph.png`` and ``pairs.json`` into a folder.

    Returns:
        The content of ``pairs.json``.

    Raises:
        OutputError: A file cannot be written.
    """
    write_pair_table(matched.table, folder)
    save(_picture(matched), folder / "graph.png")
    report = describe_pairs(matched)
    (folder / "pairs.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return report


def _picture(matched: MatchedFolder) -> Any:
    table, plan = matched.table, matched.plan
    inliers = np.array([n or 0 for n in table["inliers"].to_pylist()])
    return pair_graph(
        plan.collection.names,
        plan.pairs,
        table["verdict"].to_pylist(),
        inliers,
        local_positions(plan.collection)[:, :2],
    )


def describe_pairs(matched: MatchedFolder) -> dict[str, Any]:
    """Summarise a matched folder as JSON values."""
    plan = matched.plan
    return {
        "folder": str(plan.collection.folder),
        "photographs": len(plan.collection),
        "skipped": matched.unreadable,
        "cameras": [
            {
                "K": camera.K.tolist(),
                "distortion": camera.distortion.tolist(),
                "model": camera.model,
                "size_wh": list(camera.size_wh),
                "source": camera.source,
                "photographs": plan.cameras.of_photograph.count(index),
            }
            for index, camera in enumerate(plan.cameras.cameras)
        ],
        "warnings": list(plan.cameras.warnings),
        "rules": plan.rules,
        "pairs": len(plan),
        "verdicts": matched.verdicts,
        "connected_parts": connected_parts(matched),
        "recipe": plan.recipe.as_json(),
        "versions": all_versions(),
    }


def connected_parts(matched: MatchedFolder) -> list[int]:
    """Return the sizes of the connected components of the graph, the largest first.

    Photographs are connected by a geometry; a photograph without one is a component.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(matched.plan.collection)
    linked = np.array([R is not None for R in matched.table["R11"].to_pylist()], dtype=bool)
    i, j = matched.plan.pairs[linked].T
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    return sorted(np.bincount(part).tolist(), reverse=True)
