"""A homography from fused correspondences of which few are right, and its evidence.

A good operator is of little use among bad ones where samples are drawn, and models are scored, over
all matches alike. The ratio of the best to the second-best descriptor distance is comparable
between operators, and the right matches are far denser among the small ratios. So the search runs
on the most distinctive matches of all operators first, then on longer prefixes of the same order,
and every model found is improved on the longer ones too. The number of false alarms compares the
prefixes, so that there is no setting for their length, and is the verdict as well.

Source: Chum & Matas, PROSAC, CVPR 2005 (order); Moisan & Stival, IJCV 2004 (false alarms); Barath
et al., MAGSAC++, CVPR 2020 (score).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from .._utils.threads import one_thread
from ..geometry.homography import squared_homography_sampson_distance
from ..geometry.homography_refinement import refine_homography
from ..options import PlanarOptions
from ..types import Correspondences, FrozenMapping
from . import opencv
from ._problems import HomographyProblem
from .chance import MAX_LOG10_NFA, chance_agreement, log10_nfa
from .verdict import MIN_MATCHES

_PREFIXES = (100, 300, 1000, 3000)  # matches, most distinctive first
_SAMPLES = (24_000, 24_000, 8_000, 4_000)  # minimal samples on each of them
_BATCH = 4_000
_CANDIDATES = 6  # models of a prefix that are improved
_CERTAIN = -40.0  # log10 of the false alarms at which no longer prefix is searched
_DISTINCT_PX = 6.0  # matches nearer than this in both images are one piece of evidence
# the search's threshold over the fit's: minimal samples are inexact, and scenes not quite planar
_LOOSE = 2.0


@dataclass(frozen=True, eq=False)
class PlanarFit:
    """A homography, or why there is none.

    Attributes:
        H: (3, 3) float64 with ``H[2, 2] = 1``, ``x2 = H x1`` in pixels; None for too little
            evidence.
        inliers: (N,) bool.
        reason: in words.
        evidence: matches, inliers, chance_agreement, log10_false_alarms (of the prefix that
            decided).
    """

    H: Tensor | None
    inliers: Tensor
    reason: str
    evidence: Mapping[str, float] = field(default_factory=FrozenMapping)


@one_thread()
def estimate_planar(
    corr: Correspondences, options: PlanarOptions | None = None, *, seed: int = 0
) -> PlanarFit:
    """The homography that the correspondences show.

    Args:
        corr: N correspondences; their ``ratio`` is their quality (NaN comes last).
        seed: the same seed gives the same bits on the same machine.

    Returns:
        A fit, without H where the matches agree no better than chance would have them.
    """
    options = options or PlanarOptions()
    n = len(corr)
    nothing = torch.zeros(n, dtype=torch.bool)
    if n < MIN_MATCHES:
        return PlanarFit(
            None, nothing, f"{n} matches; at least {MIN_MATCHES} are needed.", {"matches": n}
        )
    order = torch.argsort(corr.ratio.nan_to_num(nan=torch.inf), stable=True)
    x1, x2 = corr.x1[order], corr.x2[order]
    generator = torch.Generator().manual_seed(seed)
    if options.method == "ransac":
        H, evidence = _ransac(x1, x2, options.threshold_px, seed, generator)
    else:
        H, evidence = _search(x1, x2, options.threshold_px, generator)
    if H is None or evidence["log10_false_alarms"] > MAX_LOG10_NFA:
        k, m = int(evidence.get("inliers", 0)), int(evidence.get("matches", n))
        reason = (
            f"At best {k:,} of the {m:,} most distinctive matches agree on one homography, which "
            "can be explained by chance."
        )
        return PlanarFit(None, nothing, reason, evidence)
    if options.method == "prefixes":
        H = refine_homography(H, x1, x2, threshold_px=options.threshold_px)
    inliers = squared_homography_sampson_distance(H, corr.x1, corr.x2) < options.threshold_px**2
    reason = (
        f"{int(inliers.sum()):,} of {n:,} matches agree on one homography, which cannot be "
        "explained by chance."
    )
    return PlanarFit(H, inliers, reason, evidence)


def _ransac(
    x1: Tensor, x2: Tensor, threshold: float, seed: int, generator: torch.Generator
) -> tuple[Tensor | None, dict[str, float]]:
    """OpenCV's RANSAC at OpenCV's defaults, whatever the order of the matches."""
    fit = opencv.estimate(
        x1,
        x2,
        model="homography",
        threshold_px=threshold,
        method="ransac",
        confidence=0.995,
        max_iterations=2000,
        seed=seed,
    )
    if fit.model is None:
        return None, {"matches": len(x1)}
    return fit.model / fit.model[2, 2], false_alarms(fit.model, x1, x2, threshold, generator)


def _search(
    x1: Tensor, x2: Tensor, threshold: float, generator: torch.Generator
) -> tuple[Tensor | None, dict[str, float]]:
    """The model with the fewest false alarms on any prefix of the matches, and those."""
    best: Tensor | None = None
    evidence: dict[str, float] = {"matches": len(x1), "log10_false_alarms": torch.inf}
    sizes = [size for size in _PREFIXES if size < len(x1)] or [len(x1)]
    for level, size in enumerate(sizes):
        for H in _candidates(x1[:size], x2[:size], _LOOSE * threshold, _SAMPLES[level], generator):
            if (
                evidence["log10_false_alarms"] < _CERTAIN
                and evidence["inliers"] > evidence["matches"] / 2
            ):
                break  # most of the matches agree: no other candidate can have as many
            shorter = torch.inf
            for longer in sizes[level:]:
                a, b = x1[:longer], x2[:longer]
                H = refine_homography(H, a, b, threshold_px=_LOOSE * threshold, max_iterations=8)
                tries = [
                    false_alarms(H, a, b, t, generator) for t in (threshold, _LOOSE * threshold)
                ]
                found = min(tries, key=lambda each: each["log10_false_alarms"])
                if found["log10_false_alarms"] < evidence["log10_false_alarms"]:
                    best, evidence = H, found
                if found["log10_false_alarms"] > max(shorter, 0.0):
                    # a right model gains with every match that is added, an accidental one loses
                    break
                shorter = found["log10_false_alarms"]
        if evidence["log10_false_alarms"] < _CERTAIN:
            break
    return best, evidence


def _candidates(
    x1: Tensor, x2: Tensor, threshold: float, samples: int, generator: torch.Generator
) -> Tensor:
    """(up to _CANDIDATES, 3, 3) models of minimal samples that score highest, best first."""
    problem = HomographyProblem(x1, x2, threshold, None)
    kept, scores = [], []
    for _ in range(0, samples, _BATCH):
        models = problem.solve(_draw(len(x1), _BATCH, generator))
        score = problem.scores(models)
        top = score.topk(min(_CANDIDATES, len(score))).indices
        kept.append(models[top])
        scores.append(score[top])
        # A sample of inliers only recurs within a batch or two when they are many; then more
        # batches add nothing.
        if float(scores[-1].max()) * len(x1) > len(x1) / 4:
            break
    models, score = torch.cat(kept), torch.cat(scores)
    models = models[score.argsort(descending=True)[:_CANDIDATES]]
    corner = models[:, 2, 2].abs() > 1e-12 * models.flatten(1).abs().amax(1)
    return models[corner] / models[corner][:, 2:, 2:]


def _draw(n: int, count: int, generator: torch.Generator) -> Tensor:
    """(about count, 4) samples of four different matches each."""
    samples = torch.randint(n, (count, 4), generator=generator)
    ascending = samples.sort(dim=1).values
    return samples[(ascending[:, 1:] != ascending[:, :-1]).all(1)]


def false_alarms(
    H: Tensor, x1: Tensor, x2: Tensor, threshold: float, generator: torch.Generator
) -> dict[str, float]:
    """Compute the number of homographies as well supported as H to expect by chance.

    Matches that lie together in both images are counted once: a repeated detail is one coincidence,
    not ten.

    Returns:
        matches, inliers (both counted once), chance_agreement, log10_false_alarms.
    """
    cells = torch.cat((x1, x2), 1).div(_DISTINCT_PX).round().numpy()
    rows = torch.from_numpy(np.unique(cells, axis=0, return_index=True)[1])
    a, b = x1[rows], x2[rows]
    n = len(a)
    k = int((squared_homography_sampson_distance(H, a, b) < threshold**2).sum())
    chance = chance_agreement(
        lambda u, v: squared_homography_sampson_distance(H, u, v),
        a,
        b,
        threshold,
        generator,
        trials=10_000,
    )
    nfa = log10_nfa(k, n, chance, sample=4, solutions=1)
    return {"matches": n, "inliers": k, "chance_agreement": chance, "log10_false_alarms": nfa}
