"""E, F and H in the robust search: solve samples, score models and improve them.

Scores are computed for blocks of models times matches in float32, on coordinates that are centred
and divided by one common length, so that distances stay proportional to pixels. A Sampson distance
is then two matrix products: the residual is linear in the nine entries of F, its squared gradient
linear in twelve products of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError
from ..geometry import kernels
from ..geometry.fundamental import fundamental_8point
from ..geometry.homography import homography_dlt
from ..geometry.lie import hat
from ..geometry.loss_kernels import marginal_weight
from ..geometry.refinement import Bearings, Objective, bearings, minimise

Rows = Tensor | slice
ALL = slice(None)

_BLOCK = 1 << 17  # models times matches scored at once: what stays in the cache
_POLISH = ((4.0, 4), (1.5, 20))  # thresholds, relative, and steps of the last fit


def quick_scores(v: Tensor, weights: Tensor | None) -> Tensor:
    """(M,) summed scores of (M, N) squared residuals over the squared threshold, weighted by (N,).

    With ``a = 1 - v``, ``a^4 (1 + 2 a) / 3`` follows the marginal score to 0.011 at a fraction of
    its cost.
    """
    a = torch.rsub(v, 1).relu_()
    b = a * a
    b.mul_(b)
    a.mul_(2 / 3).add_(1 / 3)
    return torch.linalg.vecdot(a, b) if weights is None else a.mul_(b) @ weights


class SearchProblem(ABC):
    """N matches, shuffled once, and one kind of model."""

    sample_size: int

    def __init__(self, x1: Tensor, x2: Tensor, threshold: float, weights: Tensor | None):
        """
        Args:
            x1, x2: (N, 2) pixels, float64, in random order: the first few are a random subset.
        """
        self.x1, self.x2, self.threshold, self.weights = x1, x2, threshold, weights
        self.weights32 = None if weights is None else weights.float()
        centres = x1.mean(0), x2.mean(0)
        moved = x1 - centres[0], x2 - centres[1]
        self.length = max(float(torch.cat(moved).square().mean().sqrt()), 1e-9)
        self.y1, self.y2 = ((y / self.length).float() for y in moved)
        self.T1, self.T2 = (_similarity(c, self.length) for c in centres)

    @abstractmethod
    def solve(self, samples: Tensor) -> Tensor:
        """(M, 3, 3) models of (B, k) samples."""

    @abstractmethod
    def squares(self, models: Tensor, rows: Rows) -> Tensor:
        """(M, rows) squared distances of some matches, over the squared threshold, float32."""

    @abstractmethod
    def exact(self, model: Tensor) -> Tensor:
        """(N,) squared distances, square pixels, float64."""

    @abstractmethod
    def improve(self, models: Tensor, rows: Rows, steps: int, scale: float) -> Tensor:
        """The (M, 3, 3) models after some steps of reweighted fitting to some matches; scale times
        the threshold."""

    def polish(self, model: Tensor) -> Tensor:
        """The model fitted to all matches, the threshold narrowing, so that it is not caught where
        it started."""
        for scale, steps in _POLISH:
            model = self.improve(model[None], ALL, steps, scale)[0]
        return model

    def scores(self, models: Tensor, rows: Rows = ALL) -> Tensor:
        """(M,) mean score per match over some of them."""
        n = len(self.x1[rows])
        weights = None if self.weights32 is None else self.weights32[rows]
        blocks = models.split(max(1, _BLOCK // n)) if len(models) else ()
        out = [quick_scores(self.squares(block, rows), weights) for block in blocks]
        return torch.cat(out) / n if out else torch.zeros(0, device=self.x1.device)

    def final_scores(self, models: Tensor) -> Tensor:
        """(M,) mean score per match, over all of them, by everything that the problem knows."""
        return self.scores(models)

    def _refit(self, fit, models: Tensor, x1: Tensor, x2: Tensor, w: Tensor) -> Tensor:
        """Weighted linear fits; a model that too few matches support stays as it is."""
        if self.weights is not None:
            w = w * self.weights[: w.shape[1]]
        enough = (w > 0).sum(1) > self.sample_size + 1
        try:
            fitted = fit(x1, x2, w / w.amax(1, keepdim=True).clamp(min=1e-300))
        except DegenerateGeometryError:
            return models
        return torch.where(enough[:, None, None], fitted, models)


class _Epipolar(SearchProblem):
    """Shared by E and F: the Sampson distance as two matrix products."""

    def __init__(self, x1: Tensor, x2: Tensor, threshold: float, weights: Tensor | None):
        super().__init__(x1, x2, threshold, weights)
        self.products = kernels.epipolar_rows(self.y1, self.y2).mT.contiguous()
        self.quadratics = torch.cat([_quadratics(y) for y in (self.y1, self.y2)])

    @abstractmethod
    def fundamental(self, models: Tensor) -> Tensor:
        """(M, 3, 3) F of the centred coordinates."""

    def squares(self, models: Tensor, rows: Rows) -> Tensor:
        F = kernels.unit_norm(self.fundamental(models)) * (self.length / self.threshold)
        F = F.float()
        gradient = (
            torch.cat((_gram(F[:, :2]), _gram(F.mT[:, :2])), 1)
            * (self.threshold / self.length) ** 2
        )
        v = F.flatten(1) @ self.products[:, rows]
        return v.square_().div_((gradient @ self.quadratics[:, rows]).clamp_(min=1e-20))


def _quadratics(y: Tensor) -> Tensor:
    u, v = y.unbind(-1)
    return torch.stack((u * u, v * v, torch.ones_like(u), 2 * u * v, 2 * u, 2 * v))


def _gram(rows: Tensor) -> Tensor:
    """(M, 6) coefficients of ``|rows h|²`` in the monomials of _quadratics; rows (M, 2, 3)."""
    G = rows.mT @ rows
    return torch.stack((G[:, 0, 0], G[:, 1, 1], G[:, 2, 2], G[:, 0, 1], G[:, 0, 2], G[:, 1, 2]), 1)


def _similarity(centre: Tensor, length: float) -> Tensor:
    T = torch.eye(3, dtype=centre.dtype, device=centre.device) / length
    T[2, 2] = 1
    T[:2, 2] = -centre / length
    return T


class EssentialProblem(_Epipolar):
    """E by five points; improved by Levenberg-Marquardt on the marginal loss."""

    sample_size = 5

    def __init__(
        self,
        x1: Tensor,
        x2: Tensor,
        K1: Tensor,
        K2: Tensor,
        threshold: float,
        weights: Tensor | None,
    ):
        super().__init__(x1, x2, threshold, weights)
        self.xn1, self.xn2 = kernels.normalize(x1, K1), kernels.normalize(x2, K2)
        self.K1i, self.K2i = kernels.inverse_intrinsics(K1), kernels.inverse_intrinsics(K2)
        self.left = (self.K2i @ torch.linalg.inv(self.T2)).mT.contiguous()
        self.right = self.K1i @ torch.linalg.inv(self.T1)
        self.matches = bearings(x1, x2, K1, K2, weights)
        self.h1, self.h2 = (h.float() for h in (self.matches.h1, self.matches.h2))
        self.n1, self.n2 = self.h1.square().sum(0), self.h2.square().sum(0)
        self.rows = kernels.epipolar_rows(self.xn1, self.xn2).mT.float()

    def solve(self, samples: Tensor) -> Tensor:
        E, valid = kernels.essential_candidates(self.xn1[samples], self.xn2[samples])
        return E[valid]

    def fundamental(self, models: Tensor) -> Tensor:
        return self.left @ models @ self.right

    def final_scores(self, models: Tensor) -> Tensor:
        """Score the best of the four poses of E on the matches in front of both cameras.

        The distances alone cannot tell the true E of a plane from others that fit its matches as
        well, or better.

        With ``X2 = d2 h2 = d1 R h1 + t``, both depths are ratios of three bilinear forms,
        ``p = h2^T R h1``, ``q = t^T R h1`` and ``s = t^T h2``, of which the twisted pair of R
        changes only p, to ``2 q s - p``.
        """
        R, t = (a.float() for a in kernels.one_pose(models))
        p = R.flatten(1) @ self.rows
        q, s = (t[:, None] @ R).squeeze(1) @ self.h1, t @ self.h2
        square = self.squares(models, ALL)
        score = [
            quick_scores(square.masked_fill(~front, 1), self.weights32)
            for front in self._in_front(p, q, s)
        ]
        return torch.stack(score).amax(0) / len(self.x1)

    def _in_front(self, p: Tensor, q: Tensor, s: Tensor) -> Iterator[Tensor]:
        for turned in (p, 2 * q * s - p):
            depth1, depth2 = turned * s - self.n2 * q, self.n1 * s - turned * q
            yield (depth1 > 0) & (depth2 > 0)
            yield (depth1 < 0) & (depth2 < 0)

    def exact(self, model: Tensor) -> Tensor:
        return kernels.signed_sampson(self.K2i.mT @ model @ self.K1i, self.x1, self.x2) ** 2

    def improve(self, models: Tensor, rows: Rows, steps: int, scale: float) -> Tensor:
        m = self.matches
        w = None if m.weights is None else m.weights[rows]
        m = Bearings(m.h1[:, rows], m.h2[:, rows], m.S1, m.S2, w)
        objective = Objective("marginal", scale * self.threshold)
        pose = minimise(*kernels.one_pose(models), m, objective, steps).state
        return hat(pose.t) @ pose.R


class FundamentalProblem(_Epipolar):
    """F by seven points; improved by the eight-point algorithm, reweighted for the marginal loss of
    Sampson distances."""

    sample_size = 7

    def __init__(self, x1: Tensor, x2: Tensor, threshold: float, weights: Tensor | None):
        super().__init__(x1, x2, threshold, weights)
        self.left, self.right = torch.linalg.inv(self.T2).mT.contiguous(), torch.linalg.inv(self.T1)

    def solve(self, samples: Tensor) -> Tensor:
        F, valid = kernels.fundamental_candidates(self.x1[samples], self.x2[samples])
        return F[valid]

    def fundamental(self, models: Tensor) -> Tensor:
        return self.left @ models @ self.right

    def exact(self, model: Tensor) -> Tensor:
        return kernels.signed_sampson(model, self.x1, self.x2) ** 2

    def improve(self, models: Tensor, rows: Rows, steps: int, scale: float) -> Tensor:
        x1, x2 = (x[rows].expand(len(models), -1, -1) for x in (self.x1, self.x2))
        for _ in range(steps):
            r, gradient = _sampson_parts(models, x1, x2)
            w = marginal_weight(r * r / gradient, scale * self.threshold) / gradient
            models = self._refit(fundamental_8point, models, x1, x2, w)
        return models


def _sampson_parts(F: Tensor, x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """``x2^T F x1`` and the squared length of its gradient by the four coordinates."""
    r, (a, b), (c, d) = kernels.residual_and_lines(F, x1, x2)
    return r, (a * a + b * b + c * c + d * d).clamp(min=1e-300)


class HomographyProblem(SearchProblem):
    """H by four points; improved by the DLT, reweighted for the marginal loss of Sampson
    distances."""

    sample_size = 4

    def solve(self, samples: Tensor) -> Tensor:
        H = kernels.four_point(self.x1[samples], self.x2[samples])
        return H[H.flatten(1).abs().amax(1) > 0]

    def squares(self, models: Tensor, rows: Rows) -> Tensor:
        H = (self.T2 @ models @ torch.linalg.inv(self.T1)).float()
        return (
            kernels.squared_homography_sampson(H, self.y1[rows], self.y2[rows])
            * (self.length / self.threshold) ** 2
        )

    def exact(self, model: Tensor) -> Tensor:
        return kernels.squared_homography_sampson(model, self.x1, self.x2)

    def improve(self, models: Tensor, rows: Rows, steps: int, scale: float) -> Tensor:
        x1, x2 = (x[rows].expand(len(models), -1, -1) for x in (self.x1, self.x2))
        for _ in range(steps):
            w = marginal_weight(
                kernels.squared_homography_sampson(models, x1, x2), scale * self.threshold
            )
            models = self._refit(homography_dlt, models, x1, x2, w)
        return models
