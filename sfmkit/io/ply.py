"""Point clouds as PLY files: ours with their provenance, and anybody's."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.lib.recfunctions import structured_to_unstructured
from plyfile import PlyData, PlyElement, PlyParseError
from torch import Tensor

from .._utils.writing import atomic_write
from ..errors import InputError
from ..types import PointCloud

_BIT = "operator bit "  # a header comment "operator bit 0 = surf" names bit 0 of the masks
_COVARIANCE = {
    "cxx": (0, 0),
    "cxy": (0, 1),
    "cxz": (0, 2),
    "cyy": (1, 1),
    "cyz": (1, 2),
    "czz": (2, 2),
}
_COLOURS = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
)


def write_ply(
    path: str | os.PathLike, cloud: PointCloud, fields: Mapping[str, Tensor] | None = None
) -> None:
    """Write a cloud as binary little-endian PLY, whole or not at all.

    In the frame of camera 1 (x right, y down, z forward), in baselines. Properties of a vertex:

    - ``x y z`` float: what viewers expect, and its 1 in 10^7 lies far below a triangulated point's
      own error;
    - ``red green blue`` uchar;
    - ``operators`` uint: a bit for each operator that found the point, named in the header's
      comments (those from the 33rd on are in ``operators_high``);
    - ``operator`` uchar: the number of the one whose position was kept;
    - ``match`` int: the point's row in the correspondences;
    - ``reprojection_error`` float, pixels, and ``parallax`` float, degrees;
    - ``cxx cxy cxz cyy cyz czz`` float, where the cloud has covariances;
    - `fields`, float: names and (M,) tensors of whatever else there is to say of a point, e.g. a
      density.

    A foreign cloud, one without operators, has neither provenance nor a known frame, and none is
    written.

    Raises:
        OutputError: the file cannot be written.
    """
    mask = cloud.operator_mask
    columns: dict[str, tuple[str, Tensor]] = {
        name: ("<f4", cloud.xyz[:, k]) for k, name in enumerate("xyz")
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


def read_ply(path: str | os.PathLike) -> PointCloud:
    """Read the vertices of a PLY file, ours or anybody's, ASCII or binary.

    What a foreign file does not tell is: colour mid-grey; no operators, masks 0; ``operator_id`` 0
    and ``match`` -1; reprojection error and parallax NaN; no covariance. Colours may be bytes, 16
    bit or floats in [0, 1]. Vertices whose position is not finite are dropped with a warning that
    counts them. Everything but the vertices is ignored.

    Raises:
        InputError: no such file, no PLY, a damaged or truncated one, or one without a usable
            vertex.
    """
    path = Path(path)
    ply = _parse(path)
    if "vertex" not in ply or not ply["vertex"].count:
        raise InputError(f"{path} holds no vertices")
    vertices = ply["vertex"].data
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
            f"{path}: {count - kept:,} of {count:,} vertices without a finite position were dropped",
            stacklevel=2,
        )
        xyz, vertices = xyz[finite], vertices[finite]

    def column(name: str, otherwise: float, dtype: torch.dtype) -> Tensor:
        if name in names:
            return torch.from_numpy(vertices[names[name]].astype(np.float64)).to(dtype)
        return torch.tensor(otherwise, dtype=dtype).expand(
            kept
        )  # one number seen `kept` times: millions cost nothing

    covariance = None
    if names.keys() >= _COVARIANCE.keys():
        covariance = torch.empty(kept, 3, 3, dtype=torch.float64)
        for name, (i, j) in _COVARIANCE.items():
            covariance[:, i, j] = covariance[:, j, i] = column(name, 0, torch.float64)
    operators = _operators(ply.comments)
    mask = column("operators", 0, torch.int64)
    if "operators_high" in names:
        mask = mask | column("operators_high", 0, torch.int64) << 32
    return PointCloud(
        xyz=torch.from_numpy(xyz),
        rgb=_colours(vertices, names),
        operator_id=column("operator", 0, torch.int64),
        operator_mask=mask,
        operators=operators,
        reprojection_error=column("reprojection_error", float("nan"), torch.float64),
        parallax=column("parallax", float("nan"), torch.float64),
        match=column("match", -1, torch.int64),
        covariance=covariance,
    )


def _parse(path: Path) -> PlyData:
    try:
        return PlyData.read(
            path, mmap="c"
        )  # binary vertices stay in the file until they are looked at
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory; name a PLY file") from None
    except (
        PlyParseError,
        ValueError,
        MemoryError,
        OverflowError,
    ) as error:  # ValueError covers undecodable headers
        raise InputError(
            f"{path} cannot be read as PLY ({error}): it is damaged, truncated or of another kind"
        ) from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error


def _columns(vertices: np.ndarray, names: list[str], dtype: type) -> np.ndarray:
    """(N, len(names)) array of some of the vertices' properties."""
    return np.ascontiguousarray(structured_to_unstructured(vertices[names], dtype=dtype))


def _colours(vertices: np.ndarray, names: dict[str, str]) -> Tensor:
    """(N, 3) uint8."""
    for triple in _COLOURS:
        if not set(triple) <= names.keys():
            continue
        columns = [names[k] for k in triple]
        kind = vertices.dtype[columns[0]]
        if kind.kind == "f":
            values = np.nan_to_num(_columns(vertices, columns, np.float32), nan=0.5)
            return torch.from_numpy(np.rint(values.clip(0, 1) * 255).astype(np.uint8))
        values = _columns(vertices, columns, np.int64 if kind.itemsize > 2 else np.uint16)
        if kind.itemsize > 1 and values.max() > 255:
            values = values >> 8
        return torch.from_numpy(values.clip(0, 255).astype(np.uint8))
    return torch.tensor(128, dtype=torch.uint8).expand(len(vertices), 3)


def _operators(comments: list[str]) -> tuple[str, ...]:
    """The names that the header gives the bits."""
    named = [
        comment.removeprefix(_BIT).split(" = ", 1)
        for comment in comments
        if comment.startswith(_BIT)
    ]
    bits = {int(k): name for k, name in (n for n in named if len(n) == 2) if k.isdecimal()}
    return tuple(bits[k] for k in sorted(bits)) if sorted(bits) == list(range(len(bits))) else ()
