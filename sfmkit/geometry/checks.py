"""Input checks shared by the functions of this package: type, shape, finite values."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError, InputError


def _traced() -> bool:
    """Return whether the code runs inside torch.func or torch.compile.

    Values cannot be read there.
    """
    return torch.compiler.is_compiling() or torch._C._functorch.maybe_current_level() is not None


def check_values(**tensors: Tensor | None) -> None:
    """Raise InputError unless every tensor is finite.

    The check is skipped inside torch.func transforms and torch.compile, where values cannot be
    read.
    """
    if _traced():
        return
    for name, a in tensors.items():
        # A sum is finite only if its terms are. It takes one pass and no temporary, half the time
        # of isfinite().all().
        if a is not None and not math.isfinite(a.detach().sum().item()):
            raise InputError(f"{name} holds NaN or infinite values; drop those entries first")


def check_kind(**tensors: Tensor | None) -> None:
    """Raise InputError unless all tensors are float32, or all float64, on one device.

    Arguments that are None are skipped.
    """
    first: tuple[str, Tensor] | None = None
    for name, a in tensors.items():
        if a is None:
            continue
        if not isinstance(a, Tensor):
            raise InputError(
                f"{name} must be a torch tensor, not {type(a).__name__}; convert it with "
                "torch.as_tensor"
            )
        if a.dtype not in (torch.float32, torch.float64):
            raise InputError(
                f"{name} must be float32 or float64, not {a.dtype}; convert it with .double()"
            )
        if first is None:
            first = name, a
        elif a.dtype != first[1].dtype:
            raise InputError(
                f"{name} is {a.dtype} but {first[0]} is {first[1].dtype}; give both the same dtype"
            )
        elif a.device != first[1].device:
            raise InputError(
                f"{name} is on {a.device} but {first[0]} is on {first[1].device}; "
                "move both to one device"
            )


def check_points(
    minimum: int = 0, weights: Tensor | None = None, *, dim: int = 2, **points: Tensor
) -> None:
    """Raise unless all points are finite (*B, N, dim) tensors of one shape, dtype and device.

    Weights must be (*B, N) or (N,).

    Raises:
        InputError: A shape, dtype or device is wrong, batches do not fit, a value is not finite, or
            a weight is negative.
        DegenerateGeometryError: There are fewer than `minimum` points.
    """
    check_kind(**points, weights=weights)
    first = next(iter(points))
    shape = points[first].shape
    for name, x in points.items():
        if x.ndim < 2 or x.shape[-1] != dim:
            raise InputError(f"{name} must have shape (*B, N, {dim}), not {tuple(x.shape)}")
        if x.shape != shape:
            raise InputError(
                f"{name} has shape {tuple(x.shape)} but {first} has {tuple(shape)}; "
                "they must be the same"
            )
    if shape[-2] < minimum:
        raise DegenerateGeometryError(
            f"{shape[-2]} points are too few; this needs at least {minimum}",
            points=shape[-2],
            needed=minimum,
        )
    if weights is not None and tuple(weights.shape) not in (tuple(shape[:-1]), (shape[-2],)):
        raise InputError(
            f"weights must have shape {tuple(shape[:-1])}, one for each point, "
            f"not {tuple(weights.shape)}"
        )
    check_values(**points, weights=weights)
    if weights is not None and not _traced() and weights.numel() and bool((weights < 0).any()):
        raise InputError("weights must not be negative")


def check_shapes(shape: tuple[int, ...], like: Tensor | None = None, **tensors: Tensor) -> None:
    """Raise InputError unless all are tensors (*B, *shape) of one float type on one device.

    The batches must fit each other. No values are read, so the check is fast enough for inner
    loops. `like`, points (*B, N, D) or matrices (*B, D, D), must have the same type and device, and
    a batch that fits.
    """
    check_kind(points=like, **tensors)
    batches = {} if like is None else {"points": like.shape[:-2]}
    for name, a in tensors.items():
        if a.shape[-len(shape) :] != shape:
            raise InputError(
                f"{name} must have shape (*B, {', '.join(map(str, shape))}), not {tuple(a.shape)}"
            )
        batches[name] = a.shape[: -len(shape)]
    check_batches(**batches)


def check_scale(**scales: float) -> None:
    """Raise InputError unless all scales are from 1e-100 to 1e100, so that powers are finite."""
    for name, scale in scales.items():
        if not 1e-100 <= scale <= 1e100:
            raise InputError(f"{name} must be positive, from 1e-100 to 1e100, not {scale}")


def check_batches(**batches: Sequence[int]) -> None:
    """Raise InputError unless the batch shapes can be broadcast against each other."""
    if len(set(batches.values())) > 1:
        try:
            torch.broadcast_shapes(*batches.values())
        except RuntimeError:
            shapes = ", ".join(f"{name} {tuple(shape)}" for name, shape in batches.items())
            raise InputError(f"the batch dimensions do not fit each other: {shapes}") from None


def check_matrices(
    like: Tensor | None = None, *, shape: tuple[int, ...] = (3, 3), **matrices: Tensor
) -> None:
    """Raise InputError unless all are finite tensors (*B, *shape) of one dtype and device.

    `like` must have the same dtype and device.
    """
    check_shapes(shape, like, **matrices)
    check_values(**matrices)


def check_intrinsics(like: Tensor | None = None, **cameras: Tensor) -> None:
    """Raise InputError unless all are regular ``[[fx, s, cx], [0, fy, cy], [0, 0, 1]]``."""
    check_matrices(like, shape=(3, 3), **cameras)
    if _traced():
        return
    for name, K in cameras.items():
        if bool(((K[..., 0, 0] * K[..., 1, 1]) == 0).any()) or bool((K[..., 2, 2] != 1).any()):
            raise InputError(
                f"{name} is singular or not of the form [[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
            )
        if bool((K[..., 1, 0] != 0).any()) or bool((K[..., 2, :2] != 0).any()):
            raise InputError(
                f"{name} must be upper triangular: [[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
            )


def check_determined(gap: Tensor, dtype: torch.dtype, model: str, hint: str) -> None:
    """Raise DegenerateGeometryError if no member of a batch determines its linear solution.

    Args:
        gap: (*B,) ratio of the second-smallest to the largest eigenvalue of the normal matrix, as
            returned by smallest_singular_vector.
        dtype: Dtype of the points, whose rounding alone gives a gap of about its epsilon squared.
        model: Name of the model, for the message.
        hint: Possible causes, for the message.
    """
    if _traced() or gap.numel() == 0:
        return
    noise = max(1e-14, (30 * torch.finfo(dtype).eps) ** 2)
    if bool((gap < noise).all()):
        raise DegenerateGeometryError(f"the points do not determine {model}: {hint}")


def check_nonzero(**matrices: Tensor) -> None:
    """Raise DegenerateGeometryError if a matrix of a batch (*B, 3, 3) is zero."""
    if _traced():
        return
    for name, M in matrices.items():
        if bool((M == 0).flatten(-2).all(-1).any()):
            raise DegenerateGeometryError(f"{name} is zero")


def check_invertible(**matrices: Tensor) -> None:
    """Raise DegenerateGeometryError if a matrix of a batch (*B, 3, 3) is singular."""
    if _traced():
        return
    for name, M in matrices.items():
        inverse, info = torch.linalg.inv_ex(M.detach())
        if bool((info != 0).any()) or not bool(inverse.isfinite().all()):
            raise DegenerateGeometryError(f"{name} is singular")
