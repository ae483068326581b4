"""Lens models: distortion with Jacobian, field of view, and initial values of the inverse.

A model maps the squared radius s of an ideal point to a ratio, ``r_d = r ratio(s)``. In OpenCV's
model, r is the radius in normalised coordinates; in the fisheye model, it is the angle to the
optical axis. The map can be inverted up to the fold, the first s at which ``r_d`` stops growing
with r.

Source: Brown, Close-range camera calibration, 1971; Claus and Fitzgibbon, A rational function lens
distortion model, CVPR 2005; OpenCV's documentation of ``calib3d``; Kannala and Brandt, A generic
camera model, PAMI 2006.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

_SAMPLES, _CELLS = 128, 64  # error below 1e-4: two or three Newton steps converge to rounding


def radial_ratio(s: Tensor, d: Tensor) -> Tensor:
    """Return ``r_d / r`` of OpenCV's model without tangential terms, for s ``(*B, M)``."""
    k1, k2, k3 = (d[..., i, None] for i in (0, 1, 4))
    ratio = 1 + s * (k1 + s * (k2 + s * k3))
    if d.shape[-1] >= 8:
        k4, k5, k6 = (d[..., i, None] for i in (5, 6, 7))
        ratio = ratio / (1 + s * (k4 + s * (k5 + s * k6)))
    return ratio


def radial_fold(d: Tensor) -> Tensor:
    """Return the squared radius ``(*B,)`` at which OpenCV's model folds or has a pole."""
    one = torch.ones_like(d[..., 0])
    top = torch.stack((one, d[..., 0], d[..., 1], d[..., 4]), -1)
    odd = torch.tensor([1.0, 3.0, 5.0, 7.0], dtype=d.dtype, device=d.device)
    if d.shape[-1] < 8:
        return _smallest_positive_root(top * odd)
    bottom = torch.stack((one, *d[..., 5:8].unbind(-1)), -1)
    # The slope of r N(s) / D(s) times D^2: (N + 2 s N') D - 2 s N D'.
    slope = _multiply(top * odd, bottom) - _multiply(top, bottom * (odd - 1))
    return torch.minimum(_smallest_positive_root(slope), _smallest_positive_root(bottom))


def fisheye_ratio(s: Tensor, d: Tensor) -> Tensor:
    """Return ``theta_d / theta`` of the fisheye model for squared angles s ``(*B, M)``."""
    k1, k2, k3, k4 = (d[..., i, None] for i in range(4))
    return 1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))


def fisheye_slope(s: Tensor, d: Tensor) -> Tensor:
    """Return the derivative of ``theta_d`` with respect to ``theta``."""
    k1, k2, k3, k4 = (d[..., i, None] for i in range(4))
    return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))


def fisheye_fold(d: Tensor) -> Tensor:
    """Return the squared angle ``(*B,)`` at which the fisheye model folds, at most 90 degrees."""
    odd = torch.tensor([1.0, 3.0, 5.0, 7.0, 9.0], dtype=d.dtype, device=d.device)
    slope = torch.cat((torch.ones_like(d[..., :1]), d), -1) * odd
    return _smallest_positive_root(slope).clamp(max=math.pi**2 / 4)


