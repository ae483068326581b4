"""The fast-Hessian detector of SURF.

The detector finds blobs: maxima of the determinant of the Hessian over position and scale, computed
with box filters.

Bay, Ess, Tuytelaars, Van Gool, "Speeded-Up Robust Features (SURF)", CVIU 110 (2008), section 3.

All dense computations use flat strips. A strip of full rows is contiguous in memory, a shift by
(rows, columns) is an offset into it, and a box sum is a few differences of shifted parts of the
integral image. These operations are fast in a tensor library, and the strips fit in the cache. The
columns that wrap around the end of a row contain invalid values. They lie in the margin where a
filter would extend beyond the image, which is discarded.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from torch import Tensor

from .._utils.parallel import map_on_cores

# side of the smallest box filter, pixels: the second derivatives of a Gaussian of sigma 1.2
FIRST_SIZE = 9
SIZE_STEP = 6  # difference in side from layer to layer in the first octave
CROSS_WEIGHT = 0.81  # 0.9^2, balances the box approximation of Dxy against Dxx and Dyy (sec. 3.2)
# samples of one layer in a strip: few enough for the cache, many enough for the cost of a call
STRIP = 1 << 18
STRIP_ACCELERATOR = 1 << 22


@dataclass(frozen=True, eq=False)
class Blobs:
    """Extrema of the fast Hessian: tensors of length N on one device.

    Attributes:
        xy: (N, 2) float32 pixels with sub-pixel precision.
        size: (N,) float32 side of the box filter at the extremum, whole pixels; the keypoint's
            diameter.
        response: (N,) float32 determinant of the Hessian, per pixel.
        sign: (N,) int8 sign of the Laplacian: +1 dark on light, -1 light on dark.
    """

    xy: Tensor
    size: Tensor
    response: Tensor
    sign: Tensor

    def __len__(self) -> int:
        return len(self.size)


def fast_hessian(
    integral: Tensor, threshold: float, octaves: int, layers: int, strip: int | None = None
) -> Blobs:
    """Find maxima of the fast Hessian, ordered by octave, layer, row and column.

    Args:
        integral: (H + 1, W + 1) int32 integral image, modulo 2^32.
        threshold: Lower bound of the maxima.
        octaves: Number of octaves, from each of which to the next the sampling step doubles;
            octaves whose filters do not fit in the image are left out.
        layers: Number of layers per octave that are searched for maxima; one more lies on either
            side.
        strip: Number of samples of one layer in a strip, which affects only the speed. The default
            depends on the device.
    """
    strip = strip or (STRIP if integral.device.type == "cpu" else STRIP_ACCELERATOR)
    pyramid = map_on_cores(lambda octave: _Octave(integral, octave, layers), range(octaves))
    least = float(np.nextafter(np.float32(threshold), np.float32(np.inf)))
    work = [(octave, top, bottom) for octave in pyramid for top, bottom in octave.strips(strip)]
    found = map_on_cores(lambda part: part[0].maxima(*part[1:], least), work)
    blobs = []
    for octave in pyramid:
        parts = [maxima for maxima, part in zip(found, work) if part[0] is octave]
        if parts:
            blobs.append(octave.blobs(*(torch.cat(pieces, dim=-1) for pieces in zip(*parts))))
    if not blobs:
        none = torch.empty(0, device=integral.device)
        return Blobs(none.view(0, 2), none, none, none.to(torch.int8))
    return Blobs(
        *(
            torch.cat([getattr(b, name) for b in blobs])
            for name in ("xy", "size", "response", "sign")
        )
    )


class _Octave:
    """One octave: `layers + 2` responses on a grid of every `step`-th pixel."""

    def __init__(self, integral: Tensor, octave: int, layers: int):
        self.step = step = 1 << octave
        self.device = integral.device
        self.sizes = [(FIRST_SIZE + SIZE_STEP * i) << octave for i in range(layers + 2)]
        self.rows, self.cols = ((n - 1) // step for n in integral.shape)
        # A maximum of a middle layer needs the whole filter of the layer above, also at the
        # neighbours, inside the image.
        self.margins = [size // 2 // step + 1 for size in self.sizes[2:]]
        self.first, self.last = self.margins[0], self.rows - self.margins[0]
        if 2 * self.margins[0] < min(self.rows, self.cols):
            self._split_phases(integral)
        else:
            self.last = self.first  # not even the smallest filters fit

    def _split_phases(self, integral: Tensor) -> None:
        """Sample the integral image at every phase of the grid.

        Any corner of a box is then contiguous in memory for a strip.
        """
        step = self.step
        high, wide = (-(-n // step) for n in integral.shape)
        self.pitch = wide
        # number of rows by which filters of the strips at the border can extend beyond it
        self.guard = self.sizes[-1] // step + 2
        self.phases = [
            [integral.new_zeros((high + 2 * self.guard) * wide) for _ in range(step)]
            for _ in range(step)
        ]
        for r, c in product(range(step), repeat=2):
            sampled = integral[r::step, c::step]
            rows = self.phases[r][c].view(-1, wide)[self.guard :]
            rows[: len(sampled), : sampled.shape[1]] = sampled

    def _corner(self, row: int, col: int, start: int, length: int) -> Tensor:
        """Return `length` samples of the integral image.

        They are `row` and `col` pixels away from the grid points that follow `start`.
        """
        begin = start + (row // self.step + self.guard) * self.pitch + col // self.step
        return self.phases[row % self.step][col % self.step][begin : begin + length]

    def determinant(self, layer: int, first: int, out: Tensor) -> None:
        """Add the determinant of the Hessian of `layer` to `out` (length,).

        It is computed at the grid points from the flat index `first` on.
        """
        size, step, pitch = self.sizes[layer], self.step, self.pitch
        box = size // 3  # the lobes of Dxx and Dyy are `box` wide, those of Dxy `box` square
        k = box // step
        # extent of the lobes across the direction of differentiation
        near, far = round(2 * size / 9), round(7 * size / 9)
        cross, cross_far = round(size / 9), round(5 * size / 9)
        centre = size // 2 // step
        start, length = first - centre * (pitch + 1), len(out)

        def corner(row: int, col: int, extra: int) -> Tensor:
            return self._corner(row, col, start, length + extra)

        xx = _third_difference(corner(far, 0, 3 * k) - corner(near, 0, 3 * k), k)
        yy = _third_difference(
            corner(0, far, 3 * k * pitch) - corner(0, near, 3 * k * pitch), k * pitch
        )

        def lobes(col: int, extra: int) -> Tensor:
            upper = corner(cross, col, extra) - corner(cross + box, col, extra)
            return upper.sub_(corner(cross_far, col, extra)).add_(
                corner(cross_far + box, col, extra)
            )

        if step == 1:
            apart = cross_far - cross
            both = lobes(cross, apart + k)
            xy = both[: length + k] - both[apart:]
        else:
            xy = lobes(cross, k).sub_(lobes(cross_far, k))
        xy = xy[k:] - xy[:length]

        area, cross_area = box * (far - near), box * box
        xx, yy, xy = xx.float(), yy.float(), xy.float()
        out.addcmul_(xx, yy, value=1 / area**2).addcmul_(
            xy, xy, value=-CROSS_WEIGHT / cross_area**2
        )

    def laplacian_sign(self, layer: Tensor, row: Tensor, col: Tensor) -> Tensor:
        """Compute the sign of Dxx + Dyy at grid points, (M,) int8."""
        sign = torch.zeros(len(layer), dtype=torch.int8, device=layer.device)
        for i, size in enumerate(self.sizes):
            here = (layer == i).nonzero().squeeze(1)
            near, far, box = round(2 * size / 9), round(7 * size / 9), size // 3
            centre = size // 2 // self.step
            at = (row[here] - centre) * self.pitch + col[here] - centre

            def corner(r: int, c: int, at: Tensor = at) -> Tensor:
                return self._corner(r, c, 0, self.rows * self.pitch).index_select(0, at)

            trace = torch.zeros_like(at, dtype=torch.int32)
            for n, w in enumerate((-1, 3, -3, 1)):
                trace += w * (
                    corner(far, n * box)
                    - corner(near, n * box)
                    + corner(n * box, far)
                    - corner(n * box, near)
                )
            sign[here] = trace.sign().to(torch.int8)
        return sign

    def strips(self, samples: int) -> list[tuple[int, int]]:
        """Split the rows that can contain maxima into ranges of about `samples` grid points."""
        if self.first == self.last:
            return []
        high = max(1, samples // self.pitch - 2)
        return [(top, min(top + high, self.last)) for top in range(self.first, self.last, high)]

    def maxima(self, top: int, bottom: int, least: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Find maxima of at least `least` in the rows [top, bottom).

        Returns:
            Layer, row and column (M,), and the responses around each (27, M).
        """
        pitch = self.pitch
        length = (bottom - top + 2) * pitch  # with one more row on either side
        det = torch.zeros(len(self.sizes), length, device=self.device)
        for number, response in enumerate(det):
            self.determinant(number, (top - 1) * pitch, response)
        # The highest of the 27 samples around each sample is computed first over the layers, then
        # along and across the rows. A sample that is equal to it is a maximum, unless another one
        # is equal too.
        highest = torch.maximum(det[:-1], det[1:])
        highest = torch.maximum(highest[:-1], highest[1:])
        across = torch.maximum(highest[:, :-2], highest[:, 2:])
        across = torch.maximum(across, highest[:, 1:-1], out=across)
        around = torch.maximum(across[:, : -2 * pitch], across[:, 2 * pitch :])
        around = torch.maximum(around, across[:, pitch:-pitch], out=around).clamp_(min=least)
        layer, at = (det[1:-1, pitch + 1 : -pitch - 1] >= around).nonzero(as_tuple=True)
        at = at + 1
        row, col = at // pitch + top, at % pitch
        margin = torch.tensor(self.margins, device=at.device)[layer]
        inside = (
            (row >= margin)
            & (row < self.rows - margin)
            & (col >= margin)
            & (col < self.cols - margin)
        )
        layer, row, col = layer[inside] + 1, row[inside], col[inside]

        at = layer * length + (row - top + 1) * pitch + col
        around27 = [
            n * length + r * pitch + c for n in (-1, 0, 1) for r in (-1, 0, 1) for c in (-1, 0, 1)
        ]
        cube_at = torch.tensor(around27, device=at.device)[:, None] + at
        cube = det.view(-1).index_select(0, cube_at.view(-1)).view(cube_at.shape)
        strict = (cube >= cube[13]).sum(0) == 1
        return layer[strict], row[strict], col[strict], cube[:, strict]

    def blobs(self, layer: Tensor, row: Tensor, col: Tensor, cube: Tensor) -> Blobs:
        """Order and interpolate the maxima of the octave."""
        order = torch.argsort((layer * self.rows + row) * self.cols + col)
        return self._interpolated(layer[order], row[order], col[order], cube[:, order])

    def _interpolated(self, layer: Tensor, row: Tensor, col: Tensor, cube: Tensor) -> Blobs:
        """Move the blobs to the maximum of the quadratic through the (27, M) responses.

        Source: Brown and Lowe 2002.
        """
        offset = _quadratic_peak(cube.view(3, 3, 3, -1))
        good = (offset.abs() <= 1).all(0) & (offset != 0).any(0)
        layer, row, col, cube, offset = (
            layer[good],
            row[good],
            col[good],
            cube[:, good],
            offset[:, good],
        )
        size = torch.tensor(self.sizes, device=layer.device)[layer]
        corner = torch.stack([col, row], 1) - (size // 2 // self.step)[:, None]
        xy = self.step * corner + (size[:, None] - 1) / 2 + self.step * offset[:2].T
        interpolated = torch.round(size + SIZE_STEP * self.step * offset[2])
        return Blobs(xy, interpolated, cube[13], self.laplacian_sign(layer, row, col))


def _third_difference(a: Tensor, k: int) -> Tensor:
    """Compute a[3k:] - 3 a[2k:] + 3 a[k:] - a from the cumulative sum `a`.

    These are the lobes 1, -2, 1, each k wide.
    """
    n = len(a) - 3 * k
    return (a[3 * k :] - a[:n]).sub_(a[2 * k : 2 * k + n] - a[k : k + n], alpha=3)


def _quadratic_peak(d: Tensor) -> Tensor:
    """Find the stationary point of the quadratic through the samples `d` (3, 3, 3, M).

    Returns:
        (3, M) offset (x, y, scale) in samples.
    """
    d = d.double()
    gx, gy, gs = (
        (d[1, 1, 2] - d[1, 1, 0]) / 2,
        (d[1, 2, 1] - d[1, 0, 1]) / 2,
        (d[2, 1, 1] - d[0, 1, 1]) / 2,
    )
    centre = 2 * d[1, 1, 1]
    xx, yy, ss = (
        d[1, 1, 0] + d[1, 1, 2] - centre,
        d[1, 0, 1] + d[1, 2, 1] - centre,
        d[0, 1, 1] + d[2, 1, 1] - centre,
    )
    xy = (d[1, 2, 2] - d[1, 2, 0] - d[1, 0, 2] + d[1, 0, 0]) / 4
    xs = (d[2, 1, 2] - d[2, 1, 0] - d[0, 1, 2] + d[0, 1, 0]) / 4
    ys = (d[2, 2, 1] - d[2, 0, 1] - d[0, 2, 1] + d[0, 0, 1]) / 4
    # Cramer's rule on the symmetric 3x3 system: its inverse is the adjugate over the determinant.
    a, b, c = yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy
    e, f, g = xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy
    determinant = xx * a + xy * b + xs * c
    peak = torch.stack(
        [a * gx + b * gy + c * gs, b * gx + e * gy + f * gs, c * gx + f * gy + g * gs]
    )
    return (-peak / determinant).nan_to_num(nan=2.0, posinf=2.0, neginf=-2.0).float()
