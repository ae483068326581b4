"""Fountain benchmark: number of features after each stage, and accuracy of pose and cloud.

The data are neighbouring photographs of EPFL's fountain-P11 with true cameras, and rendered scenes
with known depth. Each operator is detected and matched once per pair and preset. The geometry is
estimated for each operator alone and for all together, with every seed.

The column "initial" of the paper's Table 6 is interpreted as the matches from which the geometry is
estimated. The paper defines it as "detected features" in one place and writes "from matching to the
final point cloud" in another; only the second definition agrees with its numbers.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .._utils.progress import Progress
from .._utils.writing import check_folder
from .._version import __version__
from ..datasets.pair import Pair
from ..datasets.strecha import strecha
from ..datasets.synthetic import SyntheticPair, render
from ..errors import InputError
from ..features import choose_operators
from ..geometry.fundamental import fundamental_from_pose, signed_sampson_distance
from ..io.images import Image, read_image
from ..matching import canonical_matchers, fuse
from ..options import PRESETS, Options, adjust_preset
from ..pipeline.account import ALL, make_account
from ..pipeline.stages import (
    OPERATORS_OF_THE_PAPER,
    FeaturePairs,
    Stopwatch,
    choose_options,
    detect_all,
    estimate_geometry,
    make_cloud,
    match_all,
    pose_errors,
)
from ..types import Camera, Correspondences, Matches, PointCloud, TwoView
from .rows import Row, RowStore, finite
from .settings import plugin_settings

SEQUENCE = "fountain-P11"
# A match with a smaller Sampson distance to the true epipolar geometry counts as correct, pixels.
RIGHT_PX = 1.0
SCENES = ("courtyard", "wide", "dish")
SCENE_SIZE = (1024, 768)
CLOSE = 0.01  # distance to the true surface over depth below which a point counts as correct


def bench_fountain(
    out: str | os.PathLike,
    *,
    data: str | os.PathLike | None = None,
    pairs: Iterable[str] | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    matchers: str | Mapping[str, str] | None = None,
    backend: str | None = None,
    presets: Sequence[str] = tuple(PRESETS),
    seeds: int = 3,
    max_size: int | None = None,
    scenes: Sequence[str] = SCENES,
    scene_size: tuple[int, int] = SCENE_SIZE,
    progress: Progress | None = None,
) -> list[Row]:
    """Run the missing parts of the benchmark and return all of its rows.

    Args:
        out: Folder for ``rows.jsonl`` and the pictures of the first pair's clouds.
        data: Folder of the data sets, see :func:`sfmkit.datasets.strecha.strecha`.
        pairs: Names such as ``0000-0001``; None for all pairs of neighbours.
        operators: At least one; each runs alone, and all together as ``multi``.
        matchers: Matcher of all operators, or a mapping operator -> matcher; None for those of
            the presets.
        backend: Robust estimator; None for those of the presets.
        presets: Names of :data:`sfmkit.options.PRESETS`.
        seeds: Every estimate is repeated with seeds 0 ... seeds - 1.
        max_size: Longest side, pixels, at which the photographs are searched; None for full size.
        scenes: Names of rendered scenes.
        scene_size: Width and height of the rendered scenes, pixels.
        progress: Called with (stage, detail) and the fraction of the work that is done.

    Returns:
        Rows of two kinds: ``cloud`` (pair, preset, operator or ``multi``, merged, seed ->
        keypoints, matches, initial, points, loss, precision, kept, rotation_deg, translation_deg,
        seconds) and ``scene`` (scene, preset, seed -> points, median_error, p90_error (shares of
        the depth), close).

    Raises:
        InputError: The data are missing, a pair, operator, matcher, estimator or preset is
            unknown, the estimator cannot estimate the model of a preset, `seeds` is less than 1,
            or the rows in `out` come from other settings.
    """
    check_folder(out)
    operators = choose_operators(operators)
    if seeds < 1:
        raise InputError(f"seeds must be at least 1, not {seeds}")
    matchers = canonical_matchers(matchers)
    recipes = {
        name: choose_options(adjust_preset(name, backend=backend), operators, matchers=matchers)
        for name in presets
    }
    if not recipes:
        raise InputError(f"name at least one preset: {', '.join(PRESETS)}")
    chosen = choose_pairs(list(strecha(data, [SEQUENCE])), pairs)
    settings = {
        "version": __version__,
        **plugin_settings(
            operators, next(iter(recipes.values())), matchers=matchers, backend=backend
        ),
        "seeds": seeds,
        "max_size": max_size,
        "scene_size": list(scene_size),
    }
    store = RowStore(Path(out) / "rows.jsonl", settings)
    rows = store.read()
    have = {(r["kind"], r.get("pair", r.get("scene")), r["preset"]) for r in rows}
    parts: list[tuple[str, Pair | str, str]] = [
        ("cloud", pair, preset) for pair in chosen for preset in presets
    ]
    parts += [("scene", scene, preset) for scene in scenes for preset in presets]
    for done, (kind, what, preset) in enumerate(parts):
        label = what.name if isinstance(what, Pair) else what
        picture = Path(out) / cloud_picture(preset) if what is chosen[0] else None
        if progress is not None:
            progress("fountain", f"{label}, {preset}", fraction=done / len(parts))
        if (kind, label, preset) in have and (picture is None or picture.exists()):
            continue
        options = recipes[preset]
        if isinstance(what, Pair):
            reduced = replace(options, detect=replace(options.detect, max_size=max_size))
            new = _pair_rows(what, operators, reduced, seeds, picture)
        else:
            new = _scene_rows(what, operators, options, seeds, scene_size)
        if (kind, label, preset) not in have:
            store.append(new)
            rows += new
    if progress is not None:
        progress("fountain", fraction=1.0)
    wanted = {("cloud", p.name) for p in chosen} | {("scene", s) for s in scenes}
    return [
        r
        for r in rows
        if (r["kind"], r.get("pair", r.get("scene"))) in wanted and r["preset"] in presets
    ]


def choose_pairs(there: list[Pair], names: Iterable[str] | None) -> list[Pair]:
    """Return the pairs with these names, in the order of the data set.

    Raises:
        InputError: There is no pair with one of the names, or no name is given.
    """
    if names is None:
        return there
    names = tuple(dict.fromkeys(names))
    known = [pair.name for pair in there]
    for name in names:
        if name not in known:
            raise InputError(
                f"there is no pair '{name}' of neighbours; there are {', '.join(known)}"
            )
    if not names:
        raise InputError("name at least one pair")
    return [pair for pair in there if pair.name in names]


def cloud_picture(preset: str) -> str:
    """Return the file name of the picture of the first pair's clouds."""
    return f"clouds-{preset}.png"


