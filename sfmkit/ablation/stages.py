"""The computations of workers: features, matches and estimates, as entries of the cache.

Times are processor times, because they depend less on the other work of the machine, and a worker
computes on one thread.
"""

from __future__ import annotations

import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..estimation import within_the_field
from ..features import detect
from ..io.images import Image, decode_image, read_image
from ..matching import run_matcher
from ..pipeline.registration import register_matches
from ..pipeline.stages import estimate_geometry, fuse_all
from ..types import Correspondences, Features, Matches, Verdict
from .cache import Cache
from .entry import Entry
from .geometries import make_geometry
from .memory import PeakMemory
from .tasks import DetectTask, EstimateTask, ImageRef, Job, MatchTask, PairTask

MEMORY = 512 << 20  # bytes of arrays that a worker keeps in memory
_FEATURES = ("keypoints", "scales", "angles", "scores", "descriptors")


class Store:
    """Results from memory, from the cache, or computed now.

    Args:
        cache: None if the worker shares no files.
        inputs: Key -> bytes that were sent with the task.
        images: Digest -> bytes of the image, if the worker does not see its file.
        say: Called with a message about each damaged entry.
        kept: Results in memory, most recently used last.
    """

    def __init__(
        self,
        cache: Cache | None,
        inputs: Mapping[str, bytes] | None = None,
        images: Mapping[str, bytes] | None = None,
        say: Callable[[str], None] = lambda text: None,
        kept: OrderedDict[str, Entry] | None = None,
    ):
        self.cache, self.inputs, self.images, self.say = cache, inputs or {}, images or {}, say
        self._kept: OrderedDict[str, Entry] = OrderedDict() if kept is None else kept

    def result(self, task: DetectTask | MatchTask | PairTask) -> Entry:
        found = self._find(task)
        if found is None:
            found = make(task, self)
            if self.cache is not None:
                self.cache.put(task.kind, found)
        self._keep(found)
        return found

    def _find(self, task: DetectTask | MatchTask | PairTask) -> Entry | None:
        if task.key in self._kept:
            return self._kept[task.key]
        if task.key in self.inputs:
            return Entry.from_bytes(self.inputs[task.key], task.key)
        return None if self.cache is None else self.cache.get(task.kind, task.key, self.say)

    def _keep(self, entry: Entry) -> None:
        self._kept[entry.key] = entry
        self._kept.move_to_end(entry.key)
        while len(self._kept) > 1 and sum(e.nbytes for e in self._kept.values()) > MEMORY:
            self._kept.popitem(last=False)

    def image(self, ref: ImageRef) -> Image:
        if ref.digest not in self.images:
            return read_image(ref.path)
        return decode_image(self.images[ref.digest], Path(ref.path))


def make(task: DetectTask | MatchTask | PairTask, store: Store) -> Entry:
    """Compute the result of a task from the results that it needs."""
    if isinstance(task, DetectTask):
        return make_features(task, store)
    if isinstance(task, MatchTask):
        return make_matches(task, store)
    features = {
        name: (features_of(store.result(match.first)), features_of(store.result(match.second)))
        for name, match in task.matches.items()
    }
    masks = [None if mask is None else store.image(mask).grey for mask in task.masks]
    return make_geometry(task, features, (masks[0], masks[1]))


def make_features(task: DetectTask, store: Store) -> Entry:
    """Detect the features of an image (stage 1)."""
    s = task.setting
    with PeakMemory() as memory:
        image = store.image(task.image)
        began = time.process_time()
        f = detect(
            image,
            s.operator,
            budget=s.budget,
            max_size=s.max_size,
            preset=s.preset,  # type: ignore[arg-type]
            **dict(s.options),
        )
        seconds = time.process_time() - began
    arrays = {name: getattr(f, name) for name in _FEATURES}
    if f.laplacian is not None:
        arrays["laplacian"] = f.laplacian
    meta = {
        "operator": s.operator,
        "norm": f.norm,
        "size_wh": list(f.size_wh),
        "seconds": seconds,
        "peak_mb": memory.mb,
    }
    return Entry(task.key, meta, arrays)


def features_of(entry: Entry) -> Features:
    a, m = entry.arrays, entry.meta
    return Features(
        **{name: a[name] for name in _FEATURES},
        norm=m["norm"],
        operator=m["operator"],
        size_wh=(m["size_wh"][0], m["size_wh"][1]),
        laplacian=a.get("laplacian"),
    )


