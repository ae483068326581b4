"""Point clouds as PLY files, with provenance or from other programs."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement, PlyParseError
from torch import Tensor

from .._utils.writing import atomic_write
from ..errors import InputError
from ..types import PointCloud
from .ply_header import Header, read_header, read_words

_BIT = "operator bit "  # a header comment "operator bit 0 = surf" names bit 0 of the masks
_COVARIANCE = {
    "cxx": (0, 0),
    "cxy": (0, 1),
    "cxz": (0, 2),
    "cyy": (1, 1),
    "cyz": (1, 2),
    "czz": (2, 2),
}
_PROVENANCE = {
    "operators",
    "operators_high",
    "operator",
    "match",
    "reprojection_error",
    "parallax",
    *_COVARIANCE,
}
_COLOURS = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
)


def write_ply(
    path: str | os.PathLike, cloud: PointCloud, fields: Mapping[str, Tensor] | None = None
) -> None:
    """Write a cloud as binary little-endian PLY, completely or not at all.

    Coordinates are in the frame of camera 1 (x right, y down, z forward), in baselines. The
    properties of a vertex are:

    - ``x y z``: float, which viewers expect, or double if float is not precise enough
      (:func:`needs_double`);
    - ``red green blue`` uchar;
    - ``operators`` uint: one bit per operator that found the point; the comments of the header name
      the bits (those from the 33rd on are in ``operators_high``);
    - ``operator`` uchar: number of the operator whose position was kept;
    - ``match`` int: row of the point in the correspondences;
    - ``reprojection_error`` float, pixels, and ``parallax`` float, degrees;
    - ``cxx cxy cxz cyy cyz czz`` float, if the cloud has covariances;
    - `fields` float.

    A cloud without operators comes from another program. Its provenance and its frame are unknown
    and not written.

    Args:
        path: Path of the file.
        cloud: M points.
        fields: Names and (M,) tensors of further values, such as a density.

    Raises:
        OutputError: The file cannot be written.
    """
    mask = cloud.operator_mask
    kind = "<f8" if needs_double(cloud) else "<f4"
    columns: dict[str, tuple[str, Tensor]] = {
        name: (kind, cloud.xyz[:, k]) for k, name in enumerate("xyz")
    }
    columns |= {name: ("u1", cloud.rgb[:, k]) for k, name in enumerate(("red", "green", "blue"))}
    if cloud.operators:
        columns["operators"] = ("<u4", mask & 0xFFFFFFFF)
        if len(cloud.operators) > 32:
            columns["operators_high"] = ("<u4", mask >> 32)
        columns["operator"] = ("u1", cloud.operator_id)
        columns["match"] = ("<i4", cloud.match)
        columns["reprojection_error"] = ("<f4", cloud.reprojection_error)
        columns["parallax"] = ("<f4", cloud.parallax)
    if cloud.covariance is not None:
        columns |= {
            name: ("<f4", cloud.covariance[:, i, j]) for name, (i, j) in _COVARIANCE.items()
        }
    columns |= {name: ("<f4", values) for name, values in (fields or {}).items()}

    vertices = np.empty(len(cloud), dtype=[(name, kind) for name, (kind, _) in columns.items()])
    for name, (_, values) in columns.items():
        vertices[name] = values.detach().cpu().numpy()
    comments = (
        ["sfmkit: frame of camera 1, x right, y down, z forward, in baselines"]
        if cloud.operators
        else []
    )
    comments += [f"{_BIT}{k} = {name}" for k, name in enumerate(cloud.operators)]
    element = PlyElement.describe(vertices, "vertex")
    with atomic_write(path) as temporary:
        PlyData([element], text=False, byte_order="<", comments=comments).write(temporary)


def needs_double(cloud: PointCloud) -> bool:
    """Return whether the positions of a cloud need 64-bit numbers.

    The points of a cloud of sfmkit are around the cameras, in baselines. Rounding to 32 bit changes
    them by 1 in 10^7, far less than the error of a triangulated point. The cloud needs 64 bit if it
    was moved so far from the origin that rounding exceeds 10^-6 of its extent. A cloud of another
    program needs 64 bit unless its numbers are 32-bit numbers.
    """
    xyz = cloud.xyz
    if not len(xyz):
        return False
    if not cloud.operators:
        return bool((xyz.float().double() != xyz).any())
    low, high = torch.quantile(_some(xyz), torch.tensor([0.01, 0.99], dtype=xyz.dtype), dim=0)
    rounding = float(xyz.abs().max()) * torch.finfo(torch.float32).eps / 2
    return rounding > 1e-6 * float((high - low).norm())


def _some(xyz: Tensor) -> Tensor:
    """Return at most 100,000 evenly spaced rows of the points."""
    return xyz[:: max(1, len(xyz) // 100_000)]


def read_ply(path: str | os.PathLike) -> PointCloud:
    """Read the vertices of a PLY file, of this package or of another program, ASCII or binary.

    Positions are read in the precision of the file. Missing properties have defaults: mid-grey
    colours; no operators, masks 0; ``operator_id`` 0 and ``match`` -1; reprojection error and
    parallax NaN; no covariance. Colours may be bytes, 16 bit, or floats in [0, 1] or [0, 255].
    Vertices without a finite position are dropped, and a warning states their number. Lists,
    normals and all elements except vertices are ignored.

    Raises:
        InputError: The file is missing, not a PLY file, damaged or truncated, or has no usable
            vertex. The message contains the element and the row if they are known.
    """
    path = Path(path)
    comments, vertices = _parse(path)
    if not len(vertices):
        raise InputError(f"{path} holds no vertices")
    names = {
        name.lower(): name
        for name in vertices.dtype.names or ()
        if vertices.dtype[name].kind in "iuf"
    }
    if not {"x", "y", "z"} <= names.keys():
        raise InputError(
            f"{path} has no x, y, z for its vertices, only {', '.join(vertices.dtype.names or ())}"
        )

    xyz = _columns(vertices, [names[k] for k in "xyz"], np.float64)
    finite = np.isfinite(xyz).all(1)
    count, kept = len(xyz), int(finite.sum())
    if not kept:
        raise InputError(f"{path}: none of the {count:,} vertices has a finite position")
    if kept < count:
        warnings.warn(
            f"{path}: {count - kept:,} of {count:,} vertices without a finite position "
            "were dropped",
            stacklevel=2,
        )
        xyz, vertices = xyz[finite], vertices[finite]
    operators = _operators(comments)
    if not operators:  # columns with these names have another meaning in other programs
        names = {key: name for key, name in names.items() if key not in _PROVENANCE}

    def column(name: str, otherwise: float, dtype: torch.dtype) -> Tensor:
        if name in names:
            return torch.from_numpy(vertices[names[name]].astype(np.float64)).to(dtype)
        # a broadcast view of one number takes no memory
        return torch.tensor(otherwise, dtype=dtype).expand(kept)

    covariance = None
    if names.keys() >= _COVARIANCE.keys():
        covariance = torch.empty(kept, 3, 3, dtype=torch.float64)
        for name, (i, j) in _COVARIANCE.items():
            covariance[:, i, j] = covariance[:, j, i] = column(name, 0, torch.float64)
    mask = column("operators", 0, torch.int64)
    if "operators_high" in names:
        mask = mask | column("operators_high", 0, torch.int64) << 32
    operator_id = column("operator", 0, torch.int64)
    if operators and not bool(((operator_id >= 0) & (operator_id < len(operators))).all()):
        raise InputError(f"{path}: a vertex has an operator that the header does not name")
    return PointCloud(
        xyz=torch.from_numpy(xyz),
        rgb=_colours(vertices, names),
        operator_id=operator_id,
        operator_mask=mask,
        operators=operators,
        reprojection_error=column("reprojection_error", float("nan"), torch.float64),
        parallax=column("parallax", float("nan"), torch.float64),
        match=column("match", -1, torch.int64),
        covariance=covariance,
    )


def _parse(path: Path) -> tuple[list[str], np.ndarray]:
    """Read the comments of the header, and the vertices as a structured array."""
    try:
        header = read_header(path)
        return _parse_body(path, header)
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory; name a PLY file") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # plyfile raises NumPy's errors on damaged bodies
        raise InputError(
            f"{path} cannot be read as PLY ({error}): it is damaged, truncated or of another kind"
        ) from error


def _parse_body(path: Path, header: Header) -> tuple[list[str], np.ndarray]:
    if not any(element.name == "vertex" for element in header.elements):
        return [], np.zeros(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's, for empty lists
            if header.as_is:  # binary vertices are memory-mapped
                ply = PlyData.read(path, mmap="c")
            else:
                body = path.read_bytes()[header.size :]
                ply = PlyData.read(io.BytesIO(header.canonical + body))
        return ply.comments, ply["vertex"].data
    except (PlyParseError, ValueError):
        vertices = read_words(path, header, "vertex")
        if vertices is None:
            raise
        return header.comments, vertices


def _columns(vertices: np.ndarray, names: list[str], dtype: type) -> np.ndarray:
    """Return an (N, len(names)) array of properties of the vertices."""
    columns: np.ndarray = np.empty((len(vertices), len(names)), dtype)
    for k, name in enumerate(names):
        columns[:, k] = vertices[name]
    return columns


def _colours(vertices: np.ndarray, names: dict[str, str]) -> Tensor:
    """Return (N, 3) uint8 colours."""
    for triple in _COLOURS:
        if not set(triple) <= names.keys():
            continue
        columns = [names[k] for k in triple]
        kind = vertices.dtype[columns[0]]
        if kind.kind == "f":
            values = _columns(vertices, columns, np.float32)
            most = 1 if np.nanmax(values, initial=0) <= 1 else 255
            values = np.nan_to_num(values / most, nan=0.5).clip(0, 1)
            return torch.from_numpy(np.rint(values * 255).astype(np.uint8))
        values = _columns(vertices, columns, np.int64 if kind.itemsize > 2 else np.int32)
        if kind.itemsize > 1 and values.max() > 255:
            values = values >> 8
        return torch.from_numpy(values.clip(0, 255).astype(np.uint8))
    return torch.tensor(128, dtype=torch.uint8).expand(len(vertices), 3)


def _operators(comments: list[str]) -> tuple[str, ...]:
    """Read the names of the bits from the header."""
    named = [
        comment.removeprefix(_BIT).split(" = ", 1)
        for comment in comments
        if comment.startswith(_BIT)
    ]
    bits = {int(k): name for k, name in (n for n in named if len(n) == 2) if k.isdecimal()}
    return tuple(bits[k] for k in sorted(bits)) if sorted(bits) == list(range(len(bits))) else ()
