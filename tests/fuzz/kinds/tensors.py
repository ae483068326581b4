"""Calls of the functions on tensors and arrays with extreme values, shapes and types.

An input is the name of a function and a number from which its arguments are drawn.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import torch
from fuzz.engine import Kind
from torch import Tensor

from sfmkit.geometry import Sensitivity

EXTREMES = (0.0, 1.0, -1.0, 1e-300, 1e300, -1e300, 1e30, 1e-30, math.nan, math.inf, -math.inf)
RECORDS = ("bundle", "camera", "pinhole", "pose", "m", "objective")  # arguments, not drawn here


@cache
def _functions() -> dict[str, Callable]:
    """Return the functions that sfmkit.geometry exports and whose arguments can be drawn."""
    import sfmkit.geometry

    exported = {name: getattr(sfmkit.geometry, name) for name in sfmkit.geometry.__all__}
    return {
        name: function
        for name, function in exported.items()
        if inspect.isfunction(function)
        and not name.startswith("check_")
        and not any(map(_is_record, inspect.signature(function).parameters.values()))
    }


def _is_record(parameter: inspect.Parameter) -> bool:
    return parameter.name in RECORDS and "Tensor" not in str(parameter.annotation)


def _rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def _valid(name: str, rng: np.random.Generator, n: int) -> Any:
    """A sound value for an argument of this name."""
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    if name == "sensitivity":
        H = rng.normal(size=(n, 5, 5))
        parts = rng.normal(size=(n, 5)), H @ H.swapaxes(-1, -2), rng.normal(size=(5, 8))
        return Sensitivity(*map(torch.as_tensor, parts))
    if name == "block":
        return rng.integers(0, 4, size=n)
    if name in ("sigma1", "sigma2"):
        return rng.random(4)
    if name in ("before", "pose"):
        return np.eye(5)
    if name == "points":
        return np.broadcast_to(np.eye(3), (n, 3, 3))
    if name == "derivatives":
        return rng.normal(size=(n, 3, 13))
    if name == "shared":
        return bool(rng.integers(2))
    if name in ("R4", "t4"):
        return np.stack([_rotation(rng) if name == "R4" else rng.normal(size=3) for _ in range(4)])
    if name[0] == "x" and name != "xyz":
        return rng.normal(size=(n, 3 if name in ("xh", "x", "y") else 2))
    if name in ("X", "y", "xyz"):
        return rng.normal(size=(n, 3)) + [0, 0, 5]
    if name[0] == "R":
        return _rotation(rng)
    if name == "thresholds":
        return [5.0, 10.0]
    if name[0] in "tnwv" and name != "weights":
        return rng.normal(size=3 if name[0] != "v" else 2)
    if name[0] == "K":
        return K
    if name[0] in "EFH":
        return rng.normal(size=(3, 3))
    if name[0] == "P":
        return rng.normal(size=(3, 4))
    if name == "lines":
        return rng.normal(size=(n, 3))
    if name[0] == "d":
        return rng.normal(size=5) * 0.01
    if name in ("weights", "square", "errors_deg"):
        return rng.random(n)
    if name == "pose_covariance":
        return np.eye(5)
    if name == "size_wh":
        return (640, 480)
    return 1.0


def _changed(random: Random, value: Tensor) -> Tensor:
    """One property of a tensor changed."""
    what = random.randrange(0 if value.is_floating_point() else 4, 8)
    value = value.clone()
    extreme = torch.tensor(random.choice(EXTREMES), dtype=torch.float64).to(value.dtype)
    if what <= 1 and value.numel():
        flat = value.reshape(-1)
        flat[random.randrange(len(flat))] = extreme
        return flat.reshape(value.shape)
    if what == 2:
        return extreme.expand(value.shape)
    if what == 3:
        return value * random.choice((1e-160, 1e160, 1e-30, 1e30, 1e308))
    if what == 4:
        return value.to(random.choice((torch.float32, torch.int64, torch.bool, torch.complex128)))
    if what == 5 and value.ndim:
        cut = random.randrange(value.ndim)
        return value.narrow(cut, 0, random.randrange(value.shape[cut] + 1))
    if what == 6:
        return value.expand(random.choice(((2, *value.shape), (0, *value.shape))))
    return value.reshape(-1) if value.ndim != 1 else value.sum()


def _call(function: Callable, number: int) -> None:
    random, rng = Random(number), np.random.default_rng(number)
    n = random.choice((0, 1, 2, 4, 5, 7, 8, 20))
    n = random.choice((n, 5, 7, 12))
    arguments: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        kind = str(parameter.annotation)
        if parameter.default is not parameter.empty and (
            "Tensor" not in kind or random.random() < 0.6
        ):
            if kind == "float" and random.random() < 0.3:
                arguments[name] = random.choice(EXTREMES)
            elif kind == "int" and random.random() < 0.3:
                arguments[name] = random.choice((0, -1, 1, 3))
            elif kind == "Loss":
                arguments[name] = random.choice(("squared", "huber", "cauchy", "none", ""))
            continue
        if kind == "Loss":
            arguments[name] = random.choice(("squared", "huber", "cauchy"))
        elif kind == "float":
            arguments[name] = random.choice((1.0, *EXTREMES))
        else:
            value = _valid(name, rng, n)
            if isinstance(value, Sensitivity) and random.random() < 0.5:
                field = random.choice(fields(Sensitivity)).name
                value = replace(value, **{field: _changed(random, getattr(value, field))})
            is_tensor = isinstance(value, (np.ndarray, float))
            arguments[name] = torch.as_tensor(np.array(value)) if is_tensor else value
    tensors = [name for name, value in arguments.items() if isinstance(value, Tensor)]
    for _ in range(random.choice((0, 1, 1, 2))):
        if tensors:
            name = random.choice(tensors)
            arguments[name] = _changed(random, arguments[name])
    function(**arguments)


def _run_tensors(data: bytes, _: Path) -> None:
    name, number = data.decode().split()
    _call(_functions()[name], int(number))


def _cloud(random: Random) -> np.ndarray:
    rng = np.random.default_rng(random.randrange(2**32))
    xyz = rng.normal(size=(random.choice((0, 1, 2, 3, 10, 200)), random.choice((3, 3, 3, 3, 2))))
    what = random.randrange(8)
    if what == 0:
        xyz *= random.choice((1e-300, 1e300, 1e30, 0.0, 1e18))
    elif what == 1 and xyz.size:
        xyz.flat[random.randrange(xyz.size)] = random.choice(EXTREMES)
    elif what == 2:
        xyz = xyz + random.choice((1e6, 1e15, 1e300))
    elif what == 3:
        return xyz.astype(random.choice((np.float32, np.int64, np.bool_, np.complex128)))
    return xyz


def _run_arrays(data: bytes, _: Path) -> None:
    from sfmkit.clouds.alignment import align
    from sfmkit.clouds.density import density, histogram
    from sfmkit.features import detect

    name, number = data.decode().split()
    random = Random(int(number))
    cloud = _cloud(random)
    if name == "density":
        density(cloud, random.choice((1.0, *EXTREMES)))
    elif name == "histogram":
        values = cloud.reshape(-1)
        histogram(values, random.choice((None, None, 0, -1, 1, 10, 10**9)))
    elif name == "align":
        align(cloud, _cloud(random), seed=0)
    else:
        image = (np.abs(cloud) * 50) if random.random() < 0.5 else np.abs(cloud).astype(np.uint8)
        detect(image, random.choice(("orb", "sift", "surf", "fast-brief")))


def _names(names: Callable[[], list[str]]) -> Callable[[Random, list[bytes]], bytes]:
    def mutate(random: Random, _: list[bytes]) -> bytes:
        return f"{random.choice(names())} {random.randrange(2**32)}".encode()

    return mutate


KINDS = [
    Kind("tensors", lambda _: [], _names(lambda: sorted(_functions())), _run_tensors),
    Kind(
        "arrays",
        lambda _: [],
        _names(lambda: ["density", "histogram", "align", "detect"]),
        _run_arrays,
    ),
]
