"""A sweep small enough to run many times: crops of one noise texture, whose homography is a
shift."""

from __future__ import annotations

import os
import queue
import sys
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
from scipy.ndimage import gaussian_filter

from sfmkit.ablation.worker import Outcome, Parcel, Setup, perform
from sfmkit.datasets import Pair
from sfmkit.types import Camera

OPERATORS = ("orb", "fast-brief", "akaze")
SHIFTS = ((12, 7), (5, 18), (-9, 11))
WIDTH, HEIGHT = 200, 160


def texture(seed: int = 3) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(260, 320))
    smooth = gaussian_filter(noise, 1.2)
    return np.clip(128 + 60 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def pairs(folder: Path, homographies: int = 2, two_views: int = 1) -> list[Pair]:
    """Pairs of one first image and a shifted one each; the last ones have cameras and a pose in
    place of H."""
    folder.mkdir(parents=True, exist_ok=True)
    whole, size = texture(), (WIDTH, HEIGHT)
    PIL.Image.fromarray(whole[40 : 40 + HEIGHT, 40 : 40 + WIDTH]).save(folder / "img1.png")
    found = []
    for k in range(homographies + two_views):
        dx, dy = SHIFTS[k % len(SHIFTS)]
        file = folder / f"img{k + 2}.png"
        PIL.Image.fromarray(whole[40 + dy : 40 + dy + HEIGHT, 40 + dx : 40 + dx + WIDTH]).save(file)
        truth: dict[str, Any] = {"H": np.array([[1.0, 0, -dx], [0, 1, -dy], [0, 0, 1]])}
        if k >= homographies:
            camera = Camera(np.array([[200.0, 0, 99.5], [0, 200, 79.5], [0, 0, 1]]), size)
            truth = {
                "camera1": camera,
                "camera2": camera,
                "R": np.eye(3),
                "t": np.array([-dx, -dy, 0.0]),
            }
        found.append(Pair("small", "noise", f"1-{k + 2}", folder / "img1.png", file, **truth))
    return found


class InlineEngine:
    """Does the work in this process; in place of the local processes."""

    shares_files = True
    slots = 2

    def __init__(self, workers: int, setup: Setup):
        self.setup = setup
        self.waiting: queue.SimpleQueue = queue.SimpleQueue()
        self.done: list = []

    def submit(self, task: Any, parcel: Parcel) -> None:
        self.waiting.put(task)

    def next(self) -> tuple[Any, Outcome]:
        task = self.waiting.get()
        outcome = perform(task, self.setup)
        self.done.append((task, outcome))
        return task, outcome

    def close(self) -> None:
        pass


def main() -> None:
    """``python small_sweep.py FOLDER OUT CACHE WORKERS``: the sweep as a process that can be
    killed."""
    from sfmkit.ablation import ablate

    folder, out, cache, workers = sys.argv[1:5]
    table = ablate(
        pairs(Path(folder)), OPERATORS, seeds=2, out=out, cache=cache, workers=int(workers)
    )
    assert len(table) == 42


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
