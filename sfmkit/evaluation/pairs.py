"""Benchmark of pairs: each operator alone, and all together, on the pairs of any data set.

The pairs come from a data set, a pair list, a folder, a COLMAP model or a plug-in. A pair of the
kind ``homography`` is registered; any other pair is estimated as a two-view geometry. Features are
detected once per image and operator and matched once per pair and operator; all sets of operators
and all seeds use the same matches.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from .._utils.notices import collected
from .._utils.progress import Progress
from .._utils.sharding import Shard, part_of
from .._utils.writing import check_folder
from .._version import __version__
from ..datasets import Pair, find_source
from ..datasets.pair import HOMOGRAPHY
from ..errors import InputError, SfmError
from ..estimation import within_the_field
from ..features import choose_operators
from ..io.images import Image, read_image
from ..matching.plugins import canonical_matchers
from ..metrics import (
    check_point_error,
    corner_error,
    match_errors,
    mean_matching_accuracy,
    transfer_errors,
)
from ..options import Options, adjust_preset
from ..pipeline.account import ALL
from ..pipeline.registration import register_matches
from ..pipeline.stages import (
    OPERATORS_OF_THE_PAPER,
    FeaturePairs,
    Stopwatch,
    choose_cameras,
    choose_options,
    detect_all,
    estimate_geometry,
    fuse_all,
    make_cloud,
    match_all,
    pose_errors,
)
from ..types import Camera, Correspondences, Matches, TwoView, Verdict
from .rows import Row, RowStore, finite
from .settings import plugin_settings

__all__ = ["FAILED", "RESULT", "bench_pairs", "find_pairs", "pose_error"]

RESULT, FAILED = "result", "failed"

Cameras = tuple[Camera, Camera]
Truth = Literal["pose", "homography"]


def bench_pairs(
    data: Sequence[str | os.PathLike],
    out: str | os.PathLike,
    *,
    root: str | os.PathLike | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    matchers: str | Mapping[str, str] | None = None,
    backend: str | None = None,
    preset: str = "default",
    seeds: int = 1,
    max_size: int | None = None,
    shard: Shard | None = None,
    truth: Truth | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Run the missing parts of the benchmark and return all of its rows.

    Args:
        data: At least one data set, list or folder, see :func:`sfmkit.datasets.find_source`.
        out: Folder for ``rows.jsonl``.
        root: Folder of the data sets; for a list or a COLMAP model, the folder of its images.
        operators: At least one; each runs alone, and all together as ``multi``.
        matchers: Matcher of all operators, or a mapping operator -> matcher; None for those of
            the preset.
        backend: Robust estimator of two-view geometries; None for that of the preset.
        preset: Name in :data:`sfmkit.options.PRESETS`.
        seeds: Every estimate is repeated with seeds 0 ... seeds - 1.
        max_size: Longest side, pixels, at which features are detected; None for full size.
        shard: (i, n) for part i of n of the pairs; the same call without it collects all parts.
        truth: Only pairs of this kind of ground truth, ``pose`` or ``homography``; None for all
            pairs.
        progress: Called with (stage, detail) and the fraction of the pairs that is done.

    Returns:
        Rows of two kinds: ``result`` (pair, operator or ``multi``, seed -> verdict, matches,
        inliers, points, errors, seconds per stage, and, with a true homography, the matching
        accuracy at 1 to 10 px; an error is None if it is infinite or there is no ground truth) and
        ``failed`` (pair, operator -> reason). Rows of the kind ``failed`` are not stored; these
        pairs run again when the run is resumed.

    Raises:
        InputError: Data, an operator, a matcher or the estimator is unknown or cannot be read,
            `seeds` is less than 1, or the rows in `out` come from other settings.
    """
    check_folder(out)
    if seeds < 1:
        raise InputError(f"seeds must be at least 1, not {seeds}")
    operators = choose_operators(operators)
    matchers = canonical_matchers(matchers)
    options = adjust_preset(preset, backend=backend, max_size=max_size)
    options = choose_options(options, operators, matchers=matchers)
    pairs = part_of(find_pairs(data, root, truth), shard)
    settings = {
        "version": __version__,
        "preset": preset,
        **plugin_settings(operators, options, matchers=matchers, backend=backend),
        "seeds": seeds,
        "max_size": max_size,
    }
    store = RowStore(Path(out) / "rows.jsonl", settings, shard)
    stored: dict[str, list[Row]] = {}
    for row in store.read():
        stored.setdefault(row["digest"], []).append(row)
    sets: list[tuple[str, tuple[str, ...]]] = [(name, (name,)) for name in operators]
    if len(operators) > 1:
        sets.append((ALL, operators))
    rows: list[Row] = []
    for done, pair in enumerate(pairs):
        if progress is not None:
            progress("pairs", str(pair), fraction=done / len(pairs))
        digest = _digest(pair)
        have = stored.get(digest, [])
        missing = [s for s in sets if s[0] not in {row["operator"] for row in have}]
        new = _evaluate(pair, missing, options, seeds) if missing else []
        new = [{"kind": RESULT, "digest": digest, **_place(pair), **row} for row in new]
        failed = [row | {"kind": FAILED} for row in new if "reason" in row]
        new = [row for row in new if "reason" not in row]
        if new:
            store.append(new)
        rows += [*have, *new, *failed]
    if progress is not None:
        progress("pairs", fraction=1.0)
    return rows