def make_matches(task: MatchTask, store: Store) -> Entry:
    """Match the features of one operator (stage 2)."""
    f1, f2 = (features_of(store.result(t)) for t in task.needs)
    with PeakMemory() as memory:
        began = time.process_time()
        m = run_matcher(f1, f2, task.options, operator=task.operator)
        seconds = time.process_time() - began
    arrays = {"index1": m.index1, "index2": m.index2, "distance": m.distance, "ratio": m.ratio}
    return Entry(
        task.key, {"operator": task.operator, "seconds": seconds, "peak_mb": memory.mb}, arrays
    )


def estimate_combination(
    task: EstimateTask, combination: tuple[str, ...], jobs: list[Job], store: Store
) -> list[Entry]:
    """Fuse the matches of one combination and estimate its geometry with all seeds (stage 3).

    The operators are fused in the order of their names, so that the result does not depend on the
    order in which a combination is written.
    """
    features: dict[str, tuple[Features, Features]] = {}
    matches: dict[str, Matches] = {}
    seconds = {"detect": 0.0, "match": 0.0}
    peak = 0.0
    for name in sorted(combination):
        recipe = task.matches[name]
        made, *found = store.result(recipe), *(store.result(t) for t in recipe.needs)
        matches[name] = Matches(**made.arrays)
        features[name] = (features_of(found[0]), features_of(found[1]))
        seconds["detect"] += sum(e.meta["seconds"] for e in found)
        seconds["match"] += made.meta["seconds"]
        peak = max(peak, *(e.meta["peak_mb"] for e in (made, *found)))
    began = time.process_time()
    fused = fuse_all(features, matches, task.variant.options.fuse)
    seconds["fuse"] = time.process_time() - began
    keypoints = [sum(len(pair[k]) for pair in features.values()) for k in (0, 1)]
    common = {
        "keypoints": keypoints,
        "matches": sum(len(m) for m in matches.values()),
        "correspondences": len(fused),
    }
    entries = []
    for job in jobs:
        with PeakMemory() as memory, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            began = time.process_time()
            if task.homography:
                result = _homography(task, features, matches, fused, job.seed)
            else:
                result = _two_view(task, fused, job.seed)
            spent = seconds | {"estimate": time.process_time() - began}
        meta = {**common, **result, "seconds": spent, "peak_mb": max(peak, memory.mb)}
        entries.append(Entry(job.key, meta))
    return entries


def _homography(
    task: EstimateTask,
    features: dict[str, tuple[Features, Features]],
    matches: dict[str, Matches],
    fused: Correspondences,
    seed: int,
) -> dict[str, Any]:
    variant = task.variant
    options = replace(variant.options, planar=variant.planar)
    r = register_matches(features, matches, options=options, seed=seed, fused=fused)
    return {
        "verdict": r.verdict.value,
        "reason": r.reason,
        "inliers": int(r.inliers.sum()),
        "guided": None if r.guided is None else len(r.guided),
        "H": None if r.H is None else r.H.flatten().tolist(),
        "R": None,
        "t": None,
    }


def _two_view(task: EstimateTask, fused: Correspondences, seed: int) -> dict[str, Any]:
    if task.cameras is None:
        raise InputError("there is no camera for this pair")
    options = task.variant.options.estimate
    fused = within_the_field(fused, *task.cameras)
    view, _ = estimate_geometry(fused, task.cameras, options, seed=seed)
    trusted = view.verdict is not Verdict.TOO_LITTLE
    return {
        "verdict": view.verdict.value,
        "reason": view.reason,
        "inliers": int(view.inliers.sum()),
        "guided": None,
        "H": None,
        "R": None if view.R is None or not trusted else view.R.flatten().tolist(),
        "t": None if view.t is None or not trusted else view.t.tolist(),
    }


def as_arrays(entry: Entry) -> dict[str, np.ndarray | None]:
    """Return H, R and t of an estimate."""
    shapes = {"H": (3, 3), "R": (3, 3), "t": (3,)}
    return {
        name: None if entry.meta[name] is None else np.array(entry.meta[name]).reshape(shape)
        for name, shape in shapes.items()
    }
