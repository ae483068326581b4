"""Evaluate combinations of operators on the 16 photographs of the Middlebury temple ring.

    SFMKIT_DATA=... python benchmarks/temple.py [--step 2]

Reconstructs every pair of photographs that are `step` positions apart on the ring, and counts the
pairs with errors of rotation and translation direction below 5 degrees, the pairs with a larger
error, and the pairs that were rejected.
"""

from __future__ import annotations

import argparse
from functools import cache
from pathlib import Path

from sfmkit import Features, Matches, detect, read_image
from sfmkit.datasets.middlebury import RingView, temple_ring
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
    view1: RingView,
    view2: RingView,
    operators: tuple[str, ...],
    matchers: dict[str, str],
) -> str:
    """Return `correct`, `wrong` or `rejected`."""
    found = {name: (features(view1.path, name), features(view2.path, name)) for name in operators}
    matched = {
        name: match(view1.path, view2.path, name, matchers.get(name, "nearest"))
        for name in operators
    }
    corr = fuse_all(found, matched, DEFAULT.fuse)
    view, _ = estimate_geometry(corr, (view1.camera, view2.camera), DEFAULT.estimate)
    if view.t is None:
        return "rejected"
    R = view2.R @ view1.R.T
    errors = pose_errors(view, R, view2.t - R @ view1.t)
    return "correct" if max(errors.values()) < CORRECT_DEG else "wrong"


def main() -> None:
    """Print one line per combination."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--step", type=int, default=2, help="positions between the photographs")
    step = parser.parse_args().step
    ring = temple_ring()
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