def find_pairs(
    data: Sequence[str | os.PathLike],
    root: str | os.PathLike | None = None,
    truth: Truth | None = None,
) -> list[Pair]:
    """Collect the pairs of all data sets, lists and folders in `data`, without repetitions.

    Raises:
        InputError: One of them is unknown, missing or damaged, or there are no pairs of the wanted
            kind of ground truth.
    """
    found = [pair for item in data for pair in find_source(item, root).pairs()]
    if not found:
        raise InputError("there are no pairs to run on; name data, e.g. --data pairs.json")
    if truth is not None:
        found = [pair for pair in found if (pair.R if truth == "pose" else pair.H) is not None]
        if not found:
            raise InputError(f"no pair of {', '.join(map(str, data))} has a true {truth}")
    return list({_digest(pair): pair for pair in found}.values())


def pose_error(rotation_deg: float, translation_deg: float) -> float:
    """Return the larger of both errors, degrees; infinity if one of them is unknown."""
    error = max(rotation_deg, translation_deg)
    return error if math.isfinite(rotation_deg + translation_deg) else math.inf


def _place(pair: Pair) -> Row:
    return {
        "dataset": pair.dataset,
        "sequence": pair.sequence,
        "pair": pair.name,
        "problem": pair.kind,
        "has_truth": _has_truth(pair),
    }


def _has_truth(pair: Pair) -> bool:
    if pair.kind == HOMOGRAPHY:
        return pair.H is not None or pair.check_points is not None
    return pair.R is not None


def _digest(pair: Pair) -> str:
    """Identify a pair by a digest of its names, image bytes, cameras and ground truth."""
    digest = hashlib.sha256()
    for image in (pair.image1, pair.image2):
        if isinstance(image, np.ndarray):
            digest.update(f"{image.shape}".encode() + image.tobytes())
        else:
            digest.update(image.read_bytes() if image.is_file() else b"missing")
    cameras = [
        None if c is None else [c.model, c.size_wh, c.K.tolist(), c.distortion.tolist()]
        for c in (pair.camera1, pair.camera2)
    ]
    truth = [None if a is None else a.tolist() for a in (pair.H, pair.R, pair.t, pair.check_points)]
    digest.update(json.dumps([_place(pair), cameras, truth]).encode())
    return digest.hexdigest()[:32]


def _evaluate(
    pair: Pair, sets: Sequence[tuple[str, tuple[str, ...]]], options: Options, seeds: int
) -> list[Row]:
    """Compute the rows of sets of operators: results, or the reasons of failures."""
    with collected():
        try:
            images = (read_image(pair.image1), read_image(pair.image2))
            cameras = None if pair.kind == HOMOGRAPHY else _cameras(pair, images)
        except (SfmError, OSError) as error:
            return [{"operator": name, "reason": str(error)} for name, _ in sets]
        features: dict[str, FeaturePairs] = {}
        matches: dict[str, dict[str, Matches]] = {}
        seconds: dict[str, dict[str, float]] = {}
        reasons: dict[str, str] = {}
        for operator in dict.fromkeys(o for _, members in sets for o in members):
            watch = Stopwatch()
            try:
                with watch.stage("detect"):
                    features[operator] = detect_all(
                        images, (operator,), options.detect, device=options.device
                    )
                with watch.stage("match"):
                    matches[operator] = match_all(
                        features[operator], options.match, device=options.device
                    )
            except SfmError as error:
                reasons[operator] = str(error)
            seconds[operator] = watch.seconds
        rows: list[Row] = []
        for name, members in sets:
            try:
                if failed := [reasons[o] for o in members if o in reasons]:
                    raise InputError(failed[0])
                mine = {o: features[o][o] for o in members}
                theirs = {o: matches[o][o] for o in members}
                spent = {s: sum(seconds[o][s] for o in members) for s in ("detect", "match")}
                rows += [
                    {"operator": name, "seed": seed}
                    | _estimate(pair, images, cameras, mine, theirs, options, seed, spent)
                    for seed in range(seeds)
                ]
            except SfmError as error:
                rows = [row for row in rows if row["operator"] != name]
                rows.append({"operator": name, "reason": str(error)})
        return rows


