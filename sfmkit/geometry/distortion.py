"""Lens distortion in normalised coordinates, and its inverse.

There are two models, both with OpenCV's coefficients: ``opencv`` with 4, 5, 8, 12 or 14
coefficients (radial, tangential, rational, thin prism, tilt), and ``fisheye`` with 4 (Kannala and
Brandt 2006). See :mod:`._lens`.

:func:`distort` is computed by kornia (0.9), which agrees with OpenCV to rounding. :func:`undistort`
is not: at k1 = -0.35 and +0.5, the five fixed-point iterations of kornia and OpenCV are wrong by
more than 1e-6 at 57 to 74 % of the radii, and neither library reports points outside the field of
the lens. ``tests/geometry/test_distortion.py`` repeats this measurement.
"""

from __future__ import annotations

from typing import Literal, overload

import torch
from kornia.geometry.calibration import distort_points, tilt_projection
from torch import Tensor

from ..errors import InputError
from ..types import Camera, LensModel
from . import _lens
from .checks import _traced, check_matrices, check_points
from .coordinates import normalize

_LENGTHS: dict[LensModel, tuple[int, ...]] = {"opencv": (4, 5, 8, 12, 14), "fisheye": (4,)}
_SEARCH_STEPS = 10  # a strong wide-angle lens needs four, a point next to the fold seven
_CHUNK = 8192  # points; dozens of intermediate tensors stay in the cache and reuse memory
_TOLERANCE = 1e-9  # length of the last step in focal lengths; Newton's method squares the error


def distort(xn: Tensor, d: Tensor, model: LensModel = "opencv") -> Tensor:
    """Apply lens distortion to the points of an ideal pinhole camera.

    Args:
        xn: ``(*B, N, 2)`` normalised coordinates without distortion.
        d: ``(*B, D)`` coefficients in OpenCV's order.
        model: ``opencv`` or ``fisheye``.

    Returns:
        ``(*B, N, 2)`` normalised coordinates with distortion.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.
    """
    _check(xn, d, model)
    if model == "opencv":
        return distort_points(xn, torch.eye(3, dtype=xn.dtype, device=xn.device), d)
    x, y = xn.unbind(-1)
    square = x * x + y * y
    off_axis = square > 0
    r = torch.where(off_axis, square, 1.0).sqrt()
    theta = torch.atan(r)
    ratio = torch.where(off_axis, theta * _lens.fisheye_ratio(theta**2, d) / r, 1.0)
    return xn * ratio[..., None]


@overload
def undistort(
    xn: Tensor, d: Tensor, model: LensModel = "opencv", *, return_valid: Literal[False] = False
) -> Tensor: ...


@overload
def undistort(
    xn: Tensor, d: Tensor, model: LensModel = "opencv", *, return_valid: Literal[True]
) -> tuple[Tensor, Tensor]: ...