def _multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the product of two polynomials, ``(*B, n)`` and ``(*B, m)``, lowest power first."""
    pad = torch.nn.functional.pad
    rest = b.shape[-1] - 1
    terms = [pad(a * b[..., i, None], (i, rest - i)) for i in range(rest + 1)]
    return torch.stack(terms).sum(0)


def _smallest_positive_root(p: Tensor) -> Tensor:
    """Return the smallest positive roots ``(*B,)`` of polynomials with constant term 1.

    The value is infinite where a polynomial has no such root. The eigenvalues of the companion
    matrix are the inverses of the roots, so a leading coefficient of zero needs no special case.
    """
    n = p.shape[-1] - 1
    below = torch.eye(n, dtype=p.dtype, device=p.device)[:-1].expand(*p.shape[:-1], n - 1, n)
    inverse = torch.linalg.eigvals(torch.cat((-p[..., None, 1:], below), -2))
    real = torch.where(inverse.imag == 0, inverse.real, 0.0).amax(-1).clamp_min(0)
    return 1 / real


def distort_opencv(
    x: Tensor, y: Tensor, d: Tensor
) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Return the image ``u, v`` of a point and its Jacobian, without tilt.

    The Jacobian is ``(du/dx, du/dy, dv/dx, dv/dy)``.
    """
    # addcmul computes a + b c in half as many passes over the memory as a product and a sum.
    fma = torch.addcmul
    k1, k2, p1, p2, k3 = (d[..., i, None] for i in range(5))
    s = fma(x * x, y, y)
    radial = fma(torch.ones_like(k1), s, fma(k1, s, fma(k2, s, k3)))
    slope = fma(2 * k1, s, fma(4 * k2, s, 6 * k3))  # d radial / dx = slope x
    if d.shape[-1] >= 8:
        k4, k5, k6 = (d[..., i, None] for i in (5, 6, 7))
        bottom = fma(torch.ones_like(k4), s, fma(k4, s, fma(k5, s, k6))).reciprocal()
        radial = radial * bottom
        slope = fma(slope, radial, fma(-2 * k4, s, fma(-4 * k5, s, -6 * k6))) * bottom
    radial = fma(fma(radial, y, 2 * p1), x, 2 * p2)
    u, v = fma(x * radial, s, p2), fma(y * radial, s, p1)
    xs, ys = x * slope, y * slope
    a = fma(fma(radial, x, xs), x, 4 * p2)
    c = fma(fma(radial, y, ys), y, 4 * p1)
    mixed = fma(fma(x * ys, x, 2 * p1), y, 2 * p2)
    if d.shape[-1] < 12:
        return u, v, (a, mixed, mixed, c)
    s1, s2, s3, s4 = (d[..., i, None] for i in range(8, 12))
    u, v = fma(u, s, fma(s1, s, s2)), fma(v, s, fma(s3, s, s4))
    bend_u, bend_v = fma(2 * s1, s, 4 * s2), fma(2 * s3, s, 4 * s4)
    return (
        u,
        v,
        (fma(a, x, bend_u), fma(mixed, y, bend_u), fma(mixed, x, bend_v), fma(c, y, bend_v)),
    )


def inverse_ratio(square: Tensor, s: Tensor, ratio: Tensor) -> Tensor:
    """Return ``r / r_d`` at squared distorted radii ``(*B, N)``, by linear interpolation.

    Args:
        square: ``(*B, N)`` squared distorted radii; beyond the end of the table, its last value is
            returned.
        s: ``(*B, M)`` increasing squared radii, from 0.
        ratio: ``(*B, M)`` ``r_d / r`` at these radii; ``r_d`` must increase.
    """
    image = s * ratio * ratio
    end = torch.minimum(image[..., -1:], square.amax(-1, keepdim=True)).clamp_min(1e-30)
    cells = torch.arange(_CELLS + 1, dtype=s.dtype, device=s.device) / _CELLS
    at = cells * end
    # All pairs are compared to count the entries below each query: searchsorted has no vmap rule.
    k = (image[..., :, None] <= at[..., None, :]).sum(-2).clamp(1, _SAMPLES - 1)
    low, high = image.gather(-1, k - 1), image.gather(-1, k)
    share = ((at - low) / (high - low).clamp_min(1e-300)).clamp(0, 1)
    s_at = torch.lerp(s.gather(-1, k - 1), s.gather(-1, k), share)
    table = torch.where(at > 0, s_at / at.clamp_min(1e-300), 1.0).clamp_min(0).sqrt()
    where = (square / end * _CELLS).clamp(max=_CELLS)
    cell = where.long().clamp(0, _CELLS - 1)  # NaN becomes a negative number
    first, second = table.gather(-1, cell), table.gather(-1, cell + 1)
    return torch.lerp(first, second, where - cell)


def samples(fold: Tensor, square: Tensor) -> Tensor:
    """Return squared radii ``(*B, M)`` from 0 to the fold, dense in the range of the points."""
    unit = torch.linspace(0, 1, _SAMPLES, dtype=square.dtype, device=square.device)
    scale = square.amax(-1, keepdim=True).clamp_min(1e-30)
    # Close to unit * scale at small radii; at most the fold, or 1000 times the scale without one.
    return unit * scale / (1 - unit + unit * scale / fold[..., None]).clamp_min(1e-3)
