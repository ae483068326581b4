"""Lines in an image."""

from __future__ import annotations

import torch
from torch import Tensor

from .checks import check_shapes


def clip_lines(
    lines: Tensor, size_wh: tuple[int, int], margin: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Clip lines to the area of an image.

    Pixel centres are at integers, so the area reaches from -0.5 to w - 0.5 and h - 0.5.

    Args:
        lines: (*B, N, 3) coefficients (a, b, c) of ``a x + b y + c = 0``.
        size_wh: Width and height of the image in pixels.
        margin: Width by which the area is extended on every side, pixels.

    Returns:
        Segments (*B, N, 2, 2) with the two ends on the border, and a mask (*B, N) of the lines that
        cross the area in a segment of positive length. The segments of other lines have no meaning.

    Raises:
        InputError: The shape or type of the lines is wrong.
    """
    check_shapes((3,), lines=lines)
    low = lines.new_tensor([-0.5 - margin, -0.5 - margin])
    high = lines.new_tensor(size_wh) - 0.5 + margin
    normal, c = lines[..., :2], lines[..., 2:]
    length = normal.norm(dim=-1, keepdim=True)
    unit = normal / length
    foot = -unit * c / length
    along = torch.stack([unit[..., 1], -unit[..., 0]], -1)
    free = along == 0  # parallel to two sides: the line is between them or outside
    s = torch.stack([(low - foot) / along, (high - foot) / along])
    enter = torch.where(free, -torch.inf, s.amin(0)).amax(-1, keepdim=True)
    leave = torch.where(free, torch.inf, s.amax(0)).amin(-1, keepdim=True)
    outside = free & ((foot < low) | (foot > high))
    crosses = (length > 0)[..., 0] & ~outside.any(-1) & (enter < leave)[..., 0]
    return torch.stack([foot + enter * along, foot + leave * along], -2), crosses