def _cameras(pair: Pair, images: tuple[Image, Image]) -> Cameras:
    return choose_cameras(images, pair.camera1, pair.camera2)


def _estimate(
    pair: Pair,
    images: tuple[Image, Image],
    cameras: Cameras | None,
    features: FeaturePairs,
    matches: dict[str, Matches],
    options: Options,
    seed: int,
    before: Mapping[str, float],
) -> Row:
    """Run the stages of :func:`sfmkit.register` or :func:`sfmkit.reconstruct` after matching."""
    watch = Stopwatch(seconds=dict(before))
    row: Row = {"points": None}
    if cameras is None:
        found = register_matches(features, matches, options=options, seed=seed, watch=watch)
        corr, inliers, verdict = found.correspondences, found.inliers, found.verdict
        H = None if found.H is None else found.H.numpy()
        row |= _homography_errors(pair, H, images[0].size_wh)
        if pair.H is not None:
            errors = _matching_errors(pair.H, features, matches, corr)
            row |= {"mma": mean_matching_accuracy(errors), "mma_matches": len(errors)}
    else:
        with watch.stage("fuse"):
            corr = within_the_field(fuse_all(features, matches, options.fuse), *cameras)
        view, adjustment = estimate_geometry(
            corr, cameras, options.estimate, seed=seed, device=options.device, watch=watch
        )
        with watch.stage("triangulate"):
            cloud = make_cloud(corr, view, images[0], options.triangulate, adjustment)
        inliers, verdict = view.inliers, view.verdict
        row |= {"points": 0 if cloud is None else len(cloud)} | _pose_errors(pair, view)
    return row | {
        "verdict": verdict.value,
        "refused": verdict is Verdict.TOO_LITTLE,
        "matches": len(corr),
        "inliers": int(inliers.sum()),
        "seconds": watch.seconds,
    }


def _matching_errors(
    H: np.ndarray, features: FeaturePairs, matches: Mapping[str, Matches], corr: Correspondences
) -> np.ndarray:
    """Return the distance (N,) of each match from its true position, pixels of image 2.

    The matches are those of the operator, or the fused ones of several.
    """
    if len(matches) == 1:
        ((name, of_operator),) = matches.items()
        return match_errors(*features[name], of_operator, H)
    return transfer_errors(corr.x1.numpy(), corr.x2.numpy(), H)


def _homography_errors(pair: Pair, H: np.ndarray | None, size_wh: tuple[int, int]) -> Row:
    """Compute the error at the check points and the corner error, as far as they are known.

    ``error`` is the check-point error if both are known.
    """
    row: Row = {"corner_error_px": None, "check_error_px": None, "error": None}
    if H is None:
        return row
    if pair.H is not None:
        row["error"] = row["corner_error_px"] = finite(corner_error(H, pair.H, size_wh))
    if pair.check_points is not None:
        row["error"] = row["check_error_px"] = finite(check_point_error(H, pair.check_points))
    return row


def _pose_errors(pair: Pair, view: TwoView) -> Row:
    """Compute the errors in degrees; only of the rotation if the camera did not move."""
    if pair.R is None or pair.t is None:
        return {"rotation_deg": None, "translation_deg": None, "error": None}
    moved = bool(np.any(pair.t))
    errors = pose_errors(view, pair.R, pair.t if moved else np.array([0.0, 0.0, 1.0]))
    rotation, translation = errors["rotation_deg"], errors["translation_deg"]
    return {
        "rotation_deg": finite(rotation),
        "translation_deg": finite(translation) if moved else None,
        "error": finite(pose_error(rotation, translation if moved else 0.0)),
    }
