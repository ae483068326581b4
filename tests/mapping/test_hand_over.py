"""What COLMAP and hloc read of a matched folder, and the provenance that can be recovered."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import numpy as np
import plyfile
import pytest
from click.testing import CliRunner
from photograph_folder import fountain, match_small

from sfmkit.cli import main
from sfmkit.errors import InputError
from sfmkit.geometry.similarity import fit_similarity
from sfmkit.io.colmap import read_colmap
from sfmkit.io.ply import read_ply
from sfmkit.io.truth import read_truth
from sfmkit.mapping.database import read_provenance, write_database
from sfmkit.mapping.keypoint_lists import list_all_keypoints, match_rows
from sfmkit.mapping.mapped_points import map_points, track_statistics
from sfmkit.recording import read_recording

pycolmap = pytest.importorskip("pycolmap")
pytestmark = [pytest.mark.peers, pytest.mark.slow]


@pytest.fixture(scope="module")
def matched(data_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("hand-over")
    intrinsics = str(data_dir / "strecha/fountain-P11/images/K.txt")
    return match_small(fountain(data_dir, folder / "p"), folder / "cache", intrinsics)


@pytest.fixture(scope="module")
def lists(matched):
    return list_all_keypoints(matched)


@pytest.fixture(scope="module")
def database(matched, lists, tmp_path_factory):
    path = tmp_path_factory.mktemp("database") / "database.db"
    assert write_database(matched, lists, path) == {
        name: k for k, name in enumerate(matched.plan.collection.names, start=1)
    }
    return path


@pytest.fixture(scope="module")
def model(database, matched, tmp_path_factory):
    """COLMAP's mapper on the database, called as a program without sfmkit would call it."""
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size, options.ba_refine_focal_length = 3, False
    options.random_seed, options.num_threads = 0, 1
    options.ba_refine_extra_params = False
    options.mapper.init_min_tri_angle = 4.0
    work = tmp_path_factory.mktemp("model")
    images = matched.plan.collection.folder
    return pycolmap.incremental_mapping(database, images, work, options)[0]


def test_keypoints_are_those_of_the_operators_half_a_pixel_further(matched, lists, database):
    operators, provenance = read_provenance(database)
    assert operators == matched.plan.recipe.operators
    with pycolmap.Database.open(database) as db:
        for index in range(4):
            xy = db.read_keypoints(index + 1)[:, :2] - 0.5
            rows, operator, original = provenance[index + 1]
            features = [matched.features(index, name).keypoints for name in operators]
            found = np.concatenate(features)
            assert len(rows) == len(found)  # every keypoint of every operator has a row
            own = np.array([features[o][k] for o, k in zip(operator, original)])
            assert np.array_equal(own, found)
            away = np.linalg.norm(xy[rows] - own, axis=1)
            assert away.max() < 1.001  # the merge radius
            assert np.isclose(away, 0, atol=1e-3).sum() >= len(xy)
            assert set(range(len(xy))) == set(rows.tolist())
            assert len(xy) < len(found)  # some were merged


def test_a_pair_has_colmaps_matrices_for_its_pixels(matched, database):
    """Inliers fit E and F of the database; F, E and the pose agree."""
    K = matched.plan.cameras[0].K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    inverse = np.linalg.inv(K)
    with pycolmap.Database.open(database) as db:
        camera = db.read_camera(1)
        assert camera.model_name == "PINHOLE"
        assert camera.has_prior_focal_length
        assert np.allclose(camera.calibration_matrix(), K)
        geometry = db.read_two_view_geometry(1, 2)
        raw = db.read_matches(1, 2)
        x1, x2 = (db.read_keypoints(k)[:, :2] for k in (1, 2))
        assert db.num_verified_image_pairs() == 6
    assert geometry.config == pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    inliers = geometry.inlier_matches
    assert {tuple(m) for m in inliers.tolist()} <= {tuple(m) for m in raw.tolist()}
    ones = np.ones((len(inliers), 1))
    x1, x2 = (np.hstack([x[inliers[:, k]], ones]) for k, x in enumerate((x1, x2)))
    lines = x1 @ geometry.F.T
    distance = np.abs((x2 * lines).sum(1)) / np.linalg.norm(lines[:, :2], axis=1)
    assert np.median(distance) < 0.8  # keypoints of a fifth of the size
    assert np.percentile(distance, 95) < 2.5
    pose = geometry.cam2_from_cam1
    t = pose.translation
    E = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ pose.rotation.matrix()
    assert _same_up_to_scale(E, geometry.E)
    assert _same_up_to_scale(inverse.T @ E @ inverse, geometry.F)


def _same_up_to_scale(a, b):
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return min(np.abs(a - b).max(), np.abs(a + b).max()) < 1e-4


def test_colmap_maps_the_database_to_the_true_cameras(model, matched, data_dir):
    assert model.num_reg_images() == 4
    centres, truth = [], []
    first = sorted((data_dir / "strecha/fountain-P11/gt_dense_cameras").glob("*.camera"))[3]
    for image in model.images.values():
        centres.append(image.projection_center())
        R, t = read_truth(f"{first},{first.with_name(f'{image.name}.camera')}")
        truth.append(-R.T @ t)
    import torch

    x, y = (torch.tensor(np.array(a)) for a in (centres, truth))
    error = (fit_similarity(x, y).apply(x) - y).norm(dim=1)
    assert float(error.max()) < 0.01  # metres; neighbouring cameras are 1.5 m apart


