"""Models of matched folders: cameras and points, and their files."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import PIL.Image

from .._utils.writing import staged_folder
from ..ablation.memory import PeakMemory
from ..io.colmap.cameras import ColmapCamera
from ..io.images import read_image
from ..io.ply import write_ply
from ..recording.log_map import MapView, save_map_recording
from ..types import Camera, PointCloud
from ..viz.figures import save
from ..viz.map_picture import map_picture
from .database import colmap_camera, is_calibrated, write_database
from .keypoint_lists import KeypointList, list_all_keypoints
from .map_page import write_map_page
from .mapped_points import MappedPoints, cloud_of, colour_points, map_points, track_statistics
from .mapper import MapOptions, poses_of, run_mapper
from .matched_folder import MatchedFolder
from .pair_outputs import write_pair_files
from .planning import FolderPlan
from .transforms import make_transforms

__all__ = ["DATABASE", "Mapped", "check_cameras", "map_matched", "write_map"]

DATABASE = "database.db"
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Mapped:
    """A model of a matched folder.

    Attributes:
        matched: The matched pairs.
        options: Options of the mapper.
        model: ``pycolmap.Reconstruction``; None if the mapper found no model.
        lists: Keypoints of the database.
        points: Points with their operators.
        seconds: Duration of each step.
    """

    matched: MatchedFolder
    options: MapOptions
    model: Any
    lists: Mapping[int, KeypointList]
    points: MappedPoints | None
    seconds: Mapping[str, float]

    @property
    def views(self) -> list[MapView]:
        """The registered photographs, in the order of the folder."""
        if self.model is None:
            return []
        poses = poses_of(self.model)
        camera_of = {image.name: image.camera_id for image in self.model.images.values()}
        return [
            MapView(name, refined_camera(self.model.cameras[camera_of[name]]), *poses[name])
            for name in self.matched.plan.collection.names
            if name in poses
        ]


def refined_camera(camera: Any) -> Camera:
    """Convert a ``pycolmap.Camera`` to a camera of sfmkit."""
    size = (camera.width, camera.height)
    return ColmapCamera(camera.model_name, size, tuple(map(float, camera.params))).camera()


def check_cameras(plan: FolderPlan) -> None:
    """Raise InputError if COLMAP does not support a camera."""
    for camera in plan.cameras.cameras:
        colmap_camera(camera)


def map_matched(
    matched: MatchedFolder,
    database: Path,
    options: MapOptions | None = None,
    say: Say = lambda text: None,
) -> Mapped:
    """Write the database of a matched folder and map its photographs.

    Given intrinsics are fixed; intrinsics from EXIF or a guess are refined.

    Args:
        matched: The matched pairs.
        database: Path of the database to write.
        options: Options of the mapper.
        say: Called with the name of every step before it starts.

    Raises:
        InputError: pycolmap is not installed, or COLMAP does not support a camera.
        OutputError: The database cannot be written.
    """
    options = options or MapOptions()
    seconds = {}
    say("keypoint lists")
    began = time.perf_counter()
    lists = list_all_keypoints(matched)
    write_database(matched, lists, database)
    seconds["database"] = time.perf_counter() - began
    say(f"{options.mapper} mapping by COLMAP")
    began = time.perf_counter()
    plan = matched.plan
    fixed = tuple(k for k, c in enumerate(plan.cameras.cameras, start=1) if is_calibrated(c))
    with TemporaryDirectory() as work:
        folder = plan.collection.folder
        model = run_mapper(database, folder, Path(work), options, fixed_cameras=fixed)
    seconds["map"] = time.perf_counter() - began
    points = None
    if model is not None:
        points = map_points(model, lists, len(plan.recipe.operators))
    return Mapped(matched, options, model, lists, points, seconds)


def write_map(
    matched: MatchedFolder,
    out: Path,
    options: MapOptions | None = None,
    *,
    overwrite: bool = False,
    seconds: Mapping[str, float] | None = None,
    command: str = "",
    say: Say = lambda text: None,
) -> dict[str, Any]:
    """Map a matched folder and write all files, whole or not at all; see docs/folders.md.

    Args:
        matched: The matched pairs.
        out: Folder to write.
        options: Options of the mapper.
        overwrite: Whether to replace an existing folder.
        seconds: Durations of earlier steps.
        command: Command line, shown on the page.
        say: Called with the name of every step before it starts.

    Returns:
        The content of ``report.json``.

    Raises:
        InputError: pycolmap is not installed, or COLMAP does not support a camera.
        OutputError: The folder exists and `overwrite` is not set, or cannot be written.
    """
    with staged_folder(out, overwrite) as staged:
        with PeakMemory() as memory:
            mapped = map_matched(matched, staged / DATABASE, options, say)
        say("writing")
        pairs = write_pair_files(matched, staged)
        report = _report(mapped, pairs, dict(seconds or {}), memory.mb)
        if mapped.model is not None and mapped.points is not None:
            _write_model(mapped, staged, out)
        (staged / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        write_map_page(report, staged, command)
    return report


def _write_model(mapped: Mapped, staged: Path, out: Path) -> None:
    plan, points = mapped.matched.plan, mapped.points
    assert points is not None
    for name, write in (("sparse/0", "write_binary"), ("sparse-text/0", "write_text")):
        (staged / name).mkdir(parents=True)
        getattr(mapped.model, write)(staged / name)
    rgb = colour_points(points, plan.collection, mapped.lists)
    cloud = cloud_of(points, rgb, plan.recipe.operators)
    write_ply(staged / "cloud.ply", cloud)
    views = mapped.views
    paths = {p.name: p.path for p in plan.collection.photographs}
    files = _upright_files(mapped, staged, out)
    transforms = make_transforms(views, files, out.absolute(), "cloud.ply")
    (staged / "transforms.json").write_text(json.dumps(transforms, indent=1), encoding="utf-8")
    _save_picture(cloud, views, staged / "model.png")
    photographs = (read_image(paths[view.name]) for view in views)
    save_map_recording(staged / "recording.rrd", cloud, views, photographs, points.lengths)


def _upright_files(mapped: Mapped, staged: Path, out: Path) -> dict[str, Path]:
    """Map names to files; photographs that are not stored upright are copied upright."""
    files = {}
    for photograph in mapped.matched.plan.collection.photographs:
        files[photograph.name] = photograph.path
        if photograph.header.orientation != 1:
            copy = Path("upright") / f"{photograph.name}.png"
            (staged / copy).parent.mkdir(parents=True, exist_ok=True)
            PIL.Image.fromarray(read_image(photograph.path).rgb).save(staged / copy)
            files[photograph.name] = out.absolute() / copy
    return files


def _save_picture(cloud: PointCloud, views: list[MapView], path: Path) -> None:
    first = views[len(views) // 2]
    centres = np.array([view.centre for view in views])
    save(map_picture(cloud, centres, first.R, first.t), path)


def _report(
    mapped: Mapped, pairs: dict[str, Any], seconds: dict[str, float], peak_mb: float
) -> dict[str, Any]:
    plan = mapped.matched.plan
    report: dict[str, Any] = {
        "schema_version": 1,
        "mapper": asdict(mapped.options),
        "model": None,
        "operators": {},
        "photographs": [],
        "seconds": {k: round(v, 3) for k, v in (seconds | dict(mapped.seconds)).items()},
        "peak_memory_mb": round(peak_mb),  # of the mapping; workers are not included
        "pairs": pairs,
    }
    turned = [p.name for p in plan.collection.photographs if p.header.orientation != 1]
    if turned:
        report["upright_copies"] = turned
    model, points = mapped.model, mapped.points
    if model is None or points is None:
        return report
    lengths = points.lengths
    observed = np.bincount(points.image, minlength=len(plan.collection))
    views = {view.name: view for view in mapped.views}
    report["model"] = {
        "registered": len(views),
        "photographs": len(plan.collection),
        "points": len(points),
        "observations": len(points.point),
        "track_length": float(lengths.mean()) if len(points) else None,
        "reprojection_error_px": float(points.error.mean()) if len(points) else None,
    }
    report["operators"] = {
        name: line.as_dict()
        for name, line in track_statistics(points, plan.recipe.operators).items()
    }
    for index, name in enumerate(plan.collection.names):
        view = views.get(name)
        report["photographs"].append(
            {
                "name": name,
                "registered": view is not None,
                "observations": int(observed[index]),
                "keypoints": len(mapped.lists[index].xy) if index in mapped.lists else 0,
                "centre": None if view is None else view.centre.tolist(),
                "R": None if view is None else view.R.tolist(),
                "t": None if view is None else view.t.tolist(),
                "K": None if view is None else view.camera.K.tolist(),
                "distortion": None if view is None else view.camera.distortion.tolist(),
            }
        )
    return report
