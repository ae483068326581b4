"""A sweep whose answers are known: errors made up from what each operator is worth."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from sfmkit.ablation.table import TABLE, table_of
from sfmkit.ablation.table_file import SCHEMA, write_table

OPERATORS = ("surf", "orb", "fast-brief", "sift", "akaze")


def made_up_rows(
    operators=OPERATORS[:3],
    *,
    dataset="oxford",
    pairs=20,
    seeds=3,
    unit="px",
    seed=0,
    gain=1.0,
    fails=("orb",),
):
    """Errors fall with every operator, most with the first; `fails` alone gives no answer on the
    last two pairs."""
    rng = np.random.default_rng(seed)
    hard = rng.gamma(2, 1.0, pairs)
    rows = []
    for p in range(pairs):
        for combination in (
            c for n in range(1, len(operators) + 1) for c in combinations(operators, n)
        ):
            worth = sum(1 / (1 + operators.index(o)) for o in combination)
            for s in range(seeds):
                error = float(hard[p] * np.exp(-gain * worth + rng.normal(0, 0.1)))
                given_up = combination == tuple(fails) and p >= pairs - 2
                row = dict.fromkeys(SCHEMA.names)
                row |= {
                    "dataset": dataset,
                    "sequence": f"scene{p // 5}",
                    "pair": f"1-{2 + p % 5}",
                    "has_truth": True,
                    "kind": "homography" if unit == "px" else "two-view",
                    "combination": "/".join(combination),
                    "operators": list(combination),
                    "n_operators": len(combination),
                    "preset": "default",
                    "vary": "{}",
                    "seed": s,
                    "error": float("inf") if given_up else error,
                    "error_unit": unit,
                    "status": "no estimate" if given_up else "ok",
                    "seconds": 0.2 * len(combination) + 0.01 * p,
                    "versions": "sfmkit 0.1.0, numpy 2.0",
                    "machine": "made up",
                }
                rows.append(row)
    return rows


def made_up_sweep(folder: Path, rows=None) -> Path:
    """A folder that holds the table of these rows."""
    folder.mkdir(parents=True, exist_ok=True)
    write_table(table_of(rows if rows is not None else made_up_rows()), folder / TABLE)
    return folder
