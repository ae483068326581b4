"""Operators alone and fused on pairs of photographs from easy to hard.

    SFMKIT_DATA=... python benchmarks/members.py [--sets temple-2,fountain-4] [--drone out/map]
        [--out out/members]

The sets are the Middlebury temple ring (640 x 480), photographs 1 to 3 positions apart; EPFL
fountain-P11 (1024 x 682), 1 to 6 views apart; and a drone flight (800 x 600), 1 to 3 photographs
apart. The flight has no ground truth: `--drone` is a COLMAP model of all its photographs together,
made by

    sfmkit map $SFMKIT_DATA/uav/toledo-p3pro --operators akaze --out out/map

The features of a photograph and the matches of an operator on a pair are computed once and used in
every combination. A finished row is kept in ``rows.jsonl``, so an interrupted run resumes. Prints
one table per set: the AUC of the pose error (the larger of rotation and translation direction) at
1, 5 and 10 degrees, the bootstrap interval (95 %) of the AUC at 5 degrees over the pairs, the pairs
with an error below 5 degrees, the pairs with a larger error that
were accepted, and the processor seconds per pair as if the combination ran alone. A pair without a
translation has an infinite error.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from sfmkit import Features, Matches, detect, read_image
from sfmkit.datasets.colmap import colmap
from sfmkit.datasets.middlebury import temple_ring
from sfmkit.datasets.strecha import strecha
from sfmkit.metrics import error_auc
from sfmkit.options import DEFAULT
from sfmkit.pipeline.stages import (
    choose_options,
    estimate_geometry,
    fuse_all,
    match_all,
    pose_errors,
)
from sfmkit.types import Camera, Verdict

MATCHERS = dict.fromkeys(("aliked", "disk", "xfeat"), "lightglue")  # others: nearest neighbours
COMBINATIONS = (
    "surf",
    "orb",
    "fast-brief",
    "sift",
    "rootsift",
    "aliked",
    "surf,orb,fast-brief",
    "surf,orb,fast-brief,sift",
    "surf,orb,fast-brief,rootsift",
    "surf,orb,rootsift",
    "surf,orb,fast-brief,aliked",
    "surf,orb,fast-brief,rootsift,aliked",
)
THRESHOLDS = (1.0, 5.0, 10.0)
SOLVED_DEG = 5.0
SAMPLES = 2_000  # of the bootstrap
REDUCED = 3  # factor on the sides of the photographs of fountain and drone


@dataclass(frozen=True)
class Photograph:
    """A photograph, read and reduced when it is needed."""

    path: Path
    camera: Camera
    factor: int = 1

    def read(self) -> np.ndarray:
        rgb = read_image(self.path).rgb
        if self.factor == 1:
            return rgb
        return cv2.resize(rgb, self.reduced().size_wh, interpolation=cv2.INTER_AREA)

    def reduced(self) -> Camera:
        w, h = self.camera.size_wh
        return self.camera.scaled((w // self.factor, h // self.factor))


@dataclass(frozen=True)
class PosedPair:
    """Two photographs and the true motion, ``X2 = R X1 + t``."""

    name: str
    image1: Photograph
    image2: Photograph
    R: np.ndarray
    t: np.ndarray


def temple(step: int) -> Iterator[PosedPair]:
    ring = temple_ring()
    for i, a in enumerate(ring):
        b = ring[(i + step) % len(ring)]
        R = b.R @ a.R.T
        images = Photograph(a.path, a.camera), Photograph(b.path, b.camera)
        yield PosedPair(f"{a.path.stem}-{b.path.stem}", *images, R, b.t - R @ a.t)


def fountain(step: int) -> Iterator[PosedPair]:
    for p in strecha(sequences=["fountain-P11"], step=step):
        images = (
            Photograph(Path(str(image)), camera, REDUCED)
            for image, camera in ((p.image1, p.camera1), (p.image2, p.camera2))
        )
        yield PosedPair(p.name, *images, p.R, p.t)


def drone(step: int, model: Path | None) -> Iterator[PosedPair]:
    if model is None:
        return
    images = Path(os.environ["SFMKIT_DATA"]) / "uav" / "toledo-p3pro"
    pairs = list(colmap(model, ["all"], images=images))
    names = sorted({str(image) for p in pairs for image in (p.image1, p.image2)})
    for p in pairs:
        if names.index(str(p.image2)) - names.index(str(p.image1)) == step:
            photographs = (
                Photograph(Path(str(image)), camera, REDUCED)
                for image, camera in ((p.image1, p.camera1), (p.image2, p.camera2))
            )
            yield PosedPair(p.name, *photographs, p.R, p.t)


def sets(model: Path | None) -> dict[str, Callable[[], Iterator[PosedPair]]]:
    """All sets by name; a set is read when it is called."""
    return {
        **{f"temple-{k}": lambda k=k: temple(k) for k in (1, 2, 3)},
        **{f"fountain-{k}": lambda k=k: fountain(k) for k in range(1, 7)},
        **{f"drone-{k}": lambda k=k: drone(k, model) for k in (1, 2, 3)},
    }


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


@cache
def features(photograph: Photograph, operator: str) -> tuple[Features, float]:
    image = photograph.read()
    return timed(lambda: detect(image, operator))


@cache
def matched(image1: Photograph, image2: Photograph, operator: str) -> tuple[Matches, float]:
    matcher = MATCHERS.get(operator, "nearest")
    options = choose_options(DEFAULT, (operator,), matchers=matcher).match
    found = {operator: (features(image1, operator)[0], features(image2, operator)[0])}
    return timed(lambda: match_all(found, options)[operator])


def judge(pair: PosedPair, operators: Sequence[str]) -> dict[str, Any]:
    """Estimate one pair with a combination: errors, verdict, counts and times."""
    images = pair.image1, pair.image2
    found = {name: tuple(features(image, name) for image in images) for name in operators}
    matches = {name: matched(*images, name) for name in operators}
    kept = {name: (a[0], b[0]) for name, (a, b) in found.items()}
    cameras = pair.image1.reduced(), pair.image2.reduced()

    def estimate():
        corr = fuse_all(kept, {name: m for name, (m, _) in matches.items()}, DEFAULT.fuse)
        return estimate_geometry(corr, cameras, DEFAULT.estimate)[0]

    view, seconds = timed(estimate)
    errors = None if view.t is None else pose_errors(view, pair.R, pair.t)
    return {
        "error": None if errors is None else max(errors.values()),
        "verdict": view.verdict.value,
        "reason": view.reason,
        "inliers": int(view.inliers.sum()),
        "detect_s": sum(s for two in found.values() for _, s in two),
        "match_s": sum(s for _, s in matches.values()),
        "estimate_s": seconds,
    }


def run(name: str, pairs: Sequence[PosedPair], combinations: Sequence[str], file: Path) -> None:
    """Add the rows of a set that are missing to the file."""
    done = {(r["pair"], r["operators"]) for r in read_rows(file) if r["set"] == name}
    with file.open("a") as out:
        for pair in pairs:
            for combination in combinations:
                if (pair.name, combination) not in done:
                    row = judge(pair, combination.split(","))
                    entry = {"set": name, "pair": pair.name, "operators": combination, **row}
                    out.write(json.dumps(entry) + "\n")
                    out.flush()


def read_rows(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def table(rows: Sequence[dict[str, Any]], combinations: Sequence[str]) -> str:
    """One line per combination."""
    heads = " | ".join(f"AUC {t:g}°" for t in THRESHOLDS)
    lines = [
        f"| operators | {heads} | 95 %, 5° | solved | wrong | s per pair |\n"
        "|---|--:|--:|--:|---|--:|--:|--:|"
    ]
    for combination in combinations:
        mine = [r for r in rows if r["operators"] == combination]
        if not mine:
            continue
        errors = [float("inf") if r["error"] is None else r["error"] for r in mine]
        auc = " | ".join(f"{a:.3f}" for a in error_auc(errors, THRESHOLDS))
        solved = sum(e < SOLVED_DEG for e in errors)
        accepted = [Verdict(r["verdict"]) is not Verdict.AMBIGUOUS for r in mine]
        wrong = sum(SOLVED_DEG <= e < np.inf and a for e, a in zip(errors, accepted))
        seconds = np.mean([r["detect_s"] + r["match_s"] + r["estimate_s"] for r in mine])
        label = combination.replace(",", ", ")
        counts = f"{interval(errors)} | {solved} of {len(mine)} | {wrong} | {seconds:.1f}"
        lines.append(f"| {label} | {auc} | {counts} |")
    return "\n".join(lines)


def interval(errors: Sequence[float]) -> str:
    """Bootstrap interval of the AUC at SOLVED_DEG over the pairs."""
    rows = np.random.default_rng(0).integers(0, len(errors), (SAMPLES, len(errors)))
    scores = np.clip(1 - np.asarray(errors) / SOLVED_DEG, 0, None)[rows].mean(1)
    low, high = np.percentile(scores, (2.5, 97.5))
    return f"{low:.2f} to {high:.2f}"


def main() -> None:
    """Run the sets that are missing and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", help="comma-separated; default: all")
    parser.add_argument("--combination", action="append", help="repeatable; default: all")
    parser.add_argument("--drone", type=Path, help="COLMAP model of the drone flight")
    parser.add_argument("--out", type=Path, default=Path("out/members"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "rows.jsonl"
    combinations = args.combination or COMBINATIONS
    available = sets(args.drone)
    for name in args.sets.split(",") if args.sets else available:
        run(name, list(available[name]()), combinations, file)
        rows = [r for r in read_rows(file) if r["set"] == name]
        if rows:
            print(f"### {name}\n\n{table(rows, combinations)}\n", flush=True)


if __name__ == "__main__":
    main()