def true_fundamental(pair: Pair) -> Tensor:
    """Return the (3, 3) fundamental matrix of a pair's true cameras, for pixels."""
    assert pair.R is not None
    assert pair.t is not None
    assert pair.camera1 is not None
    assert pair.camera2 is not None
    R, t = (torch.tensor(np.array(a)) for a in (pair.R, pair.t))
    return fundamental_from_pose(
        R, t / t.norm(), pair.camera1.tensors()[0], pair.camera2.tensors()[0]
    )


def right_matches(F_true: Tensor, corr: Correspondences) -> Tensor:
    """Return (N,) bool: Sampson distance to the true epipolar geometry below 1 px."""
    return signed_sampson_distance(F_true, corr.x1, corr.x2).abs() < RIGHT_PX


def estimate_cloud(
    corr: Correspondences,
    cameras: tuple[Camera, Camera],
    image1: Image,
    options: Options,
    seed: int,
) -> tuple[TwoView, PointCloud | None]:
    """Run the stages after fusion in the order of :mod:`sfmkit.pipeline.reconstruction`."""
    view, adjustment = estimate_geometry(corr, cameras, options.estimate, seed=seed)
    return view, make_cloud(corr, view, image1, options.triangulate, adjustment)


def _pair_rows(
    pair: Pair, operators: Sequence[str], options: Options, seeds: int, picture: Path | None
) -> list[Row]:
    began = time.perf_counter()
    images = (read_image(pair.image1), read_image(pair.image2))
    watch = Stopwatch()
    features = detect_all(images, operators, options.detect, watch)
    matches = match_all(features, options.match, watch)
    before = time.perf_counter() - began
    F_true = true_fundamental(pair)
    assert pair.camera1 is not None
    assert pair.camera2 is not None
    rows, clouds = [], {}
    for name, members, radius in _sets(operators, options):
        corr = _fused(features, matches, members, radius)
        right = right_matches(F_true, corr)
        for seed in range(seeds):
            began = time.perf_counter()
            view, cloud = estimate_cloud(
                corr, (pair.camera1, pair.camera2), images[0], options, seed
            )
            seconds = before + time.perf_counter() - began
            account = make_account(corr, view.inliers, cloud)
            line = account[ALL]
            in_cloud = 0 if cloud is None else int(right[cloud.match].sum())
            rows.append(
                {
                    "kind": "cloud",
                    "pair": pair.name,
                    "preset": options.name,
                    "operator": name,
                    "merged": radius is not None,
                    "seed": seed,
                    "keypoints": list(line.keypoints),
                    "matches": line.matches,
                    "initial": line.initial,
                    "points": line.points,
                    "loss": line.loss,
                    "precision": in_cloud / line.points if line.points else None,
                    "kept": in_cloud / int(right.sum()) if bool(right.any()) else None,
                    "members": {o: [account[o].initial, account[o].points] for o in members},
                    **_finite(pose_errors(view, pair.R, pair.t)),  # type: ignore[arg-type]
                    "seconds": seconds if name == ALL or len(operators) == 1 else None,
                }
            )
            if (
                seed == 0
                and cloud is not None
                and (radius is not None or options.fuse.merge_radius is None)
            ):
                clouds[name] = cloud
    if picture is not None:
        from .fountain_figures import draw_clouds

        draw_clouds(picture, clouds, pair.camera1)
    return rows


