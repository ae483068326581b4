"""The tables of an ablation's report."""

from __future__ import annotations

import re

import numpy as np

from ...reports.result import Cell, Column, ResultTable
from .contributions import Contributions
from .findings import Findings
from .intervals import Interval
from .ranks import Ranking


def slug(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def tables(f: Findings) -> list[ResultTable]:
    """Make the tables of a data set: setups, scenes, tests, contributions, ranks, differences."""
    made = [setup_table(f)]
    if len(set(f.scores.scenes)) > 1:
        made.append(scene_table(f))
    if f.questions:
        made.append(
            _difference_table(
                f,
                "questions",
                f.questions,
                f"{f.scores.dataset}: is the best setup significantly better?",
            )
        )
    made += [_contribution_table(f, c) for c in f.contributions]
    if f.ranking is not None:
        made.append(ranking_table(f.scores.dataset, tuple(f.scores.labels), f.ranking))
    if len(f.every) > len(f.questions):
        made.append(
            _difference_table(f, "differences", f.every, f"{f.scores.dataset}: all differences")
        )
    return made


def setup_table(f: Findings) -> ResultTable:
    s, unit = f.scores, f.scores.measure.unit
    main = s.measure.main
    rows = []
    for c in f.order:
        rows.append(
            (
                s.label(c),
                *(float(f.auc[t].value[c]) for t in s.measure.thresholds),
                f.auc[main].at(c)[1:],
                float(f.median.value[c]),
                f.median.at(c)[1:],
                float(f.mean.value[c]),
                f.mean.at(c)[1:],
                int(s.failures[c]),
                float(f.seconds.value[c]),
                "yes" if f.front[c] else "",
                100 * float(f.chance_best[c]),
            )
        )
    columns = (
        Column("setup"),
        *(Column(f"AUC {s.measure.show(t)}", ".3f") for t in s.measure.thresholds),
        Column(f"95 % of AUC {s.measure.show(main)}", ".3f", interval=True),
        Column(f"median, {unit}", ".3f"),
        Column("95 % of median", _spec(f.median), interval=True),
        Column(f"mean, {unit}", ".3f"),
        Column("95 % of mean", _spec(f.mean), interval=True),
        Column("no answer", "d"),
        Column("s per pair", ".2f"),
        Column("on the front"),
        Column("best in, %", ".0f"),
    )
    note = (
        f"The error is the {s.measure.name}. AUC: area under the curve of the share of runs "
        "within an error; a run without an "
        f"answer counts as an infinite error there, and as {s.measure.show(s.measure.ceiling)}, "
        "the largest value of a run, in "
        f"median and mean. No answer: of {len(s.pairs) * s.seeds} runs. On the front: no other "
        "setup is both faster and better. Best in: share "
        f"of the bootstrap samples of the {s.units.count()}. Seconds: all stages on one "
        "core, as if the setup ran alone."
    )
    return ResultTable(
        f"{slug(s.dataset)}-setups", f"{s.dataset}: every setup", columns, tuple(rows), note
    )


def scene_table(f: Findings) -> ResultTable:
    """Compare every scene's best setup with the best of all scenes and with single operators."""
    s = f.scores
    fused = [] if f.fusion is None else [f.fusion.first]
    shown = list(dict.fromkeys([f.best, *fused, *s.singles]))
    scenes = np.asarray(s.scenes)
    rows: list[tuple[Cell, ...]] = []
    for name in dict.fromkeys(s.scenes):
        mine = scenes == name
        quality = s.quality[mine].mean(0)
        first = int(np.argmax(np.round(quality, 12)))
        rows.append(
            (
                name,
                int(mine.sum()),
                s.label(first),
                float(quality[first]),
                *(float(quality[c]) for c in shown),
                int(np.isinf(s.errors[mine][:, f.best]).sum()),
            )
        )
    unit = s.measure.show(s.measure.main)
    columns = (
        Column("scene"),
        Column("pairs", "d"),
        Column("best setup here"),
        Column("its AUC", ".3f"),
        *(Column(s.label(c), ".3f") for c in shown),
        Column(f"no answer of {s.label(f.best)}", "d"),
    )
    note = (
        f"AUC {unit} of the pairs of every scene: of the setup that is best there, of "
        f"{s.label(f.best)}, which is best over all scenes, and of single operators. The best "
        "setup of a scene was chosen among all setups on few pairs, so its AUC is too high."
    )
    return ResultTable(
        f"{slug(s.dataset)}-scenes", f"{s.dataset}: every scene", columns, tuple(rows), note
    )


def _difference_table(f: Findings, name: str, every: list, title: str) -> ResultTable:
    s = f.scores
    unit = s.units.name
    rows: list[tuple[Cell, ...]] = [
        (
            s.label(d.first),
            s.label(d.second),
            d.value,
            (d.low, d.high),
            d.better,
            d.worse,
            d.p,
            d.p_holm,
            "yes" if d.real else "not shown",
        )
        for d in every
    ]
    columns = (
        Column("setup"),
        Column("less"),
        Column(f"AUC {s.measure.show(s.measure.main)}", "+.3f"),
        Column("95 %", "+.3f", interval=True),
        Column("better on", "d"),
        Column("worse on", "d"),
        Column("p", ".2g"),
        Column(f"p, Holm over {len(every)}", ".2g"),
        Column("real"),
    )
    note = (
        f"Differences are paired by pair and seed; intervals are BCa bootstrap over the {unit}s; "
        f"p is of Wilcoxon's signed-rank test on the mean differences of the {unit}s; better and "
        "worse count pairs. Real: the corrected p is below 0.05 and the interval leaves "
        "zero out."
    )
    return ResultTable(f"{slug(s.dataset)}-{name}", title, columns, tuple(rows), note)


def _contribution_table(f: Findings, c: Contributions) -> ResultTable:
    s = f.scores
    parts = {"alone": c.alone, "loss without": c.without, "Shapley": c.shapley}
    rows = []
    for k, operator in enumerate(c.operators):
        row: list[Cell] = [operator]
        for interval in parts.values():
            row += [None, None] if interval is None else [_value(interval, k), interval.at(k)[1:]]
        rows.append(tuple(row))
    specs = {name: ".3f" if name == "alone" else "+.3f" for name in parts}
    heads = [
        h
        for name, spec in specs.items()
        for h in (Column(name, spec), Column(f"95 % of {name}", spec, interval=True))
    ]
    which = f", {c.variant}" if s.several else ""
    note = (
        f"In units of AUC {s.measure.show(s.measure.main)}. Loss without: all operators together "
        "less all but this one. Shapley: its mean "
        "gain over all orders in which the operators can be added; the values add up to the AUC of "
        "all operators, and the empty set has the value 0."
    )
    if c.missing:
        note += f" Shapley values need every combination; {c.missing}."
    file = f"{slug(s.dataset)}-contributions" + (f"-{slug(c.variant)}" if s.several else "")
    return ResultTable(
        file,
        f"{s.dataset}{which}: contributions of the operators",
        (Column("operator"), *heads),
        tuple(rows),
        note,
    )


def ranking_table(dataset: str, labels: tuple[str, ...], r: Ranking) -> ResultTable:
    letters = "abcdefghijklmnopqrstuvwxyz"
    rows = []
    for place, c in enumerate(r.order):
        groups = [
            letters[g % 26] for g, (first, last) in enumerate(r.groups) if first <= place <= last
        ]
        rows.append((labels[c], float(r.average[c]), " ".join(groups)))
    note = (
        f"Setups ranked on each of {r.blocks} {r.unit}s by their AUC, 1 the best. Friedman's χ² = "
        f"{r.statistic:.1f}, p = {r.p:.2g}. Nemenyi's critical "
        f"difference (α = 0.05) is {r.critical_difference:.2f}: setups that share a letter are "
        "not significantly different."
    )
    columns = (Column("setup"), Column("average rank", ".2f"), Column("group"))
    return ResultTable(f"{slug(dataset)}-ranking", f"{dataset}: ranks", columns, tuple(rows), note)


def _value(interval: Interval, k: int) -> float:
    return float(interval.value[k])


def _spec(interval: Interval) -> str:
    """Three decimals for small bounds, one for large ones."""
    finite = np.abs(np.stack([interval.low, interval.high]))
    return ".3f" if not np.isfinite(finite).any() or np.nanmax(finite) < 10 else ".1f"
