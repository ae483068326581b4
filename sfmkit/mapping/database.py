"""COLMAP databases of matched folders.

pycolmap writes the tables of COLMAP. Two additional tables contain the provenance of every
keypoint; docs/folders.md describes them.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from .._utils.writing import atomic_write
from ..ablation.entry import Entry
from ..errors import InputError, OutputError
from ..io.colmap.cameras import ColmapCamera, to_colmap
from ..io.colmap.engine import pycolmap_module
from ..types import Camera, Verdict
from .keypoint_lists import KeypointList, RowMatches, match_rows
from .matched_folder import MatchedFolder

__all__ = ["colmap_camera", "read_provenance", "write_database"]

_CONFIGURATIONS = {
    Verdict.GENERAL: "CALIBRATED",
    Verdict.PLANAR: "PLANAR",
    Verdict.PURE_ROTATION: "PANORAMIC",
    Verdict.AMBIGUOUS: "DEGENERATE",
    Verdict.TOO_LITTLE: "DEGENERATE",
}
_SCHEMA = """
CREATE TABLE sfmkit_operators (operator_id INTEGER PRIMARY KEY NOT NULL, name TEXT NOT NULL);
CREATE TABLE sfmkit_keypoints (
    image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    keypoint BLOB NOT NULL, operator_id BLOB NOT NULL, original_index BLOB NOT NULL,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
"""


def colmap_camera(camera: Camera) -> ColmapCamera:
    """Convert a camera for a COLMAP database.

    Given intrinsics keep their model. Intrinsics from EXIF become SIMPLE_RADIAL with k1 = 0: EXIF
    contains no distortion, but real lenses have some, and bundle adjustment can then refine it.

    Raises:
        InputError: COLMAP does not support the camera.
    """
    found = ColmapCamera.of(camera)
    if is_calibrated(camera) or found.model != "PINHOLE":
        return found
    f = (camera.K[0, 0] + camera.K[1, 1]) / 2
    cx, cy = to_colmap(camera.K[:2, 2])
    return ColmapCamera("SIMPLE_RADIAL", camera.size_wh, (float(f), float(cx), float(cy), 0.0))


def is_calibrated(camera: Camera) -> bool:
    """Return whether the intrinsics were given; the mapper does not refine them."""
    return not camera.source.startswith(("exif", "guessed"))


def write_database(
    matched: MatchedFolder, lists: Mapping[int, KeypointList], path: Path
) -> dict[str, int]:
    """Write a COLMAP database, whole or not at all; an existing file is replaced.

    Images have the ids 1, 2, ... in the order of their names. The database contains cameras, rigs
    and frames of one image each, keypoints without descriptors, the matches of all pairs, the
    two-view geometries with the inliers, and the GPS positions of EXIF as pose priors. Pairs
    without a trustworthy geometry have no inliers.

    Args:
        matched: The matched pairs.
        lists: Keypoints of every photograph that occurs in a pair.
        path: Path of the file.

    Returns:
        Name -> image id.

    Raises:
        InputError: pycolmap is not installed, or COLMAP does not support a camera.
        OutputError: The file cannot be written.
    """
    pycolmap = pycolmap_module()
    cameras = [colmap_camera(camera) for camera in matched.plan.cameras.cameras]
    with atomic_write(path) as temporary:
        temporary.unlink()
        try:
            with pycolmap.Database.open(temporary) as db, pycolmap.DatabaseTransaction(db):
                ids = _write_images(db, pycolmap, matched, cameras, lists)
                _write_pairs(db, pycolmap, matched, lists)
            _write_provenance(temporary, matched, lists)
        except (RuntimeError, sqlite3.Error) as error:
            raise OutputError(f"{path} cannot be written: {error}") from error
    return ids


def _write_images(
    db: Any,
    pycolmap: Any,
    matched: MatchedFolder,
    cameras: list[ColmapCamera],
    lists: Mapping[int, KeypointList],
) -> dict[str, int]:
    camera_type = pycolmap.SensorType.CAMERA
    for number, camera in enumerate(cameras, start=1):
        source = matched.plan.cameras.cameras[number - 1].source
        entry = pycolmap.Camera(
            camera_id=number,
            model=camera.model,
            width=camera.size_wh[0],
            height=camera.size_wh[1],
            params=camera.params,
            has_prior_focal_length=not source.startswith("guessed"),
        )
        db.write_camera(entry, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=number)
        rig.add_ref_sensor(pycolmap.sensor_t(camera_type, number))
        db.write_rig(rig, use_rig_id=True)
    ids = {}
    for index, photograph in enumerate(matched.plan.collection.photographs):
        number = index + 1
        camera_id = matched.plan.cameras.of_photograph[index] + 1
        image = pycolmap.Image(name=photograph.name, camera_id=camera_id, image_id=number)
        db.write_image(image, use_image_id=True)
        frame = pycolmap.Frame(frame_id=number, rig_id=camera_id)
        data = pycolmap.data_t(pycolmap.sensor_t(camera_type, camera_id), number)
        frame.add_data_id(data)
        db.write_frame(frame, use_frame_id=True)
        exif = photograph.header.exif
        if exif is not None and exif.position is not None:
            *place, altitude = exif.position
            prior = pycolmap.PosePrior(
                pose_prior_id=number,
                corr_data_id=data,
                position=[*place, 0.0 if math.isnan(altitude) else altitude],
                coordinate_system=pycolmap.PosePriorCoordinateSystem.WGS84,
            )
            db.write_pose_prior(prior, use_pose_prior_id=True)
        if index in lists:
            db.write_keypoints(number, to_colmap(lists[index].xy).astype(np.float32))
        ids[photograph.name] = number
    return ids


def _write_pairs(
    db: Any, pycolmap: Any, matched: MatchedFolder, lists: Mapping[int, KeypointList]
) -> None:
    for row, (i, j) in enumerate(matched.plan.pairs.tolist()):
        entry = matched.geometry(row)
        if not isinstance(entry, Entry):
            continue
        found = match_rows(entry, lists[i], lists[j])
        if not len(found.rows):
            continue
        db.write_matches(i + 1, j + 1, found.rows.astype(np.uint32))
        db.write_two_view_geometry(i + 1, j + 1, _two_view_geometry(pycolmap, entry, found))


def _two_view_geometry(pycolmap: Any, entry: Entry, found: RowMatches) -> Any:
    """Make the two-view geometry, with matrices for pixels in the convention of COLMAP."""
    meta = entry.meta
    verdict = Verdict(meta["verdict"])
    trusted = verdict not in (Verdict.TOO_LITTLE, Verdict.AMBIGUOUS)
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = getattr(pycolmap.TwoViewGeometryConfiguration, _CONFIGURATIONS[verdict])
    inlier = found.inlier if trusted else np.zeros(len(found.rows), bool)
    geometry.inlier_matches = found.rows[inlier].astype(np.uint32)
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    back = np.linalg.inv(shift)
    E, F, H = (_matrix(meta[name]) for name in "EFH")
    if E is not None:
        geometry.E = E
    if F is not None:
        geometry.F = back.T @ F @ back
    if H is not None:
        geometry.H = shift @ H @ back
    R = _matrix(meta["R"])
    if R is not None:
        t = np.zeros(3) if meta["t"] is None else np.array(meta["t"])
        geometry.cam2_from_cam1 = pycolmap.Rigid3d(pycolmap.Rotation3d(R), t)
    return geometry


def _matrix(flat: list[float] | None) -> np.ndarray | None:
    return None if flat is None else np.array(flat).reshape(3, 3)


def _write_provenance(
    path: Path, matched: MatchedFolder, lists: Mapping[int, KeypointList]
) -> None:
    with closing(sqlite3.connect(path)) as db, db:
        db.executescript(_SCHEMA)
        operators = matched.plan.recipe.operators
        db.executemany("INSERT INTO sfmkit_operators VALUES (?, ?)", enumerate(operators))
        for index, found in lists.items():
            arrays = (found.row, found.operator, found.index)
            blobs = [a.astype("<i4").tobytes() for a in arrays]
            db.execute(
                "INSERT INTO sfmkit_keypoints VALUES (?, ?, ?, ?, ?)",
                (index + 1, len(found.row), *blobs),
            )


def read_provenance(
    path: Path,
) -> tuple[tuple[str, ...], dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Read the provenance of the keypoints of a database.

    Returns:
        The operators, and image id -> (M,) rows of the keypoints, (M,) numbers of the operators and
        (M,) rows in the features of the operators.

    Raises:
        InputError: The file is not a database of :func:`write_database`.
    """
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
            query = "SELECT name FROM sfmkit_operators ORDER BY operator_id"
            names = tuple(name for (name,) in db.execute(query))
            query = "SELECT image_id, keypoint, operator_id, original_index FROM sfmkit_keypoints"
            found = {
                image_id: tuple(np.frombuffer(blob, "<i4") for blob in blobs)
                for image_id, *blobs in db.execute(query)
            }
    except (sqlite3.Error, ValueError) as error:
        raise InputError(f"{path} has no provenance of sfmkit: {error}") from None
    return names, found  # type: ignore[return-value]
