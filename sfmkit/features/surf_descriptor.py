"""Orientation and descriptor of SURF keypoints, in batches.

Bay, Ess, Tuytelaars, Van Gool, "Speeded-Up Robust Features (SURF)", CVIU 110 (2008), section 4.

All arrays have the shape (samples, N): the arithmetic then uses contiguous memory, and the sums
over samples are matrix products with constant weights.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

# Gaussian scale s that a box filter of side `size` approximates, over `size` (section 3.3)
SCALE_PER_SIZE = 1.2 / 9

ORIENTATION_RADIUS = 6  # radius of the disc of Haar responses, in s; sampled every s
ORIENTATION_SIGMA = 2.5  # sigma of the Gaussian weights over the disc, in s
WINDOW_DEGREES = 60  # angle of the sliding sector, closed at both ends up to half a degree
SEARCH_DEGREES = 5  # step of the sliding sector
# multiples of the step and the gaps between them, -180 to 180 degrees
BINS = 2 * 360 // SEARCH_DEGREES + 1

PATCH = 20  # side of the described window, in s
CELLS = 4  # per side
PATCH_SIGMA = 3.3  # sigma of the Gaussian weights over the window, in s


class Level(NamedTuple):
    """Means of the image over squares of `box` x `box` pixels, at every `step`-th pixel."""

    mean: Tensor
    box: int
    step: int


def smoothed_levels(integral: Tensor, levels: int) -> list[Level]:
    """Compute the first `levels` levels whose boxes fit in the image.

    The boxes are 1, 2, 4, ... pixels wide, at steps of half a box.
    """
    high, wide = (n - 1 for n in integral.shape)
    stack = []
    for level in range(levels):
        box, step = 1 << level, max(1, (1 << level) // 2)
        if box > min(high, wide):
            break
        right, left = integral[:, box::step], integral[:, : wide - box + 1 : step]
        band = right - left
        total = band[box::step] - band[: high - box + 1 : step]
        stack.append(Level(total.float().mul_(1 / box**2), box, step))
    return stack


def level_of(size: Tensor) -> Tensor:
    """Choose the level whose box is closest to the spacing of the descriptor's samples.

    This avoids aliasing.
    """
    return torch.log2(size * (SCALE_PER_SIZE / 0.8)).floor().clamp(min=0).long()


def orientation(integral: Tensor, xy: Tensor, size: Tensor) -> Tensor:
    """Compute the dominant direction of the gradient around each keypoint (section 4.1).

    Args:
        integral: (H + 1, W + 1) int32 integral image.
        xy: (N, 2) pixels.
        size: (N,) diameters.

    Returns:
        (N,) radians in [0, 2 pi) from x towards y; 0 where no Haar wavelet fits in the image or the
        neighbourhood has no contrast.
    """
    high, wide = (n - 1 for n in integral.shape)
    pitch = wide + 1
    flat = integral.reshape(-1)
    s = size * SCALE_PER_SIZE
    half = torch.round(2 * s).int()  # of the Haar wavelet of side 4s
    i, j, steps, gauss = _disc(integral.device)

    def lattice(centre: Tensor, extent: int) -> tuple[Tensor, Tensor]:
        """Compute the first pixels of the wavelets along one axis, and their weights.

        The weight is 0 for wavelets that leave the image.
        """
        first = torch.round(centre + steps * s - (half - 0.5)).int()
        fits = (first >= 0) & (first <= extent - 2 * half)
        return torch.where(fits, first, 0), fits * gauss

    (x, weight_x), (y, weight_y) = lattice(xy[:, 0], wide), lattice(xy[:, 1], high)
    half = torch.where(2 * half <= min(high, wide), half, 0)
    corner = (y * pitch).index_select(0, j) + x.index_select(0, i)
    weight = weight_y.index_select(0, j).mul_(weight_x.index_select(0, i))

    def at(row: Tensor | int, col: Tensor | int) -> Tensor:
        return flat.index_select(0, (corner + (row * pitch + col)).view(-1)).view(corner.shape)

    side = 2 * half
    first, last = at(0, 0), at(side, side)
    upper_right, lower_left = at(0, side), at(side, 0)
    gx = (
        (last - upper_right)
        .add_(lower_left)
        .sub_(first)
        .sub_(at(side, half).sub_(at(0, half)), alpha=2)
    )
    gy = (
        (last.sub_(lower_left))
        .add_(upper_right)
        .sub_(first)
        .sub_(at(half, side).sub_(at(half, 0)), alpha=2)
    )
    gx, gy = weight * gx, weight * gy

    # Directions are rounded to whole degrees, and the sector of 60 degrees moves in steps of 5.
    # Every sector is then a sum of bins, each of which contains one multiple of 5 degrees or the
    # four degrees between two of them.
    direction = torch.atan2(gy, gx).mul_(180 / math.pi).round_().div_(SEARCH_DEGREES)
    bins = (direction.floor().add_(direction.ceil()).add_(BINS // 2)).long()
    bins += torch.arange(len(size), device=bins.device) * BINS
    sums = []
    for g in (gx, gy):
        histogram = g.new_zeros(len(size) * BINS).scatter_add_(0, bins.view(-1), g.view(-1))
        sums.append(histogram.view(-1, BINS) @ _sectors(integral.device))
    best = (sums[0].square() + sums[1].square()).argmax(1, keepdim=True)
    dominant = torch.atan2(sums[1].gather(1, best), sums[0].gather(1, best)).squeeze(1)
    return torch.remainder(dominant, 2 * math.pi)


def descriptor(level: Level, xy: Tensor, size: Tensor, angle: Tensor, extended: bool) -> Tensor:
    """Sum gradients over 4 x 4 cells of the rotated window of each keypoint (section 4.2).

    Args:
        level: Box means of the image, from :func:`smoothed_levels`.
        xy: (N, 2) pixels.
        size: (N,) diameters.
        angle: (N,) radians.
        extended: Whether to split the sums of dx by the sign of dy, and vice versa.

    Returns:
        (N, 64), or (N, 128) when extended, float32 of unit length; zero where the window has no
        contrast.
    """
    mean, box, step = level
    high, wide = mean.shape
    samples = PATCH + 1
    window = (samples * SCALE_PER_SIZE * size).floor().clamp(min=1)  # whole pixels
    spacing = window / samples
    # Convert pixels to samples of `mean`, and these to the range [-1, 1] of grid_sample, from the
    # outer edge of the first sample to that of the last.
    to_grid = torch.tensor([2 / wide, 2 / high], device=mean.device)
    centre = ((xy - (box - 1) / 2) / step + 0.5) * to_grid - 1
    reach = (torch.arange(samples, device=mean.device) - PATCH / 2)[:, None, None]
    c, s = angle.cos() * spacing / step, angle.sin() * spacing / step
    along = reach * (torch.stack([c, s], 1) * to_grid) + centre
    across = reach * (torch.stack([-s, c], 1) * to_grid)
    grid = (across[:, None] + along).view(1, samples * samples, -1, 2)
    patch = grid_sample(mean[None, None], grid, padding_mode="border", align_corners=False)
    patch = patch.view(samples, samples, -1)

    falling, rising = patch[1:, 1:] - patch[:-1, :-1], patch[:-1, 1:] - patch[1:, :-1]
    dx, dy = (falling + rising).flatten(0, 1), falling.sub_(rising).flatten(0, 1)
    if extended:
        up, right = dy >= 0, dx >= 0
        parts = [
            dx * up,
            dx.abs() * up,
            dx * ~up,
            dx.abs() * ~up,
            dy * right,
            dy.abs() * right,
            dy * ~right,
        ]
        parts.append(dy.abs() * ~right)
    else:
        parts = [dx, dy, dx.abs(), dy.abs()]
    weights = _cell_weights(mean.device)
    sums = torch.stack([weights @ part for part in parts], 1).flatten(0, 1).T.contiguous()
    return sums.div_(sums.norm(dim=1, keepdim=True).clamp_(min=1e-6))


@cache
def _disc(device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the lattice of the orientation.

    Returns:
        Columns and rows of the lattice points in the disc, the steps (13, 1) and the Gaussian
        (13, 1).
    """
    steps = torch.arange(-ORIENTATION_RADIUS, ORIENTATION_RADIUS + 1)
    j, i = (steps[:, None] ** 2 + steps**2 <= ORIENTATION_RADIUS**2).nonzero(as_tuple=True)
    gauss = torch.exp(-(steps**2) / (2 * ORIENTATION_SIGMA**2))
    return i.to(device), j.to(device), steps[:, None].float().to(device), gauss[:, None].to(device)


@cache
def _sectors(device: torch.device) -> Tensor:
    """Mark the bins of the sectors around 0, 5, ... 355 degrees, (BINS, 72) of 0 and 1."""
    # Bin 2k contains a multiple of the step, bin 2k + 1 the degrees between; -180 and 180 degrees
    # are separate bins.
    middle = (torch.arange(BINS) - BINS // 2) * (SEARCH_DEGREES / 2)
    distance = (middle[:, None] - torch.arange(0, 360, SEARCH_DEGREES) + 180) % 360 - 180
    return (distance.abs() < WINDOW_DEGREES / 2).float().to(device)


@cache
def _cell_weights(device: torch.device) -> Tensor:
    """Compute the Gaussian weights of the gradients, (16, 400), each in its cell's row."""
    offset = torch.arange(PATCH) - (PATCH - 1) / 2
    gauss = torch.exp(-(offset**2) / (2 * PATCH_SIGMA**2))
    cell = torch.arange(PATCH) // (PATCH // CELLS)
    cell = (cell[:, None] * CELLS + cell).flatten()
    return ((torch.arange(CELLS**2)[:, None] == cell) * torch.outer(gauss, gauss).flatten()).to(
        device
    )
