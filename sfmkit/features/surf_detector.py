"""The fast-Hessian detector of SURF: blobs as maxima of a box-filter determinant of the Hessian over place and scale.

Bay, Ess, Tuytelaars, Van Gool, "Speeded-Up Robust Features (SURF)", CVIU 110 (2008), section 3.

Everything dense happens on flat strips. A strip of full rows is one contiguous run of memory, a shift by (rows,
columns) is an offset into it, and a box sum is a few differences of shifted runs of the integral image: the fastest
thing a tensor library does, in pieces that stay in cache. The columns that wrap around a row's end carry garbage;
they lie in the margin where a filter would stick out of the image, which is cut away.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

FIRST_SIZE = 9  # side of the smallest box filter, pixels: the second derivatives of a Gaussian of sigma 1.2
SIZE_STEP = 6  # difference in side from layer to layer in the first octave
CROSS_WEIGHT = 0.81  # 0.9^2, balances the box approximation of Dxy against Dxx and Dyy (section 3.2)
STRIP_ELEMENTS = 1 << 17  # samples of one layer in a strip


@dataclass(frozen=True, eq=False)
class Blobs:
    """Extrema of the fast Hessian, all tensors of length N on one device.

    Attributes:
        xy: (N, 2) float32 pixels, sub-pixel.
        size: (N,) float32 side of the box filter at the extremum, whole pixels; the keypoint's diameter.
        response: (N,) float32 determinant of the Hessian, per pixel.
        sign: (N,) int8 sign of the Laplacian: +1 dark on light, -1 light on dark.
    """

    xy: Tensor
    size: Tensor
    response: Tensor
    sign: Tensor

    def __len__(self) -> int:
        return len(self.size)

    def take(self, index: Tensor) -> Blobs:
        return Blobs(self.xy[index], self.size[index], self.response[index], self.sign[index])


def fast_hessian(integral: Tensor, threshold: float, octaves: int, layers: int, strip: int = STRIP_ELEMENTS) -> Blobs:
    """Maxima above `threshold` of the fast Hessian, ordered by octave, layer, row and column.

    Args:
        integral: (H + 1, W + 1) int32 integral image (modulo 2^32, as differences of it are).
        threshold: least determinant of the Hessian.
        octaves: doublings of the sampling step; those whose filters do not fit the image are left out.
        layers: layers in an octave in which maxima are sought; two more surround them.
        strip: samples a strip; changes the speed, not the result.
    """
    found = [_Octave(integral, o, layers, strip).maxima(threshold) for o in range(octaves)]
    return Blobs(*(torch.cat([getattr(f, name) for f in found]) for name in ("xy", "size", "response", "sign")))


class _Octave:
    """One octave: `layers + 2` responses on a grid of every `step`-th pixel."""

    def __init__(self, integral: Tensor, octave: int, layers: int, strip: int):
        self.step = step = 1 << octave
        self.sizes = [(FIRST_SIZE + SIZE_STEP * i) << octave for i in range(layers + 2)]
        self.rows, self.cols = ((n - 1) // step for n in integral.shape)
        # A middle layer's maxima need the whole filter of the layer above, and its neighbours, inside the image.
        self.margins = [size // 2 // step + 1 for size in self.sizes[2:]]
        self.strip = strip
        self.fits = 2 * self.margins[0] < min(self.rows, self.cols)
        if self.fits:
            self._split_phases(integral)

    def _split_phases(self, integral: Tensor) -> None:
        """Sample the integral image at every phase of the grid, so that any corner of a box is a contiguous run."""
        step = self.step
        high, wide = (-(-n // step) for n in integral.shape)
        self.pitch = wide
        self.guard = self.sizes[-1] // step + 2  # rows that filters of the strips at the border may reach beyond it
        phases = integral.new_zeros(step, step, high + 2 * self.guard, wide)
        for r in range(step):
            for c in range(step):
                sampled = integral[r::step, c::step]
                phases[r, c, self.guard : self.guard + len(sampled), : sampled.shape[1]] = sampled
        self.phases = phases.view(step, step, -1)

    def _corner(self, row: int, col: int, start: int, length: int) -> Tensor:
        """`length` samples of the integral image, `row` and `col` pixels off the grid points that follow `start`."""
        begin = start + (row // self.step + self.guard) * self.pitch + col // self.step
        return self.phases[row % self.step, col % self.step, begin : begin + length]

    def determinant(self, layer: int, first: int, length: int) -> Tensor:
        """(length,) determinant of the Hessian of `layer` at the grid points from flat index `first` on."""
        size, step, pitch = self.sizes[layer], self.step, self.pitch
        box = size // 3  # the lobes of Dxx and Dyy are `box` wide, those of Dxy `box` square
        k = box // step
        near, far = round(2 * size / 9), round(7 * size / 9)  # extent of the lobes across the direction of derivation
        cross, cross_far = round(size / 9), round(5 * size / 9)
        centre = size // 2 // step
        start = first - centre * (pitch + 1)

        def corner(row: int, col: int, extra: int) -> Tensor:
            return self._corner(row, col, start, length + extra)

        xx = _third_difference(corner(far, 0, 3 * k) - corner(near, 0, 3 * k), k)
        yy = _third_difference(corner(0, far, 3 * k * pitch) - corner(0, near, 3 * k * pitch), k * pitch)

        def lobes(col: int, extra: int) -> Tensor:
            upper = corner(cross, col, extra) - corner(cross + box, col, extra)
            return upper.sub_(corner(cross_far, col, extra)).add_(corner(cross_far + box, col, extra))

        if step == 1:
            apart = cross_far - cross
            both = lobes(cross, apart + k)
            xy = both[: length + k] - both[apart:]
        else:
            xy = lobes(cross, k).sub_(lobes(cross_far, k))
        xy = xy[k:] - xy[:length]

        area, cross_area = box * (far - near), box * box
        scale = 1.0 / area**2
        det = xx.float().mul_(yy.float()).mul_(scale)
        xy = xy.float()
        return det.addcmul_(xy, xy, value=-CROSS_WEIGHT / cross_area**2)

    def laplacian_sign(self, layer: Tensor, row: Tensor, col: Tensor) -> Tensor:
        """(M,) int8 sign of Dxx + Dyy at grid points."""
        sign = torch.zeros(len(layer), dtype=torch.int8, device=layer.device)
        for i, size in enumerate(self.sizes):
            here = (layer == i).nonzero().squeeze(1)
            near, far, box = round(2 * size / 9), round(7 * size / 9), size // 3
            centre = size // 2 // self.step
            at = (row[here] - centre) * self.pitch + col[here] - centre

            def corner(r: int, c: int, at: Tensor = at) -> Tensor:
                return self._corner(r, c, 0, self.phases.shape[-1]).index_select(0, at)

            trace = torch.zeros_like(at, dtype=torch.int32)
            for n, w in enumerate((-1, 3, -3, 1)):
                trace += w * (
                    corner(far, n * box) - corner(near, n * box) + corner(n * box, far) - corner(n * box, near)
                )
            sign[here] = trace.sign().to(torch.int8)
        return sign

    def maxima(self, threshold: float) -> Blobs:
        """The octave's blobs."""
        if not self.fits:
            empty = torch.empty(0)
            return Blobs(empty.view(0, 2), empty, empty, empty.to(torch.int8))
        first, last = self.margins[0], self.rows - self.margins[0]
        high = max(1, self.strip // self.pitch - 2)
        strips = [self._strip_maxima(r, min(r + high, last), threshold) for r in range(first, last, high)]
        layer, row, col, cube = (torch.cat(parts, dim=-1) for parts in zip(*strips))
        order = torch.argsort((layer * self.rows + row) * self.cols + col)
        return self._interpolated(layer[order], row[order], col[order], cube[:, order])

    def _strip_maxima(self, top: int, bottom: int, threshold: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Maxima in the rows [top, bottom): layer, row, column and the (27, M) responses around each."""
        pitch = self.pitch
        first, length = (top - 1) * pitch, (bottom - top + 2) * pitch
        det = torch.stack([self.determinant(i, first, length) for i in range(len(self.sizes))])
        across = torch.maximum(torch.maximum(det[:, :-2], det[:, 2:]), det[:, 1:-1])
        around = torch.maximum(torch.maximum(across[:, : -2 * pitch], across[:, 2 * pitch :]), across[:, pitch:-pitch])
        highest = torch.maximum(torch.maximum(around[:-2], around[2:]), around[1:-1])
        inner = det[1:-1, pitch + 1 : -pitch - 1]
        peak = (inner >= highest).logical_and_(inner > threshold)
        layer, at = peak.nonzero(as_tuple=True)
        at = at + 1
        row, col = at // pitch + top, at % pitch
        margin = torch.tensor(self.margins, device=at.device)[layer]
        inside = (row >= margin) & (row < self.rows - margin) & (col >= margin) & (col < self.cols - margin)
        layer, row, col = layer[inside] + 1, row[inside], col[inside]
        at = layer * length + (row - top + 1) * pitch + col
        offsets = torch.tensor(
            [n * length + r * pitch + c for n in (-1, 0, 1) for r in (-1, 0, 1) for c in (-1, 0, 1)], device=at.device
        )
        cube = det.view(-1)[offsets[:, None] + at]
        strict = (cube >= cube[13]).sum(0) == 1
        return layer[strict], row[strict], col[strict], cube[:, strict]

    def _interpolated(self, layer: Tensor, row: Tensor, col: Tensor, cube: Tensor) -> Blobs:
        """Blobs at the maximum of the quadratic through the (27, M) responses around each (Brown and Lowe 2002)."""
        offset = _quadratic_peak(cube.view(3, 3, 3, -1))
        good = (offset.abs() <= 1).all(0) & (offset != 0).any(0)
        layer, row, col, cube, offset = layer[good], row[good], col[good], cube[:, good], offset[:, good]
        size = torch.tensor(self.sizes, device=layer.device)[layer]
        corner = torch.stack([col, row], 1) - (size // 2 // self.step)[:, None]
        xy = self.step * corner + (size[:, None] - 1) / 2 + self.step * offset[:2].T
        interpolated = torch.round(size + SIZE_STEP * self.step * offset[2])
        return Blobs(xy, interpolated, cube[13], self.laplacian_sign(layer, row, col))


def _third_difference(a: Tensor, k: int) -> Tensor:
    """a[3k:] - 3 a[2k:] + 3 a[k:] - a: the lobes 1, -2, 1, each k wide, from the cumulative sum `a`."""
    n = len(a) - 3 * k
    return (a[3 * k :] - a[:n]).sub_(a[2 * k : 2 * k + n] - a[k : k + n], alpha=3)


def _quadratic_peak(d: Tensor) -> Tensor:
    """(3, M) offset (x, y, scale) in samples of the stationary point of the quadratic through `d` (3, 3, 3, M)."""
    d = d.double()
    gx, gy, gs = (d[1, 1, 2] - d[1, 1, 0]) / 2, (d[1, 2, 1] - d[1, 0, 1]) / 2, (d[2, 1, 1] - d[0, 1, 1]) / 2
    centre = 2 * d[1, 1, 1]
    xx, yy, ss = d[1, 1, 0] + d[1, 1, 2] - centre, d[1, 0, 1] + d[1, 2, 1] - centre, d[0, 1, 1] + d[2, 1, 1] - centre
    xy = (d[1, 2, 2] - d[1, 2, 0] - d[1, 0, 2] + d[1, 0, 0]) / 4
    xs = (d[2, 1, 2] - d[2, 1, 0] - d[0, 1, 2] + d[0, 1, 0]) / 4
    ys = (d[2, 2, 1] - d[2, 0, 1] - d[0, 2, 1] + d[0, 0, 1]) / 4
    # Cramer's rule on the symmetric 3x3 system: its inverse is the adjugate over the determinant.
    a, b, c = yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy
    e, f, g = xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy
    determinant = xx * a + xy * b + xs * c
    peak = torch.stack([a * gx + b * gy + c * gs, b * gx + e * gy + f * gs, c * gx + f * gy + g * gs])
    return (-peak / determinant).nan_to_num(nan=2.0, posinf=2.0, neginf=-2.0).float()
