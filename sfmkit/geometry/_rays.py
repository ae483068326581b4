"""Three-vectors as triples of tensors.

One tensor per component is several times faster than a tensor whose last axis has length 3.
"""

from __future__ import annotations

import torch
from torch import Tensor

Vector = tuple[Tensor, Tensor, Tensor]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Vector, b: Vector) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def components(t: Tensor) -> Vector:
    """Split ``(*B, 3)`` into a triple of ``(*B, 1)``, which broadcast against ``(*B, N)``."""
    return t[..., 0, None], t[..., 1, None], t[..., 2, None]


def rotate(R: Tensor, v: Vector, inverse: bool = False) -> Vector:
    """Compute ``R v`` (or ``R^T v``) for ``R (*B, 3, 3)`` and components ``(*B, N)``."""
    M = R.mT if inverse else R
    x, y, z = (
        M[..., i, 0, None] * v[0] + M[..., i, 1, None] * v[1] + M[..., i, 2, None] * v[2]
        for i in range(3)
    )
    return x, y, z


def rotated_ray(R: Tensor, x: Tensor, y: Tensor) -> Vector:
    """Compute ``R (x, y, 1)``, the ray of a point of image 1 in the axes of camera 2."""
    u, v, w = (
        R[..., i, 0, None] * x + R[..., i, 1, None] * y + R[..., i, 2, None] for i in range(3)
    )
    return u, v, w


def image_ray(x: Tensor, y: Tensor) -> Vector:
    """Return the ray ``(x, y, 1)``."""
    return x, y, torch.ones_like(x)


def choose(condition: Tensor, a: Vector, b: Vector) -> Vector:
    """Return a where the condition holds and b elsewhere."""
    x, y, z = (torch.where(condition, i, j) for i, j in zip(a, b))
    return x, y, z
