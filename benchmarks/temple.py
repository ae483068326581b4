"""Combinations of operators on the Middlebury temple ring: 16 photographs around a plaster model.

    SFMKIT_DATA=... python benchmarks/temple.py [--step 2]

Reconstructs every pair of photographs that are `step` positions apart on the ring, and counts the
pairs whose rotation and translation direction both err by less than 5 degrees, the pairs with a
larger error, and the pairs that were rejected.
"""

from __future__ import annotations

import argparse
import os
from functools import cache
from pathlib import Path

import numpy as np

from sfmkit import Camera, Features, Matches, detect, read_image
from sfmkit.options import DEFAULT
from sfmkit.pipeline.stages import (
    choose_options,
    estimate_geometry,
    fuse_all,
    match_all,
    pose_errors,
)

CLASSIC = ("surf", "orb", "fast-brief")
COMBINATIONS: tuple[tuple[tuple[str, ...], dict[str, str]], ...] = (
    (CLASSIC, {}),
    (("aliked",), {}),
    (("aliked",), {"aliked": "lightglue"}),
    ((*CLASSIC, "aliked"), {"aliked": "lightglue"}),
    (("disk",), {"disk": "lightglue"}),
    (("xfeat",), {"xfeat": "lightglue"}),
)
CORRECT_DEG = 5.0


def read_cameras(folder: Path) -> list[tuple[Path, np.ndarray, np.ndarray, np.ndarray]]:
    """Read (path, K, R, t) of every photograph, ordered by its position on the ring."""
    lines = (folder / "templeSR_par.txt").read_text().splitlines()[1:]
    rows = [line.split() for line in lines if line.strip()]
    numbers = np.array([row[1:] for row in rows], dtype=np.float64)
    K, R, t = numbers[:, :9].reshape(-1, 3, 3), numbers[:, 9:18].reshape(-1, 3, 3), numbers[:, 18:]
    centred = -np.einsum("nji,nj->ni", R, t)
    centred -= centred.mean(0)
    plane = np.linalg.svd(centred)[2][:2]
    x, y = plane @ centred.T
    return [(folder / rows[i][0], K[i], R[i], t[i]) for i in np.argsort(np.arctan2(y, x))]


@cache
def features(path: Path, operator: str) -> Features:
    """Detect once per photograph."""
    return detect(read_image(path), operator)


@cache
def match(path1: Path, path2: Path, operator: str, matcher: str) -> Matches:
    """Match once per pair, operator and matcher."""
    options = choose_options(DEFAULT, (operator,), matchers=matcher).match
    found = {operator: (features(path1, operator), features(path2, operator))}
    return match_all(found, options)[operator]


def judge(
    view1: tuple[Path, np.ndarray, np.ndarray, np.ndarray],
    view2: tuple[Path, np.ndarray, np.ndarray, np.ndarray],
    operators: tuple[str, ...],
    matchers: dict[str, str],
) -> str:
    """Return `correct`, `wrong` or `rejected`."""
    (path1, K1, R1, t1), (path2, K2, R2, t2) = view1, view2
    found = {name: (features(path1, name), features(path2, name)) for name in operators}
    matched = {name: match(path1, path2, name, matchers.get(name, "nearest")) for name in operators}
    corr = fuse_all(found, matched, DEFAULT.fuse)
    cameras = tuple(Camera(K, read_image(p).size_wh) for K, p in ((K1, path1), (K2, path2)))
    view, _ = estimate_geometry(corr, (cameras[0], cameras[1]), DEFAULT.estimate)
    if view.t is None:
        return "rejected"
    R = R2 @ R1.T
    errors = pose_errors(view, R, t2 - R @ t1)
    return "correct" if max(errors.values()) < CORRECT_DEG else "wrong"


def main() -> None:
    """Print one line per combination."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--step", type=int, default=2, help="positions between the photographs")
    step = parser.parse_args().step
    ring = read_cameras(Path(os.environ["SFMKIT_DATA"]) / "middlebury" / "templeSparseRing")
    print("| operators | pairs | correct | wrong | rejected |\n|---|--:|--:|--:|--:|")
    for operators, matchers in COMBINATIONS:
        results = [
            judge(view, ring[(i + step) % len(ring)], operators, matchers)
            for i, view in enumerate(ring)
        ]
        counts = " | ".join(str(results.count(kind)) for kind in ("correct", "wrong", "rejected"))
        names = ", ".join(
            f"{name} ({matchers[name]})" if name in matchers else name for name in operators
        )
        print(f"| {names} | {len(results)} | {counts} |", flush=True)


if __name__ == "__main__":
    main()