def undistort(
    xn: Tensor, d: Tensor, model: LensModel = "opencv", *, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Remove lens distortion; the inverse of :func:`distort`.

    Newton's method starts from a table of the radial map and converges to rounding; float32 input
    is computed in float64. The search is not recorded for autograd. Two further steps are recorded
    and give correct derivatives with respect to xn and d up to the third order (implicit function
    theorem).

    Args:
        xn: ``(*B, N, 2)`` normalised coordinates with distortion.
        d: ``(*B, D)`` coefficients in OpenCV's order.
        model: ``opencv`` or ``fisheye``.
        return_valid: Also return a mask ``(*B, N)`` that is false for points outside the field of
            the lens: beyond the radius at which the model folds back and, for a fisheye, 90 degrees
            or more from the axis. Those points are NaN.

    Returns:
        ``(*B, N, 2)`` normalised coordinates without distortion, and the mask if requested.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN; without `return_valid`
            also when points lie outside the field of the lens (inside ``torch.func`` transforms and
            ``torch.compile`` those are NaN instead).
    """
    _check(xn, d, model)
    target, coefficients = xn.double(), d.double()
    if not xn.numel():
        found, valid = target, torch.ones_like(target[..., 0], dtype=torch.bool)
    elif model == "opencv":
        found, valid = _undistort_opencv(target, coefficients)
    else:
        found, valid = _undistort_fisheye(target, coefficients)
    if return_valid:
        return found.to(xn.dtype), valid
    if not _traced() and not bool(valid.all()):
        raise InputError(
            f"{int((~valid).sum())} of {valid.numel()} points lie outside the field of the lens "
            f"with distortion {d.tolist()}: check the order of the coefficients (k1, k2, p1, p2, "
            "k3, ...) and K, or drop those points (return_valid=True marks them)"
        )
    return found.to(xn.dtype)


def distort_pixels(x: Tensor, camera: Camera) -> Tensor:
    """Map pixels ``(N, 2)`` of the ideal pinhole camera with the same K to pixels of `camera`."""
    K, d = camera.tensors(x.device)
    if d is None:
        return x
    K, d = K.to(x.dtype), d.to(x.dtype)
    return _pixels(distort(normalize(x, K), d, camera.model), K)


@overload
def undistort_pixels(
    x: Tensor, camera: Camera, *, return_valid: Literal[False] = False
) -> Tensor: ...


@overload
def undistort_pixels(
    x: Tensor, camera: Camera, *, return_valid: Literal[True]
) -> tuple[Tensor, Tensor]: ...


def undistort_pixels(
    x: Tensor, camera: Camera, *, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Map pixels ``(N, 2)`` of `camera` to pixels of the ideal pinhole camera with the same K.

    With `return_valid`, a mask ``(N,)`` is returned too. It is false for pixels outside the field
    of the lens, which become NaN; see :func:`undistort`.
    """
    K, d = camera.tensors(x.device)
    if d is None:
        valid = torch.ones(x.shape[:-1], dtype=torch.bool, device=x.device)
        return (x, valid) if return_valid else x
    K, d = K.to(x.dtype), d.to(x.dtype)
    xn = normalize(x, K)
    if return_valid:
        ideal, valid = undistort(xn, d, camera.model, return_valid=True)
        return _pixels(ideal, K), valid
    return _pixels(undistort(xn, d, camera.model), K)


def _pixels(xn: Tensor, K: Tensor) -> Tensor:
    """Apply K to points that may be NaN, which :func:`denormalize` rejects."""
    return xn @ K[:2, :2].mT + K[:2, 2]


def _check(xn: Tensor, d: Tensor, model: LensModel) -> None:
    check_points(xn=xn)
    if model not in _LENGTHS:
        raise InputError(f"model must be 'opencv' or 'fisheye', not {model!r}")
    check_matrices(xn, shape=(d.shape[-1] if d.ndim else 0,), d=d)
    if d.shape[-1] not in _LENGTHS[model]:
        allowed = ", ".join(map(str, _LENGTHS[model]))
        raise InputError(
            f"d must have {allowed} coefficients for the model {model}, not {d.shape[-1]}"
        )


def _undistort_opencv(target: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    if d.shape[-1] == 4:
        d = torch.nn.functional.pad(d, (0, 1))
    if d.shape[-1] == 14:
        ray = torch.nn.functional.pad(target, (0, 1), value=1.0)
        ray = ray @ tilt_projection(d[..., 12], d[..., 13], True).mT
        target = ray[..., :2] / ray[..., 2:]
    u, v = (a.contiguous() for a in target.unbind(-1))
    u0, v0, d0 = u.detach(), v.detach(), d.detach()
    fold = _lens.radial_fold(d0)
    square = u0 * u0 + v0 * v0
    s = _lens.samples(fold, square)
    start = _lens.inverse_ratio(square, s, _lens.radial_ratio(s, d0))

    parts = [a.split(_CHUNK, -1) for a in (u0, v0, start)]
    found = [_search(a, b, c, d0) for a, b, c in zip(*parts)]
    x, y, change, determinant = (torch.cat(part, -1) for part in zip(*found))
    inside = x * x + y * y <= fold[..., None]
    valid = (change < _TOLERANCE) & inside & (determinant > 0)
    if _recorded(u, d):
        u, v, x, y = (torch.where(valid, a, 0.0) for a in (u, v, x, y))
        for _ in range(2):
            x, y, _ = _newton_step(x, y, u, v, d)
    return torch.stack([torch.where(valid, a, torch.nan) for a in (x, y)], -1), valid


def _search(u0: Tensor, v0: Tensor, start: Tensor, d: Tensor) -> tuple[Tensor, ...]:
    """Return x, y, the length of the last step and the last Jacobian determinant."""
    x, y, _ = _newton_step(u0 * start, v0 * start, u0, v0, d)
    for _ in range(_SEARCH_STEPS):
        x_new, y_new, determinant = _newton_step(x, y, u0, v0, d)
        change = torch.maximum((x_new - x).abs_(), (y_new - y).abs_())
        x, y = x_new, y_new
        if _settled(change):
            break
    return x, y, change, determinant


def _newton_step(
    x: Tensor, y: Tensor, u0: Tensor, v0: Tensor, d: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    u, v, (a, b, c, e) = _lens.distort_opencv(x, y, d)
    fma = torch.addcmul
    determinant = fma(a * e, b, c, value=-1)
    du, dv = (u - u0) / determinant, (v - v0) / determinant
    x = fma(fma(x, e, du, value=-1), b, dv)
    y = fma(fma(y, a, dv, value=-1), c, du)
    return x, y, determinant


def _undistort_fisheye(target: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    square = target.square().sum(-1)
    off_axis = square > 0
    theta_d = torch.where(off_axis, square, 1.0).sqrt()
    d0, seen = d.detach(), theta_d.detach()
    fold = _lens.fisheye_fold(d0)
    s = _lens.samples(fold, seen**2)
    theta = seen * _lens.inverse_ratio(seen**2, s, _lens.fisheye_ratio(s, d0))

    def step(theta: Tensor, theta_d: Tensor, d: Tensor) -> Tensor:
        s = theta * theta
        miss = theta * _lens.fisheye_ratio(s, d) - theta_d
        return theta - miss / _lens.fisheye_slope(s, d)

    change = torch.full_like(theta, torch.inf)
    for _ in range(_SEARCH_STEPS):
        new = step(theta, seen, d0)
        theta, change = new, (new - theta).abs()
        if _settled(change):
            break
    valid = (change < _TOLERANCE) & (theta >= 0) & (theta * theta < fold[..., None]) | ~off_axis
    if _recorded(target, d):
        theta, theta_d = (torch.where(valid & off_axis, a, 0.0) for a in (theta, theta_d))
        for _ in range(2):
            theta = step(theta, theta_d, d)
    inner = valid & off_axis
    theta, theta_d = torch.where(inner, theta, 0.0), torch.where(inner, theta_d, 1.0)
    ratio = torch.where(inner, theta.tan() / theta_d, torch.where(valid, 1.0, torch.nan))
    return target * ratio[..., None], valid


def _settled(change: Tensor) -> bool:
    """Return whether all points have converged or diverged; false if values cannot be read."""
    return not _traced() and not bool(((change >= _TOLERANCE) & change.isfinite()).any())


def _recorded(*inputs: Tensor) -> bool:
    return _traced() or (torch.is_grad_enabled() and any(a.requires_grad for a in inputs))