def _sets(
    operators: Sequence[str], options: Options
) -> list[tuple[str, tuple[str, ...], float | None]]:
    """List the estimates as (name, operators, merge radius).

    These are each operator alone, all together, and all without merging, as in the paper.
    """
    radius = options.fuse.merge_radius
    sets: list[tuple[str, tuple[str, ...], float | None]] = [
        (name, (name,), radius) for name in operators
    ]
    if len(operators) > 1:
        sets.append((ALL, tuple(operators), radius))
        if radius is not None:
            sets.append((ALL, tuple(operators), None))
    return sets


def _fused(
    features: FeaturePairs,
    matches: dict[str, Matches],
    members: Sequence[str],
    radius: float | None,
) -> Correspondences:
    return fuse({name: (*features[name], matches[name]) for name in members}, merge_radius=radius)


def _scene_rows(
    scene: str, operators: Sequence[str], options: Options, seeds: int, size: tuple[int, int]
) -> list[Row]:
    """Measure the distances of clouds to the surfaces of a rendered scene.

    The clouds are scaled by the true length of the baseline.
    """
    made = _rendered(scene, size)
    images = (read_image(made.image1), read_image(made.image2))
    features = detect_all(images, operators, options.detect)
    corr = _fused(
        features, match_all(features, options.match), operators, options.fuse.merge_radius
    )
    rows = []
    for seed in range(seeds):
        view, cloud = estimate_cloud(corr, (made.camera1, made.camera2), images[0], options, seed)
        row: Row = {
            "kind": "scene",
            "scene": scene,
            "preset": options.name,
            "seed": seed,
            "initial": len(corr),
        }
        row |= {"points": 0, "median_error": None, "p90_error": None, "close": None}
        if cloud is not None and len(cloud):
            x1 = corr.x1[cloud.match].numpy()
            error = surface_error(
                cloud.xyz.numpy() * np.linalg.norm(made.t), x1, made.depth_at(1, x1), made.camera1
            )
            median, p90 = np.quantile(error, (0.5, 0.9))
            row |= {
                "points": len(cloud),
                "median_error": float(median),
                "p90_error": finite(float(p90)),
                "close": float((error < CLOSE).mean()),
            }
        rows.append(row | _finite(pose_errors(view, made.R, made.t)))
    return rows


@lru_cache(maxsize=1)
def _rendered(scene: str, size: tuple[int, int]) -> SyntheticPair:
    """Render a scene; all presets use the same images."""
    return render(scene, size_wh=size)


def surface_error(X: np.ndarray, x1: np.ndarray, depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Compute the relative distances of points to the true surface.

    Args:
        X: (N, 3) points in the frame of the camera.
        x1: (N, 2) pixels of the points.
        depth: (N,) true depths at these pixels, inf for sky.
        camera: The camera.

    Returns:
        (N,) distance between the point and the true point of its pixel, over the true depth; inf
        for sky.
    """
    rays = np.column_stack([x1, np.ones(len(x1))]) @ np.linalg.inv(camera.K).T
    sky = ~np.isfinite(depth)
    truth = np.where(sky, 1.0, depth)[:, None] * rays
    return np.where(sky, np.inf, np.linalg.norm(X - truth, axis=1) / np.where(sky, 1.0, depth))


def _finite(errors: dict[str, float]) -> dict[str, float | None]:
    return {name: finite(value) for name, value in errors.items()}
