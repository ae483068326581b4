"""The tables of an ablation's report."""

from __future__ import annotations

import re

import numpy as np

from ...reports.result import MINUS, Cell, Column, ResultTable
from .contributions import Contributions
from .findings import Findings
from .ranks import Ranking


def slug(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def tables(f: Findings) -> list[ResultTable]:
    """Of one data set: setups, answers' tests, contributions, ranking, all differences."""
    made = [setup_table(f)]
    if f.questions:
        made.append(
            _difference_table(
                f, "questions", f.questions, f"{f.scores.dataset}: is the best really better?"
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
                between(*f.auc[main].at(c)[1:]),
                float(f.median.value[c]),
                between(*f.median.at(c)[1:]),
                float(f.mean.value[c]),
                between(*f.mean.at(c)[1:]),
                int(s.failures[c]),
                float(f.seconds.value[c]),
                "yes" if f.front[c] else "",
                100 * float(f.chance_best[c]),
            )
        )
    columns = (
        Column("setup"),
        *(Column(f"AUC {s.measure.show(t)}", ".3f") for t in s.measure.thresholds),
        Column(f"95 % of AUC {s.measure.show(main)}", ">"),
        Column(f"median, {unit}", ".3f"),
        Column("95 % of median", ">"),
        Column(f"mean, {unit}", ".3f"),
        Column("95 % of mean", ">"),
        Column("no answer", "d"),
        Column("s per pair", ".2f"),
        Column("on the front"),
        Column("best in, %", ".0f"),
    )
    note = (
        f"The error is the {s.measure.name}. AUC: area under the curve of the share of runs "
        "within an error; a run without an "
        f"answer counts as an infinite error there, and as {s.measure.show(s.measure.ceiling)}, "
        "the most that any run counts, in "
        f"median and mean. No answer: of {len(s.pairs) * s.seeds} runs. On the front: no other "
        "setup is both faster and better. Best in: share "
        "of the bootstrap samples. Seconds: all stages on one core, as if the setup ran alone."
    )
    return ResultTable(
        f"{slug(s.dataset)}-setups", f"{s.dataset}: every setup", columns, tuple(rows), note
    )


def _difference_table(f: Findings, name: str, every: list, title: str) -> ResultTable:
    s = f.scores
    rows: list[tuple[Cell, ...]] = [
        (
            s.label(d.first),
            s.label(d.second),
            d.value,
            between(d.low, d.high, signed=True),
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
        Column("95 %", ">"),
        Column("better on", "d"),
        Column("worse on", "d"),
        Column("p", ".2g"),
        Column(f"p, Holm over {len(every)}", ".2g"),
        Column("real"),
    )
    note = (
        "Differences are paired by pair and seed; intervals are BCa bootstrap over the pairs; p "
        "is of Wilcoxon's signed-rank test on "
        "the pairs' differences. Real: the corrected p is below 0.05 and the interval leaves "
        "zero out."
    )
    return ResultTable(f"{slug(s.dataset)}-{name}", title, columns, tuple(rows), note)


def _contribution_table(f: Findings, c: Contributions) -> ResultTable:
    s = f.scores
    parts = {"alone": c.alone, "loss without": c.without, "Shapley": c.shapley}
    rows = []
    for k, operator in enumerate(c.operators):
        row: list[Cell] = [operator]
        for name, interval in parts.items():
            if interval is None:
                row += [None, ""]
            else:
                row += [
                    float(interval.value[k]),
                    between(*interval.at(k)[1:], signed=name != "alone"),
                ]
        rows.append(tuple(row))
    heads = [
        h
        for name in parts
        for h in (Column(name, "+.3f" if name != "alone" else ".3f"), Column("95 %", ">"))
    ]
    which = f", {c.variant}" if s.several else ""
    note = (
        f"In units of AUC {s.measure.show(s.measure.main)}. Loss without: all operators together "
        "less all but this one. Shapley: its mean "
        "gain over every order in which the operators may join; the values add up to what all "
        "reach together, no operator counting as no answer, 0."
    )
    if c.missing:
        note += f" Shapley values need every combination; {c.missing}."
    file = f"{slug(s.dataset)}-contributions" + (f"-{slug(c.variant)}" if s.several else "")
    return ResultTable(
        file,
        f"{s.dataset}{which}: what each operator gives",
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
        f"Setups ranked on each of {r.pairs} pairs by their AUC, 1 the best. Friedman's χ² = "
        f"{r.statistic:.1f}, p = {r.p:.2g}. Nemenyi's critical "
        f"difference (α = 0.05) is {r.critical_difference:.2f}: setups that share a letter are "
        "not told apart."
    )
    columns = (Column("setup"), Column("average rank", ".2f"), Column("group"))
    return ResultTable(f"{slug(dataset)}-ranking", f"{dataset}: ranks", columns, tuple(rows), note)


def between(low: float, high: float, signed: bool = False) -> str:
    """The bounds of an interval in a cell."""
    if np.isnan(low):
        return ""
    spec = "+.3f" if signed else ".3f" if max(abs(low), abs(high)) < 10 else ".1f"
    return f"{low:{spec}} to {high:{spec}}".replace("-", MINUS)
