"""The findings on one data set of an ablation, and the answers in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .contributions import Contributions, contributions
from .differences import ALPHA, Difference, differences, least_p
from .intervals import Interval, mean_interval, median_interval, share_best
from .pareto import pareto_front
from .ranks import Ranking, rank
from .scores import Ablation, Scores
from .units import Units, mean_per_unit

_FEW = 8  # scenes or pairs below which a bootstrap cannot be relied on
_SATURATED = 0.95  # AUC of the worse half of the setups


@dataclass(frozen=True, eq=False)
class Findings:
    """The findings on one data set; arrays over its C setups.

    Attributes:
        scores: the scores that were analysed.
        auc: threshold -> area under the curve.
        median, mean: error in the measure's unit; in the mean, failures and what is worse count as
            the ceiling.
        seconds: mean per pair over all stages, of the pairs with a time of every setup.
        front: setups on the Pareto front of time and AUC.
        chance_best: share of bootstrap samples in which each has the largest AUC.
        best, runner_up: the setups with the largest and the next AUC; of equal ones the smaller
            combination. No runner-up if there is one setup.
        questions: the best against the runner-up and against every single operator, one family of
            tests.
        rivals: the best against every other setup, one family of tests.
        every: all differences, one family of tests.
        fusion: all operators together against the best single one, with the preset and settings of
            the best setup; None if the sweep does not have both.
        ranking: None if there is one setup.
        contributions: one for each preset and choice of settings.
    """

    scores: Scores
    auc: Mapping[float, Interval]
    median: Interval
    mean: Interval
    seconds: Interval
    front: np.ndarray
    chance_best: np.ndarray
    best: int
    runner_up: int | None
    questions: list[Difference]
    rivals: list[Difference]
    every: list[Difference]
    fusion: Difference | None
    ranking: Ranking | None
    contributions: list[Contributions]

    @property
    def order(self) -> np.ndarray:
        """The setups, best first."""
        return np.argsort(-np.round(self.scores.quality.mean(0), 12), kind="stable")

    @property
    def equals(self) -> list[int]:
        """The best setup and all that are not shown to be worse."""
        worse = {d.second for d in (*self.questions, *self.rivals) if d.real}
        return [self.best, *(d.second for d in self.rivals if d.second not in worse)]


def analyse(scores: Scores) -> Findings:
    q = scores.quality
    order = np.argsort(-np.round(q.mean(0), 12), kind="stable")  # ties: the smaller combination
    best = int(order[0])
    runner_up = int(order[1]) if len(order) > 1 else None
    setup = scores.setups[best]
    alone = [
        c for c, s in enumerate(scores.setups) if s in [setup.only([o]) for o in scores.operators]
    ]
    fused = [
        c for c, s in enumerate(scores.setups) if s.operators == scores.operators and s not in alone
    ]
    fused = [c for c in fused if scores.setups[c].only(setup.operators) == setup]
    together = (
        [(fused[0], max(alone, key=lambda c: float(q[:, c].mean())))] if fused and alone else []
    )
    asked = [c for c in alone if c not in (best, runner_up)]
    asked = ([] if runner_up is None else [runner_up]) + asked
    timed = _seconds(scores)
    units = scores.units.of_pair
    auc = {t: mean_interval(scores.auc(t), units) for t in scores.measure.thresholds}
    return Findings(
        scores=scores,
        auc=auc,
        median=median_interval(scores.capped, units),
        mean=mean_interval(scores.capped.mean(2), units),
        seconds=timed,
        front=pareto_front(timed.value, 1 - np.round(q.mean(0), 12)),
        chance_best=share_best(q, units),
        best=best,
        runner_up=runner_up,
        questions=differences(q, [(best, c) for c in asked], units),
        rivals=differences(q, [(best, int(c)) for c in order[1:]], units),
        every=differences(q, list(combinations(map(int, order), 2)), units),
        fusion=next(iter(differences(q, together, units)), None),
        ranking=rank(mean_per_unit(q, units), unit=scores.units.name) if len(order) > 1 else None,
        contributions=contributions(scores),
    )


def _seconds(scores: Scores) -> Interval:
    """Mean over the pairs with a time of every setup."""
    known = ~np.isnan(scores.seconds)
    counts = known.sum(2)
    a_pair = np.divide(
        np.where(known, scores.seconds, 0).sum(2),
        counts,
        out=np.full(counts.shape, np.nan),
        where=counts > 0,
    )
    complete = ~np.isnan(a_pair).any(1)
    if not complete.any():
        return Interval(*np.full((3, len(scores.setups)), np.nan))
    _, units = np.unique(scores.units.of_pair[complete], return_inverse=True)
    return mean_interval(a_pair[complete], units)


def overall(ablation: Ablation) -> tuple[tuple[str, ...], Ranking] | None:
    """Rank the setups over all data sets; None if the data sets have different setups.

    Ranks have no unit, so errors in pixels and in degrees can be combined. Every scene or pair has
    the same weight, whatever its data set.
    """
    first = ablation.blocks[0]
    if (
        len(ablation.blocks) < 2
        or len(first.setups) < 2
        or any(b.setups != first.setups for b in ablation.blocks)
    ):
        return None
    means = [mean_per_unit(b.quality, b.units.of_pair) for b in ablation.blocks]
    names = dict.fromkeys(b.units.name for b in ablation.blocks)
    return tuple(first.labels), rank(np.concatenate(means), unit=" or ".join(names))


def answers(f: Findings) -> list[str]:
    """Answer the main questions on a data set in sentences.

    Which setup is best, is the difference significant, which setup is as good in less time, and
    what does each operator contribute?
    """
    s = f.scores
    n, unit = len(s.pairs), s.measure.show(s.measure.main)
    runs = n * s.seeds
    value, low, high = f.auc[s.measure.main].at(f.best)
    failed = int(s.failures[f.best])
    words = [
        f"Best: {s.label(f.best)}, with an area under the curve up to {unit} of "
        f"{value:.3f}{_between(low, high)}, over {n} "
        f"{_plural(n, 'pair')}{_of_scenes(s)} and {s.seeds} {_plural(s.seeds, 'seed')}"
        + (
            f"; {failed} of its {runs} runs gave no answer."
            if failed
            else "; every run gave an answer."
        )
    ]
    if broken := int(s.broken.sum()):
        words.append(
            f"{broken:,} of all {s.broken.size:,} runs failed, and count as the largest error; "
            "the column failure of the table of the sweep states the reason."
        )
    if len(s.units) < _FEW:
        words.append(
            f"With so few independent {s.units.name}s ({len(s.units)}) the intervals are too "
            "narrow, and say little about other photographs."
        )
    if s.units.name == "pair" and len(set(s.scenes)) < n:
        words.append(
            f"The pairs come from {len(set(s.scenes))} {_plural(len(set(s.scenes)), 'scene')}: "
            "intervals and tests take the pairs as independent, and describe other pairs of the "
            "same kind of scene only."
        )
    if float(np.median(s.quality.mean(0))) > _SATURATED:
        option = "--threshold-deg" if s.measure.unit == "°" else "--threshold-px"
        words.append(
            f"Half of the setups reach more than {_SATURATED} at {unit}; a smaller threshold "
            f"({option}) separates them better."
        )
    if f.runner_up is None:
        return words
    second, *others = f.questions
    words.append(
        f"Next is {s.label(second.second)}, {second.value:.3f} "
        f"behind{_between(second.low, second.high)}: "
        + _verdict(second, s.units, len(f.questions))
        + (
            f" {s.label(f.best)} has the largest area in {100 * f.chance_best[f.best]:.0f} % of "
            f"the bootstrap samples of the {s.units.count()}."
            if len(s.units) > 1
            else ""
        )
    )
    alone = [d for d in f.questions if d.second in s.singles]
    if alone:
        words.append(_against_singles(f, alone))
    words.append(_cheapest(f))
    if f.fusion is not None:
        words.append(_fusion(f, f.fusion))
    words += _shares(f)
    return words


def _against_singles(f: Findings, alone: list[Difference]) -> str:
    s = f.scores
    real = [d for d in alone if d.real]
    open_ = [d for d in alone if not d.real]
    said = []
    if real:
        said.append(
            "it is better than "
            + _list([f"{s.label(d.second)} (by {d.value:.3f}, p {_p(d.p_holm)})" for d in real])
        )
    if open_:
        said.append(
            "no difference is shown from "
            + _list([f"{s.label(d.second)} ({d.value:+.3f}, p {_p(d.p_holm)})" for d in open_])
        )
    return f"Against the operators alone: {'; '.join(said)}."


def _fusion(f: Findings, d: Difference) -> str:
    s = f.scores
    reach, alone = (float(s.quality[:, c].mean()) for c in (d.first, d.second))
    return (
        f"Does fusing help? All {len(s.operators)} operators together reach {reach:.3f}, the "
        f"best of them alone, {s.label(d.second)}, "
        f"{alone:.3f}: {d.value:+.3f}{_between(d.low, d.high)}, better on {d.better} of "
        f"{len(s.pairs)} pairs and worse on {d.worse}; " + _verdict(d, s.units, 1)
    )


def _cheapest(f: Findings) -> str:
    """State which setups are not shown to be worse, and the fastest of them."""
    s, equal = f.scores, f.equals
    if len(equal) == 1:
        return f"It is better than every other of the {len(s.setups)} setups."
    least = least_p(len(s.units), len(f.rivals))
    words = f"{len(equal) - 1} of the other {len(f.rivals)} setups are not shown to be worse"
    words += f" ({s.units.count()} cannot show it of so many at once). " if least >= ALPHA else ". "
    if not np.isfinite(f.seconds.value).all():
        return (
            words
            + "They cannot be compared in time: there is no pair that all of them have a time for."
        )
    cheap = min(equal, key=lambda c: float(f.seconds.value[c]))
    if cheap == f.best:
        return words + "None of them is faster."
    mine, best = float(f.seconds.value[cheap]), float(f.seconds.value[f.best])
    return words + (
        f"The fastest of them is {s.label(cheap)}: {mine:.2f} s a pair where the best takes "
        f"{best:.2f} s."
    )


def _shares(f: Findings) -> list[str]:
    words = []
    for c in f.contributions:
        which = f" ({c.variant})" if f.scores.several else ""
        if c.shapley is None:
            words.append(f"Shapley values{which} need every combination; {c.missing}.")
            continue
        order = np.argsort(-c.shapley.value)
        named = [
            f"{c.operators[k]} {c.shapley.value[k]:.3f}{_between(*c.shapley.at(k)[1:])}"
            for k in order
        ]
        words.append(
            f"Shares of the operators in what all of them together reach{which}: {_list(named)}."
        )
        if c.without is not None:
            idle = [c.operators[k] for k in order if c.without.low[k] <= 0]
            if idle:
                words.append(
                    f"All together would not be shown to be worse without {_list(idle, 'or')} "
                    f"(each by itself{which})."
                )
    return words


def _of_scenes(s: Scores) -> str:
    """The number of scenes, where they are the independent units."""
    return f" of {s.units.count()}" if s.units.name == "scene" else ""


def _verdict(d: Difference, units: Units, tests: int) -> str:
    p = f"p {_p(d.p_holm)}" + (f", corrected for {tests} tests" if tests > 1 else "")
    if d.real:
        return f"the difference is real ({p})."
    if least_p(len(units), tests) >= ALPHA:
        return (
            f"{units.count()} cannot show a difference, however large (p could not be below "
            f"{least_p(len(units), tests):.2f})."
        )
    return f"the difference is not shown to be real ({p})."


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"= {p:.3f}" if p < 0.1 else f"= {p:.2f}"


def _between(low: float, high: float) -> str:
    return "" if np.isnan(low) else f" ({low:.3f} to {high:.3f})".replace("-0.000", "0.000")


def _list(parts: list[str], last: str = "and") -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def _plural(n: int, word: str) -> str:
    return word if n == 1 else f"{word}s"