def test_the_operators_of_every_point_are_recovered_without_sfmkit(model, matched, lists, database):
    """By the script of docs/folders.md, and by the functions of the package."""
    with sqlite3.connect(database) as db:
        names = dict(db.execute("SELECT operator_id, name FROM sfmkit_operators"))
        members = {}
        for image_id, *blobs in db.execute(
            "SELECT image_id, keypoint, operator_id FROM sfmkit_keypoints"
        ):
            for row, operator in zip(*(np.frombuffer(blob, "<i4").tolist() for blob in blobs)):
                members.setdefault((image_id, row), set()).add(operator)
    points = map_points(model, lists, 3)
    assert len(points) == model.num_points3D() > 300
    for k, (point_id, point) in enumerate(model.points3D.items()):
        assert points.ids[k] == point_id
        seen = [members[e.image_id, e.point2D_idx] for e in point.track.elements]
        found = {o for o in names if sum(o in s for s in seen) >= 2}
        bits = {o for o in names if points.masks[k] >> o & 1}
        assert bits == found or (not found and bits)
    lines = track_statistics(points, tuple(names.values()))
    assert lines["multi"].points == len(points)
    assert lines["multi"].error_px == pytest.approx(model.compute_mean_reprojection_error(), 0.02)
    assert sum(line.alone for name, line in lines.items() if name != "multi") < len(points)


def test_hlocs_files_are_read_by_its_layout(matched, lists, tmp_path):
    """Written from the documented layout: a group per image, a group NAME1/NAME2 per pair."""
    h5py = pytest.importorskip("h5py")
    from sfmkit.mapping.hloc import write_hloc

    write_hloc(matched, lists, tmp_path / "h5")
    pairs = [line.split() for line in (tmp_path / "h5/pairs.txt").read_text().splitlines()]
    assert len(pairs) == 6
    with (
        h5py.File(tmp_path / "h5/features.h5") as features,
        h5py.File(tmp_path / "h5/matches.h5") as matches,
    ):
        name1, name2 = pairs[0]
        x1, x2 = (features[name]["keypoints"][()] for name in (name1, name2))
        assert np.array_equal(x1, lists[0].xy)
        group = matches["/".join(n.replace("/", "-") for n in (name1, name2))]
        best, score = group["matches0"][()], group["matching_scores0"][()]
    assert len(best) == len(x1) == len(score)
    index1 = np.flatnonzero(best > -1)
    assert best.max() < len(x2)
    assert (score[index1] >= 0).all()
    expected = match_rows(matched.geometry(0), lists[0], lists[1])
    assert {(int(i), int(best[i])) for i in index1} <= {tuple(r) for r in expected.rows.tolist()}
    assert set(index1.tolist()) == set(expected.rows[:, 0].tolist())


def test_the_map_command_writes_a_model_that_everything_reads(matched, data_dir, tmp_path):
    """From the cache of the fixture."""
    out = tmp_path / "o"
    command = ["map", str(matched.plan.collection.folder), "--out", str(out), "--max-size", "640"]
    command += ["--intrinsics", str(data_dir / "strecha/fountain-P11/images/K.txt")]
    command += ["--budget", "2000", "--cache", matched.cache.location, "--workers", "1"]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    assert "4 of 4 photographs registered" in done.output
    report = json.loads((out / "report.json").read_text())
    n = report["model"]["points"]
    binary, text = (read_colmap(out / name) for name in ("sparse/0", "sparse-text/0"))
    assert len(binary.points) == len(text.points) == n
    cloud = read_ply(out / "cloud.ply")
    assert cloud.operators == ("surf", "orb", "fast-brief")
    assert {k: int(cloud.found_by(k).sum()) for k in cloud.operators} == {
        k: report["operators"][k]["points"] for k in cloud.operators
    }
    assert len(plyfile.PlyData.read(out / "cloud.ply")["vertex"]) == n
    _check_transforms(json.loads((out / "transforms.json").read_text()), binary, out)
    assert "4 of 4 photographs were registered" in (out / "report.html").read_text()
    paths = read_recording(out / "recording.rrd").entities
    assert "/world/points/operator" in paths
    assert {p.name for p in out.iterdir()} >= {"model.png", "graph.png", "pairs.csv"}


def _check_transforms(transforms, model, folder: Path):
    """A point of the model falls on its observation, by the conventions of nerfstudio."""
    image = next(i for i in model.images.values() if (i.point_id >= 0).any())
    frame = next(f for f in transforms["frames"] if f["file_path"].endswith(image.name))
    assert (folder / frame["file_path"]).is_file()
    rows = np.flatnonzero(image.point_id >= 0)[:50]
    X = np.array([model.points[k].xyz for k in image.point_id[rows]])
    pose = np.linalg.inv(np.array(frame["transform_matrix"]))
    x, y, z = (np.hstack([X, np.ones((len(X), 1))]) @ pose.T)[:, :3].T
    u = frame["fl_x"] * x / -z + frame["cx"]
    v = frame["fl_y"] * -y / -z + frame["cy"]
    away = np.hypot(u - (image.xy[rows, 0] + 0.5), v - (image.xy[rows, 1] + 0.5))
    assert np.median(away) < 1.5


def test_without_pycolmap_the_message_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "pycolmap", None)
    done = CliRunner().invoke(main, ["map", str(tmp_path), "--out", str(tmp_path / "o")])
    assert done.exit_code == 2
    assert "pip install 'sfmkit[peers]'" in done.output


def test_a_file_without_provenance_is_refused(tmp_path):
    (tmp_path / "a.db").write_bytes(b"not a database")
    with pytest.raises(InputError, match="no provenance"):
        read_provenance(tmp_path / "a.db")
