"""Robust estimation in torch: E, F and H from matches of which many are wrong. CPU and CUDA.

Rounds of minimal samples, all solved at once; every model is scored on a random subset of the
matches, the best few on all; a new best is improved locally and scored again. Scores are marginal
over the noise level up to the threshold (MAGSAC++, see :mod:`sfmkit.geometry.losses`). The search
ends when a better model has been missed with a probability below one minus the confidence.

Source: Barath et al., MAGSAC++, CVPR 2020 (score); Chum, Matas & Kittler, Locally optimized RANSAC,
2003; Chum & Matas, PROSAC, CVPR 2005; Nister, Preemptive RANSAC, ICCV 2003 (subsets).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from .._utils.threads import one_thread
from ..errors import InputError
from ..geometry.checks import check_points
from ..geometry.fundamental import fundamental_from_essential, signed_sampson_distance
from ..geometry.loss_kernels import marginal_score
from ..types import Improvement
from ._agreement import disagreement
from ._problems import ALL, EssentialProblem, FundamentalProblem, HomographyProblem, SearchProblem
from ._sampling import Sampler
from .result import RobustModel, check_model, supported

METHODS = ("magsac",)

_ROUND = (64, 256)  # minimal samples in each of the first and in every later round
_LEAST_ROUNDS = 3
# a sample of inliers is not always a good one: as many times the samples that confidence asks for
_CAUTION = 3.0
_SUBSET = 768  # matches that every model is scored on
_SHORTLIST = 16  # models scored on all matches
_LOCAL_SCALE = 2.0  # of the threshold: what a rough model's own fit takes into account
_LOCAL = 2048  # matches that the best of a round are fitted to
_LOCAL_BEST, _LOCAL_STEPS = 3, 4


@one_thread()
def estimate(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor | None = None,
    K2: Tensor | None = None,
    *,
    model: str = "essential",
    threshold_px: float = 1.0,
    method: str | None = None,
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
    seed: int = 0,
    weights: Tensor | None = None,
    ratio: Tensor | None = None,
    groups: Tensor | None = None,
    device: torch.device | str | None = None,
) -> RobustModel:
    """Estimate the E, F or H that the matches support best.

    On a scene with a dominant plane F is not determined, and what is returned may fit the plane
    only; E, with known cameras, is.

    Args:
        x1, x2: (N, 2) undistorted pixels, float32 or float64.
        K1, K2: (3, 3) intrinsics; for the essential matrix only.
        model: ``essential`` (``xn2^T E xn1 = 0``), ``fundamental`` (``x2^T F x1 = 0``) or
            ``homography`` (``x2 = H x1``).
        threshold_px: Sampson distance beyond which a match does not count, pixels.
        method: ``magsac`` is the only one.
        confidence: stop when a better model was missed with a probability below 1 - confidence.
        max_iterations: minimal samples at most.
        seed: the same seed gives the same bits on the same machine.
        weights: (N,) not negative: how much a match counts, in the score, the fit and the sampling.
        ratio: (N,) distance ratios; samples are drawn from the smallest first.
        groups: (N,) int64, such as the operator of each match: groups that turn out to hold more
            inliers are drawn more.
        device: where to compute; the device of `x1` by default. The result is on that of `x1`.

    Returns:
        RobustModel with E of Frobenius norm √2, F or H, refined. There is no model when there are
        fewer than 6 (E), 7 (F) or 4 (H) matches, or none was found, or its inliers without
        duplicates are fewer than that, or lie on one line.

    Raises:
        InputError: shapes, dtypes, NaN, an unknown model or method.
    """
    check_model(model, x1, x2, K1, K2)
    _check(x1, method, threshold_px, weights, ratio, groups)
    if device is not None and torch.device(device).type != x1.device.type:
        K1, K2, weights = (None if a is None else a.to(device) for a in (K1, K2, weights))
        found = estimate(
            x1.to(device),
            x2.to(device),
            K1,
            K2,
            model=model,
            threshold_px=threshold_px,
            confidence=confidence,
            max_iterations=max_iterations,
            seed=seed,
            weights=weights,
            ratio=ratio,
            groups=groups,
        )
        return found.to(x1.device)
    make, minimum = _PROBLEMS[model]
    if K1 is not None and K2 is not None:
        K1, K2 = K1.detach().double(), K2.detach().double()
    return _search(
        lambda a, b, w: make(a, b, K1, K2, threshold_px, w),
        x1,
        x2,
        weights,
        ratio,
        groups,
        threshold_px,
        confidence,
        max_iterations,
        seed,
        minimum=minimum,
    )


# Problem and least number of matches. Four matches determine H; seven determine F up to three
# solutions, of which the first is returned; five leave up to ten E, so E needs a sixth match.
_PROBLEMS: dict[str, tuple[Callable[..., SearchProblem], int]] = {
    "essential": (EssentialProblem, 6),
    "fundamental": (lambda a, b, K1, K2, t, w: FundamentalProblem(a, b, t, w), 7),
    "homography": (lambda a, b, K1, K2, t, w: HomographyProblem(a, b, t, w), 4),
}


def essential_score(
    E: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    threshold_px: float,
    weights: Tensor | None = None,
) -> Tensor:
    """Summed marginal score of E (*B, 3, 3) over matches (*B, N, 2), weighted; differentiable in
    everything.

    What :func:`estimate` maximises. Between 0 and the sum of the weights.
    """
    square = signed_sampson_distance(fundamental_from_essential(E, K1, K2), x1, x2) ** 2
    score = marginal_score(square, threshold_px)
    return (score if weights is None else weights * score).sum(-1)


def _check(
    x1: Tensor,
    method: str | None,
    threshold_px: float,
    weights: Tensor | None,
    ratio: Tensor | None,
    groups: Tensor | None,
) -> None:
    if weights is not None:
        check_points(0, weights, x1=x1)
    if method is not None and method not in METHODS:
        raise InputError(
            f"the torch back end has no method {method!r}; it has {', '.join(METHODS)}"
        )
    if not threshold_px > 0:
        raise InputError(f"threshold_px must be positive pixels, not {threshold_px}")
    for name, a in (("ratio", ratio), ("groups", groups)):
        if a is not None and a.shape != x1.shape[:1]:
            raise InputError(
                f"{name} must have shape ({len(x1)},), one for each match, not {tuple(a.shape)}"
            )


def _search(
    make,
    x1: Tensor,
    x2: Tensor,
    weights: Tensor | None,
    ratio: Tensor | None,
    groups: Tensor | None,
    threshold: float,
    confidence: float,
    max_iterations: int,
    seed: int,
    minimum: int,
) -> RobustModel:
    n = len(x1)
    if n < minimum:
        return RobustModel.failed(n, device=x1.device)
    generator = torch.Generator().manual_seed(seed)
    shuffle = torch.randperm(n, generator=generator)

    def shuffled(a: Tensor | None) -> Tensor | None:
        return None if a is None else a.detach()[shuffle.to(a.device)]

    weights = shuffled(weights)
    first, second = x1.detach()[shuffle.to(x1.device)], x2.detach()[shuffle.to(x2.device)]
    problem: SearchProblem = make(
        first.double(), second.double(), None if weights is None else weights.double()
    )
    sampler = Sampler(n, problem.sample_size, generator, weights, shuffled(ratio), shuffled(groups))
    best, iterations, history = _explore(problem, sampler, confidence, max_iterations)
    if best is None:
        return RobustModel.failed(n, iterations, x1.device)
    best = problem.polish(best)
    square = problem.exact(best)
    score = marginal_score(square, threshold)
    score = score if problem.weights is None else problem.weights * score
    if not math.isfinite(float(score.sum())) or float(score.sum()) <= 0:
        return RobustModel.failed(n, iterations, x1.device)
    agree = square < threshold**2
    inliers = torch.empty_like(agree)
    inliers[shuffle.to(agree.device)] = agree
    last = Improvement(iterations, best, int(agree.sum()), float(score.mean()), "refinement")
    found = RobustModel(best, inliers, float(score.sum()), iterations, (*history, last))
    return supported(found, x1, x2, minimum, threshold)


def _explore(
    problem: SearchProblem, sampler: Sampler, confidence: float, max_iterations: int
) -> tuple[Tensor | None, int, list[Improvement]]:
    """The best model of the search, the samples it took, and how the best improved."""
    n = len(problem.x1)
    local = slice(_LOCAL)  # they are in random order
    best: Tensor | None = None
    best_score, iterations = 0.0, 0
    inliers = torch.zeros(n, dtype=torch.bool, device=problem.x1.device)
    history: list[Improvement] = []
    while iterations < max_iterations:
        count = min(_ROUND[len(sampler.rounds) >= _LEAST_ROUNDS], max_iterations - iterations)
        models = problem.solve(sampler.draw(count).to(problem.x1.device))
        iterations += count
        if len(models):
            # Scored first on matches of the quality that the sample came from: among all matches, a
            # small share of right ones cannot be told from noise.
            first = problem.scores(models, sampler.scoring_subset(_SUBSET).to(problem.x1.device))
            shortlist = models[first.topk(min(_SHORTLIST, len(models))).indices]
            scores = problem.final_scores(shortlist)
            # The model of a sample is rough: it may exceed the best so far after its own fit.
            start = shortlist[scores.topk(min(_LOCAL_BEST, len(shortlist))).indices]
            fitted = problem.improve(start, local, _LOCAL_STEPS, _LOCAL_SCALE)
            for stage, candidates in (("sample", start[:1]), ("local optimisation", fitted)):
                scores = problem.final_scores(candidates).nan_to_num(0.0)
                top = int(scores.argmax())
                if float(scores[top]) > best_score:
                    best, best_score = candidates[top], float(scores[top])
                    inliers = problem.squares(candidates[top : top + 1], ALL)[0] < 1
                    history.append(
                        Improvement(iterations, best, int(inliers.sum()), best_score, stage)
                    )
            sampler.learn(inliers)
        if len(sampler.rounds) >= _LEAST_ROUNDS and sampler.log_missed(
            inliers
        ) < _CAUTION * math.log1p(-confidence):
            break
        if (
            len(sampler.rounds) == _LEAST_ROUNDS
        ):  # after the first rounds, the agreement of neighbours is worth its time
            sampler.consider(disagreement(problem.x1, problem.x2, problem.threshold))
            sampler.learn(inliers)
    return best, iterations, history
