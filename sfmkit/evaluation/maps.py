"""Benchmark of many views: operators alone and together, and COLMAP's SIFT, with the same mapper.

Every recipe writes a database of the same photographs for COLMAP's incremental mapper. Only the
keypoints and the two-view geometries differ.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from .._utils.progress import Progress, silent
from .._utils.writing import check_folder
from ..ablation.entry import Entry
from ..ablation.run import SweepState
from ..datasets.middlebury import temple_ring
from ..datasets.pair import data_root, image_files
from ..errors import DegenerateGeometryError, InputError
from ..features import choose_operators
from ..geometry.pose import rotation_error
from ..geometry.similarity import fit_similarity
from ..io.colmap.cameras import ColmapCamera
from ..io.colmap.engine import pycolmap_module
from ..io.truth import read_truth
from ..mapping import MatchedFolder, Workshop, match_folder, read_collection
from ..mapping.database import colmap_camera, is_calibrated
from ..mapping.map_outputs import map_matched
from ..mapping.mapper import MapOptions, poses_of, run_mapper
from ..mapping.shared_cameras import choose_shared_cameras
from ..matching import canonical_matchers, matcher_of
from ..options import Options, adjust_preset
from ..pipeline.stages import choose_options
from .rows import Row, RowStore
from .settings import plugin_settings

__all__ = ["COLMAP", "FUSED", "SCENES", "MapScene", "bench_map", "pose_errors_of"]

FUSED, COLMAP = "fused", "COLMAP's SIFT"
ROWS = "rows.jsonl"

Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class MapScene:
    """Photographs of one scene.

    Attributes:
        name: Name in tables.
        folder: Folder of the photographs.
        intrinsics: As for :func:`sfmkit.mapping.match_folder`; None for EXIF.
        truth: File name -> R (3, 3) and t (3,), ``X_camera = R X_world + t``, metres; empty if
            unknown.
    """

    name: str
    folder: Path
    intrinsics: str | None = None
    truth: Mapping[str, Pose] = field(default_factory=dict)


def fountain_scene(data: Path | None) -> MapScene:
    """Return EPFL fountain-P11: 11 photographs, cameras from laser scans."""
    home = data_root("strecha", data) / "fountain-P11"
    files = image_files(home / "images")
    cameras = [home / "gt_dense_cameras" / f"{file.name}.camera" for file in files]
    truth = {}
    for file, camera in zip(files, cameras):
        R, t = read_truth(f"{cameras[0]},{camera}")  # the world is the frame of the first camera
        truth[file.name] = (R, t)
    return MapScene("fountain-P11", home / "images", str(cameras[0]), truth)


def temple_scene(data: Path | None) -> MapScene:
    """Return the Middlebury temple ring: 16 photographs, about 24 degrees apart."""
    views = temple_ring(data)
    K = views[0].camera.K
    text = ",".join(repr(float(v)) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    truth = {view.path.name: (view.R, view.t) for view in views}
    return MapScene("temple ring", views[0].path.parent, text, truth)


def drone_scene(data: Path | None) -> MapScene:
    """Return five drone photographs with the camera from EXIF and without ground truth."""
    return MapScene("drone", data_root("uav", data) / "toledo-p3pro")


SCENES: Mapping[str, Callable[[Path | None], MapScene]] = {
    "fountain": fountain_scene,
    "temple": temple_scene,
    "drone": drone_scene,
}


def bench_map(
    out: str | os.PathLike,
    *,
    data: str | os.PathLike | None = None,
    scenes: Sequence[str] = ("fountain",),
    operators: Sequence[str] = ("surf", "orb", "fast-brief"),
    matchers: str | Mapping[str, str] | None = None,
    backend: str | None = None,
    max_size: int | None = None,
    budget: int = 8_192,
    two_view_points: bool = False,
    workers: int | None = None,
    progress: Progress = silent,
) -> list[Row]:
    """Map every scene with each operator alone, with all of them fused, and with COLMAP's SIFT.

    Run the same call again to resume: rows are kept, and detections and pairs are cached.

    Args:
        out: Folder of the rows and of the cache.
        data: Folder of the data sets; None for ``SFMKIT_DATA`` or what was fetched.
        scenes: Names in :data:`SCENES`.
        operators: Each runs alone, and all together.
        matchers: Matcher of all operators, or a mapping operator -> matcher; None for ``nearest``.
        backend: Robust estimator of the pairs; None for sfmkit's own.
        max_size: Longest side, pixels, at which features are detected, also by COLMAP's SIFT; None
            for full size.
        budget: Keypoints per operator and photograph; COLMAP's default is 8,192.
        two_view_points: Keep points that are seen in only two photographs.
        workers: Number of processes; None for one per core.
        progress: Called with (stage, detail).

    Returns:
        One row per scene and recipe.

    Raises:
        InputError: pycolmap is not installed, a scene is unknown or missing, an operator, matcher
            or estimator is unknown, or the rows in `out` come from other settings.
    """
    check_folder(out)
    pycolmap_module()
    unknown = [name for name in scenes if name not in SCENES]
    if unknown:
        raise InputError(f"unknown scene '{unknown[0]}'; the scenes are {', '.join(SCENES)}")
    home = None if data is None else Path(data)
    operators = choose_operators(operators)
    matchers = canonical_matchers(matchers)
    options = adjust_preset("default", backend=backend, budget=budget, max_size=max_size)
    complete = choose_options(options, operators, matchers=matchers)
    settings = {
        **plugin_settings(operators, complete, matchers=matchers, backend=backend),
        "max_size": max_size,
        "budget": budget,
        "two_view_points": two_view_points,
    }
    store = RowStore(Path(out) / ROWS, settings)
    rows = store.read()
    recipes: list[tuple[str, tuple[str, ...]]] = [(name, (name,)) for name in operators]
    if len(recipes) > 1:
        recipes.append((FUSED, tuple(operators)))
    mapping = MapOptions(two_view_points=two_view_points)
    for name in scenes:
        scene = SCENES[name](home)
        for recipe, chosen in [*recipes, (COLMAP, ())]:
            if any(r["scene"] == scene.name and r["recipe"] == recipe for r in rows):
                continue
            progress("map", f"{scene.name}, {recipe}")
            if chosen:
                used = {operator: matcher_of(operator, complete.match) for operator in chosen}
                row = _ours(scene, used, out, options, workers, mapping, progress)
            else:
                row = _colmap(scene, max_size, budget, mapping)
            row = {"scene": scene.name, "recipe": recipe, **row}
            store.append([row])
            rows.append(row)
    return rows


def _ours(
    scene: MapScene,
    matchers: Mapping[str, str],
    out: str | os.PathLike,
    options: Options,
    workers: int | None,
    mapping: MapOptions,
    progress: Progress,
) -> Row:
    def watch(state: SweepState) -> None:
        progress("map", f"{scene.name}, {'+'.join(matchers)}: {state.stage} {state.what}")

    matched = match_folder(
        scene.folder,
        intrinsics=scene.intrinsics,
        operators=tuple(matchers),
        matchers=matchers,
        options=options,
        pairs="all",
        workshop=Workshop.of(Path(out) / "cache", workers=workers, progress=watch),
    )
    with TemporaryDirectory() as work:
        mapped = map_matched(matched, Path(work) / "database.db", mapping)
    row = {"pairs_cpu_s": _processor_seconds(matched), "map_s": mapped.seconds["map"]}
    return row | _figures(mapped.model, scene)


def _processor_seconds(matched: MatchedFolder) -> float:
    """Return the processor time of all detections and pairs, cached ones included."""
    total = 0.0
    for photograph in matched.plan.used.tolist():
        for operator in matched.plan.recipe.operators:
            task = matched.plan.detection(photograph, operator)
            entry = matched.cache.get("features", task.key)
            total += 0.0 if entry is None else entry.meta["seconds"]
    for row in range(len(matched)):
        result = matched.geometry(row)
        total += sum(result.meta["seconds"].values()) if isinstance(result, Entry) else 0.0
    return total


def _colmap(scene: MapScene, max_size: int | None, budget: int, options: MapOptions) -> Row:
    """Run COLMAP's SIFT and matching with the camera of sfmkit, then the same mapper."""
    pycolmap = pycolmap_module()
    collection = read_collection(scene.folder)
    cameras = choose_shared_cameras(collection, scene.intrinsics)
    if len(cameras.cameras) > 1:
        raise InputError(f"{scene.folder} has several cameras; one is expected")
    camera: ColmapCamera = colmap_camera(cameras.cameras[0])
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = camera.model
    reader.camera_params = ",".join(map(str, camera.params))
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = max_size or -1
    extraction.sift.max_num_features = budget
    with TemporaryDirectory() as work:
        database = Path(work) / "database.db"
        began = time.process_time()
        pycolmap.extract_features(
            database,
            collection.folder,
            image_names=collection.names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
        seconds = time.process_time() - began
        began = time.perf_counter()
        fixed = (1,) if is_calibrated(cameras.cameras[0]) else ()
        (Path(work) / "models").mkdir()
        model = run_mapper(
            database, collection.folder, Path(work) / "models", options, fixed_cameras=fixed
        )
        row = {"pairs_cpu_s": seconds, "map_s": time.perf_counter() - began}
    return row | _figures(model, scene)


def _figures(model: Any, scene: MapScene) -> Row:
    """Return the size and the accuracy of a model."""
    row: Row = {"registered": 0, "photographs": len(image_files(scene.folder))}
    if model is None:
        return row
    row |= {
        "registered": model.num_reg_images(),
        "points": model.num_points3D(),
        "observations": model.compute_num_observations(),
        "track_length": model.compute_mean_track_length(),
        "error_px": model.compute_mean_reprojection_error(),
    }
    if scene.truth:
        row |= pose_errors_of(poses_of(model), scene.truth)
    return row


def pose_errors_of(poses: Mapping[str, Pose], truth: Mapping[str, Pose]) -> Row:
    """Compute errors of positions and rotations after the alignment of the positions.

    The similarity of the alignment is fitted to the positions only. If the cameras are nearly on a
    line, the positions determine the rotation about it badly, and all cameras share its error.
    Therefore the errors are also stated after the best common rotation is removed, which minimises
    the sum of squared differences of the rotation matrices.

    Args:
        poses, truth: Name -> R and t, ``X_camera = R X_world + t``.

    Returns:
        ``position_mm``, ``position_worst_mm``, ``rotation_deg``, ``rotation_worst_deg``: median
        and largest error; ``rotation_common_deg``, the angle of the common rotation, and
        ``rotation_rest_deg``, the median without it. Empty where fewer than three photographs are
        known to both.
    """
    names = [name for name in poses if name in truth]
    stack = {
        which: [
            torch.from_numpy(np.stack([np.asarray(found[name][k], float) for name in names]))
            for k in (0, 1)
        ]
        for which, found in (("found", poses), ("true", truth))
        if names
    }
    if len(names) < 3:
        return {}
    (R, t), (R0, t0) = stack["found"], stack["true"]
    centres, true_centres = (-(r.mT @ x[..., None])[..., 0] for r, x in ((R, t), (R0, t0)))
    try:
        similarity = fit_similarity(centres, true_centres)
    except DegenerateGeometryError:  # cameras on a line
        return {}
    away = (similarity.apply(centres) - true_centres).norm(dim=1) * 1000
    aligned = R @ similarity.R.mT
    angle = rotation_error(aligned, R0)
    U, _, Vh = torch.linalg.svd((aligned.mT @ R0).sum(0))
    sign = torch.linalg.det(U @ Vh).sign()
    common = U @ torch.diag(torch.stack([sign.new_ones(()), sign.new_ones(()), sign])) @ Vh
    eye = torch.eye(3, dtype=common.dtype)
    return {
        "position_mm": float(away.median()),
        "position_worst_mm": float(away.max()),
        "rotation_deg": float(angle.median()),
        "rotation_worst_deg": float(angle.max()),
        "rotation_common_deg": float(rotation_error(common, eye)),
        "rotation_rest_deg": float(rotation_error(aligned @ common, R0).median()),
    }
