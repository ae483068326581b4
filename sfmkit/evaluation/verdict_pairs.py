"""Pairs of the benchmark of verdicts, with and without a solution."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from .verdict_views import BenchView, Placed, overlap, photographs, rendered, repeated

__all__ = ["BenchPair", "bench_pairs_of_verdicts"]

FOUNTAIN_STEPS, TEMPLE_STEPS, TEMPLE_FAR = (1, 2, 3, 4, 5), (1, 2), (3, 4, 6, 8)
ACROSS = 160  # pairs of different scenes
OVERLAPPING = 0.5  # smallest overlap with which a pair of repeated texture counts as solvable
MOST_HALF = 0.45  # width of each of two disjoint parts over the width of the photograph


@dataclass(frozen=True, eq=False)
class BenchPair:
    """Two photographs and what is known about them.

    Attributes:
        group: Group of the pair, a line of the table.
        solvable: Whether the photographs overlap enough. A pose of any other pair is right only by
            chance.
        view1, view2: The photographs.
        truth: R, t with ``X2 = R X1 + t``; None if there is no true pose or it is unknown.
    """

    group: str
    solvable: bool
    view1: BenchView
    view2: BenchView
    truth: Placed | None

    @property
    def name(self) -> str:
        """A name that is unique in the benchmark."""
        one, two = self.view1, self.view2
        return f"{self.group}: {one.scene} {one.name}, {two.scene} {two.name}"


def _pair(group: str, solvable: bool, view1: BenchView, view2: BenchView) -> BenchPair:
    truth = None
    if view1.scene == view2.scene and view1.pose is not None and view2.pose is not None:
        (R1, t1), (R2, t2) = view1.pose, view2.pose
        truth = R2 @ R1.T, t2 - R2 @ R1.T @ t1
    # The scene of a rendered photograph cannot be sent to another process.
    view1, view2 = (replace(view, rendering=None) for view in (view1, view2))
    return BenchPair(group, solvable, view1, view2, truth)


def bench_pairs_of_verdicts(data: str | os.PathLike | None, folder: Path) -> list[BenchPair]:
    """List all pairs of the benchmark.

    Args:
        data: Folder of the data sets, see :func:`sfmkit.datasets.pair.data_root`.
        folder: Folder in which rendered photographs are stored.

    Raises:
        InputError: A data set is missing or damaged.
    """
    photos = photographs(data)
    scenes = list(rendered(folder))
    patterns = list(repeated(folder))
    singles = [view for views in photos.values() for view in views]
    copies = [views[0] for views in patterns]
    firsts = [first for _, first, _ in scenes if first.scene in ("courtyard", "plane", "dish")]
    return [
        *_of_photographs(photos),
        *_of_scenes(scenes),
        *(pair for views in patterns for pair in _of_repeated(views)),
        *_across([*singles, *firsts, *copies]),
        *(pair for k, view in enumerate([*singles, *copies]) for pair in _of_one(view, k % 2)),
    ]


def _of_photographs(photos: dict[str, list[BenchView]]) -> Iterator[BenchPair]:
    fountain, temple, drone = photos["fountain"], photos["temple"], photos["drone"]
    for step in FOUNTAIN_STEPS:
        for one, two in zip(fountain, fountain[step:]):
            yield _pair(f"fountain, {step} apart", True, one, two)
    for step in (*TEMPLE_STEPS, *TEMPLE_FAR):
        near = step in TEMPLE_STEPS
        group = f"temple ring, {step} apart" if near else "temple ring, 3 to 8 apart"
        turn = len(temple) // 2 if 2 * step == len(temple) else len(temple)
        for k in range(turn):
            yield _pair(group, near, temple[k], temple[(k + step) % len(temple)])
    for one, two in combinations(drone, 2):
        yield _pair("drone (no truth)", True, one, two)


def _of_scenes(scenes: list[tuple[str, BenchView, BenchView]]) -> Iterator[BenchPair]:
    for name, first, second in scenes:
        solvable = name != "no-overlap"
        yield _pair("rendered scenes" if solvable else "rendered, apart", solvable, first, second)
    yard = {name: (first, second) for name, first, second in scenes}
    views = [
        replace(yard[name][1], scene="courtyard", name=f"2 of {name}")
        for name in ("courtyard", "wide", "forward")
    ]
    for one, two in combinations(views, 2):
        yield _pair("rendered scenes", True, one, two)


def _of_repeated(views: list[BenchView]) -> Iterator[BenchPair]:
    kind = views[0].scene.split("-")[0]
    for one, two in combinations(views, 2):
        share = overlap(one, two)
        part = "overlapping" if share >= OVERLAPPING else "shifted" if share > 0 else "apart"
        yield _pair(f"{kind}, {part}", share >= OVERLAPPING, one, two)


def _across(views: list[BenchView]) -> Iterator[BenchPair]:
    """Draw pairs of different scenes with a fixed seed; all scenes are equally likely."""
    rng = np.random.default_rng(0)
    by_scene: dict[str, list[BenchView]] = {}
    for view in views:
        by_scene.setdefault(view.scene.split("-")[0], []).append(view)
    names = list(by_scene)
    seen: set[tuple[int, int, int, int]] = set()
    while len(seen) < ACROSS:
        a, b = (int(v) for v in rng.choice(len(names), 2, replace=False))
        i, j = (int(rng.integers(len(by_scene[names[k]]))) for k in (a, b))
        if (a, i, b, j) not in seen and (b, j, a, i) not in seen:
            seen.add((a, i, b, j))
            yield _pair("across scenes", False, by_scene[names[a]][i], by_scene[names[b]][j])


def _of_one(view: BenchView, axis: int) -> Iterator[BenchPair]:
    """Pair a photograph with its mirror image, and its left part with its right part."""
    yield _pair("mirrored", False, view, view.mirrored(f"{view.name} mirrored", axis))
    w = view.camera.size_wh[0]
    part = int(MOST_HALF * w)
    left = view.cropped(f"{view.name} left", 0, part)
    right = view.cropped(f"{view.name} right", w - part, w)
    yield _pair("disjoint halves", False, left, right)
