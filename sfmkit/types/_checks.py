"""Checks of the arrays and tensors in the fields of a type."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError


def check_array(
    owner: str, name: str, a: Any, shape: tuple[int | None, ...], kinds: str, finite: bool = True
) -> None:
    """Raise InputError unless `a` is an array of a given shape and kind of dtype.

    None in `shape` stands for any length; `kinds` contains NumPy's letters for kinds of dtypes.
    """
    if not isinstance(a, np.ndarray):
        raise InputError(f"{owner}.{name} must be a NumPy array, not {type(a).__name__}")
    want = (
        "("
        + ", ".join("N" if s is None else str(s) for s in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )
    if a.ndim != len(shape) or any(s is not None and s != n for s, n in zip(shape, a.shape)):
        raise InputError(f"{owner}.{name} must have shape {want}, not {a.shape}")
    if a.dtype.kind not in kinds:
        raise InputError(f"{owner}.{name} has dtype {a.dtype}, which does not fit")
    if finite and a.dtype.kind == "f" and not np.isfinite(a).all():
        raise InputError(f"{owner}.{name} holds NaN or infinite values")


def check_tensor(
    owner: str, name: str, a: Any, shape: tuple[int | None, ...], dtype: torch.dtype
) -> None:
    """Raise InputError unless `a` is a tensor of `shape` (None: any length) and `dtype`."""
    if not isinstance(a, Tensor):
        raise InputError(f"{owner}.{name} must be a torch tensor, not {type(a).__name__}")
    if a.ndim != len(shape) or any(s is not None and s != n for s, n in zip(shape, a.shape)):
        want = (
            "("
            + ", ".join("N" if s is None else str(s) for s in shape)
            + ("," if len(shape) == 1 else "")
            + ")"
        )
        raise InputError(f"{owner}.{name} must have shape {want}, not {tuple(a.shape)}")
    if a.dtype != dtype:
        raise InputError(f"{owner}.{name} must be {dtype}, not {a.dtype}")
