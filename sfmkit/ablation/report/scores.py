"""The scores of a sweep as arrays: pair x setup x seed, one block for each data set.

Runs without an answer are included: a combination without an estimate, or whose run failed, has an
infinite error, so that no average improves by leaving out difficult pairs.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import InputError
from .units import Choice, Units, choose_units

Row = Mapping[str, Any]
COLUMNS = (
    "dataset",
    "sequence",
    "pair",
    "has_truth",
    "operators",
    "preset",
    "vary",
    "seed",
    "error",
    "error_unit",
    "seconds",
    "status",
)


@dataclass(frozen=True)
class Measure:
    """How an error is scored.

    Attributes:
        unit: ``px`` or ``°``.
        name: the error in words.
        thresholds: those of the areas under the curve, in the unit.
        main: the threshold at which setups are compared.
        ceiling: largest error in medians and means; larger errors and failures are clipped to it.
    """

    unit: str
    name: str
    thresholds: tuple[float, ...]
    main: float
    ceiling: float

    def show(self, value: float) -> str:
        """Format a value with its unit."""
        return f"{value:g}°" if self.unit == "°" else f"{value:g} {self.unit}"

    def at(self, threshold: float | None) -> Measure:
        """This measure with another main threshold; None changes nothing.

        Raises:
            InputError: The threshold is not positive, or not below the ceiling.
        """
        if threshold is None:
            return self
        if not 0 < threshold < self.ceiling:
            raise InputError(
                f"the threshold must be above 0 and below {self.show(self.ceiling)}, not "
                f"{self.show(threshold)}"
            )
        shown = tuple(sorted({*self.thresholds, threshold}))
        return replace(self, thresholds=shown, main=threshold)


MEASURES = {
    "px": Measure(
        "px", "mean distance of the corners from their true places", (1, 3, 5, 10), 5, 100
    ),
    "deg": Measure("°", "larger of rotation and translation error", (1, 5, 10, 20), 5, 180),
}


@dataclass(frozen=True)
class Setup:
    """Operators with a preset and changed settings."""

    operators: tuple[str, ...]
    preset: str
    vary: str = "{}"

    @property
    def combination(self) -> str:
        return "/".join(self.operators)

    @property
    def changes(self) -> str:
        """Preset and changed settings in words."""
        changed = ", ".join(f"{name} {value}" for name, value in json.loads(self.vary).items())
        return f"{self.preset}, {changed}" if changed else self.preset

    def only(self, operators: Iterable[str]) -> Setup:
        """Return the setup of some of the operators, with the changes that concern them."""
        some = tuple(operators)
        changes = {
            k: v for k, v in json.loads(self.vary).items() if k.rpartition(".")[0] in ("", *some)
        }
        return Setup(some, self.preset, json.dumps(changes))


@dataclass(frozen=True, eq=False)
class Scores:
    """The errors on one data set.

    Attributes:
        dataset: its name.
        measure: how errors are scored.
        pairs: P names.
        scenes: the scene (sequence) of each pair.
        units: what intervals and tests take as independent, scenes or pairs.
        setups: C setups, small combinations first.
        operators: those of the sweep, in its order.
        errors: (P, C, S), in the unit of the measure; infinite without an answer.
        seconds: (P, C, S) of all stages, as if the setup ran alone; NaN if the run failed.
        broken: (P, C, S) bool: runs that failed, in contrast to runs without an answer.
    """

    dataset: str
    measure: Measure
    pairs: tuple[str, ...]
    scenes: tuple[str, ...]
    units: Units
    setups: tuple[Setup, ...]
    operators: tuple[str, ...]
    errors: np.ndarray
    seconds: np.ndarray
    broken: np.ndarray

    def auc(self, threshold: float) -> np.ndarray:
        """Compute the area under the curve of every pair and setup, (P, C).

        This is the area under the share of the seeds with an error of at most e, for e from 0 to
        the threshold, divided by the threshold.

        The mean over the pairs is the AUC over all pairs and seeds, so intervals and contributions
        are linear in it.
        """
        return np.clip(1 - self.errors / threshold, 0, None).mean(axis=2)

    @cached_property
    def quality(self) -> np.ndarray:
        """(P, C) the AUC at the main threshold; 0 for no answer, 1 for no error."""
        return self.auc(self.measure.main)

    @cached_property
    def capped(self) -> np.ndarray:
        """(P, C, S) errors, clipped to the ceiling."""
        return np.minimum(self.errors, self.measure.ceiling)

    @property
    def seeds(self) -> int:
        return self.errors.shape[2]

    @property
    def failures(self) -> np.ndarray:
        """(C,) runs without an answer."""
        return np.isinf(self.errors).sum(axis=(0, 2))

    @cached_property
    def several(self) -> bool:
        """Whether setups differ in preset or settings."""
        return len({(s.preset, s.vary) for s in self.setups}) > 1

    def label(self, setup: int) -> str:
        """The name of a setup in tables and plots."""
        s = self.setups[setup]
        return f"{s.combination} ({s.changes})" if self.several else s.combination

    @property
    def labels(self) -> list[str]:
        return [self.label(c) for c in range(len(self.setups))]

    @property
    def singles(self) -> list[int]:
        """Setups of one operator."""
        return [c for c, s in enumerate(self.setups) if len(s.operators) == 1]


@dataclass(frozen=True, eq=False)
class Ablation:
    """The scores of a sweep.

    Attributes:
        blocks: one for each data set (and unit, where a data set has pairs of both kinds).
        without_truth: name of a data set -> number of rows that cannot be scored.
    """

    blocks: tuple[Scores, ...]
    without_truth: Mapping[str, int]


def score(
    rows: Iterable[Row],
    *,
    threshold_px: float | None = None,
    threshold_deg: float | None = None,
    units: Choice = "auto",
) -> Ablation:
    """Arrange the rows of a sweep (columns as in ``docs/ablation.md``), in any order, as arrays.

    Args:
        rows: with at least :data:`COLUMNS`.
        threshold_px, threshold_deg: error up to which the area under the curve is compared; None
            for 5 px and 5 degrees.
        units: what intervals and tests take as independent, see
            :func:`~.units.choose_units`.

    Raises:
        InputError: no row has a truth to compare with; rows are missing or there twice; a threshold
            is out of range.
    """
    measures = {"px": MEASURES["px"].at(threshold_px), "deg": MEASURES["deg"].at(threshold_deg)}
    known: dict[tuple[str, str], list[Row]] = {}
    without: dict[str, int] = {}
    for row in rows:
        if row["has_truth"]:
            known.setdefault((row["dataset"], row["error_unit"]), []).append(row)
        else:
            without[row["dataset"]] = without.get(row["dataset"], 0) + 1
    if not known:
        raise InputError(
            "no row of this sweep has a true geometry to compare with; run it on data with "
            "ground truth, such as "
            "oxford, strecha, synthetic or planes"
        )
    names = [dataset for dataset, _ in known]
    blocks = []
    for dataset, unit in sorted(known):
        name = dataset if names.count(dataset) == 1 else f"{dataset} ({measures[unit].unit})"
        blocks.append(_block(name, measures[unit], known[dataset, unit], units))
    return Ablation(tuple(blocks), dict(sorted(without.items())))


def _block(dataset: str, measure: Measure, rows: Sequence[Row], units: Choice) -> Scores:
    order = _operator_order(rows)
    setups = sorted(
        {_setup(r) for r in rows},
        key=lambda s: (len(s.operators), [order.index(o) for o in s.operators], s.preset, s.vary),
    )
    scene_of = {f"{r['sequence']} {r['pair']}": r["sequence"] for r in rows}
    pairs = sorted(scene_of)
    scenes = tuple(scene_of[pair] for pair in pairs)
    seeds = sorted({r["seed"] for r in rows})
    at_setup, at_pair, at_seed = (
        {v: i for i, v in enumerate(values)} for values in (setups, pairs, seeds)
    )
    shape = (len(pairs), len(setups), len(seeds))
    errors, seconds, broken = (
        np.full(shape, np.nan),
        np.full(shape, np.nan),
        np.zeros(shape, dtype=bool),
    )
    for r in rows:
        at = at_pair[f"{r['sequence']} {r['pair']}"], at_setup[_setup(r)], at_seed[r["seed"]]
        if not np.isnan(errors[at]):
            raise InputError(
                f"{dataset}: {pairs[at[0]]}, {setups[at[1]].combination}, seed {r['seed']} is "
                "there twice"
            )
        errors[at] = np.inf if r["error"] is None else r["error"]
        seconds[at] = np.nan if r["seconds"] is None else r["seconds"]
        broken[at] = r["status"] == "failed"
    if np.isnan(errors).any():
        p, c, s = np.argwhere(np.isnan(errors))[0]
        raise InputError(
            f"{dataset}: {int(np.isnan(errors).sum())} of {errors.size} rows are missing, e.g. "
            f"{pairs[p]}, "
            f"{setups[c].combination}, seed {seeds[s]}; finish the sweep first, with the command "
            "that started it"
        )
    return Scores(
        dataset,
        measure,
        tuple(pairs),
        scenes,
        choose_units(scenes, units),
        tuple(setups),
        order,
        errors,
        seconds,
        broken,
    )


def _setup(row: Row) -> Setup:
    return Setup(tuple(row["operators"]), row["preset"], row["vary"])


def _operator_order(rows: Sequence[Row]) -> tuple[str, ...]:
    """The operators in the order of the sweep, which the largest combination shows best."""
    combinations = sorted({tuple(r["operators"]) for r in rows}, key=lambda c: (-len(c), c))
    return tuple(dict.fromkeys(o for c in combinations for o in c))
