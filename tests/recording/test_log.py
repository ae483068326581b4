"""Recordings, read back: every number against the arrays it was made from, or against the geometry
in closed form."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import rerun as rr
import torch
from made_up_result import LONELY, OPERATORS, OUTLIERS, POINTS, make_result

from sfmkit.errors import OutputError
from sfmkit.geometry.reprojection import project
from sfmkit.io.images import read_image
from sfmkit.pipeline.reconstruction import Reconstruction
from sfmkit.recording import log as recordings
from sfmkit.recording.log_photos import log_photographs
from sfmkit.recording.read import Recording, read_recording
from sfmkit.types import Camera, Verdict
from sfmkit.viz.colours import operator_rgb

RESULT = make_result()


def saved(folder: Path, result: Reconstruction, **options) -> Recording:
    path = folder / "a.rrd"
    recordings.save_recording(path, result, **options)
    return read_recording(path)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Recording:
    return saved(tmp_path_factory.mktemp("recording"), RESULT)


def own(recording: Recording, entity: str) -> dict:
    return {
        c.removeprefix("sfmkit:"): v
        for c, v in recording.latest(entity).items()
        if c.startswith("sfmkit:")
    }


def packed(rgb: tuple[int, int, int]) -> int:
    """A colour as the file stores it: 0xRRGGBBAA."""
    return rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | 255


def positions(recording: Recording, entity: str, stage: int | None = None) -> np.ndarray:
    items = [
        i
        for i in recording.logged(entity)
        if i.component.endswith(":positions") and (stage is None or i.times.get("stage") == stage)
    ]
    return items[-1].values


def test_the_viewers_own_check_passes(recording):
    done = subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(recording.path)],
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr.decode()


def test_every_entity_and_column_is_documented_and_every_documented_one_is_there(recording):
    page = (Path(__file__).parents[2] / "docs" / "recording.md").read_text()
    rows = re.findall(
        r"(?m)^\| `(/\S*)` \| ([^|]+) \| [^|]* \| ([^|]*?) ?\|$", page.split("## Entities")[1]
    )
    documented: dict[str, tuple[str, set[str]]] = {}
    for path, stage, columns in rows:
        names = set(re.findall(r"`(\w+)`", columns))
        if "same" in columns or "as inliers" in columns:
            names = documented[
                "/world/camN/image/inliers/OP" if "liers" in path else "/world/points/photograph"
            ][1]
        documented[path] = (stage.strip(), names)
    stages = {
        "static": set(),
        **{f"{a} to {b}": set(range(a, b + 1)) for a in range(8) for b in range(8)},
    }
    stages |= {str(k): {k} for k in range(8)}

    def generic(entity: str) -> str:
        entity = re.sub(r"/(cam|photo)[12]\b", r"/\1N", entity)
        entity = re.sub(r"/poses/[1-4]\b", "/poses/K", entity)
        entity = re.sub(r"^/timings/\w+", "/timings/STAGE", entity)
        entity = re.sub(r"^/account/chart/\w+", "/account/chart/QUANTITY", entity)
        entity = re.sub(r"^/scale/\w+", "/scale/QUANTITY", entity)
        entity = re.sub(r"^/matches/\w+/note", "/matches/KIND/note", entity)
        return re.sub(r"/(surf|orb|fast-brief)(?=/|$)", "/OP", entity)

    seen = set()
    for entity in recording.entities:
        kind = generic(entity)
        assert kind in documented, f"{entity} is not documented"
        seen.add(kind)
        stage, columns = documented[kind]
        logged = recording.logged(entity)
        assert {
            i.component.removeprefix("sfmkit:") for i in logged if i.component.startswith("sfmkit:")
        } == columns, entity
        assert {i.times["stage"] for i in logged if "stage" in i.times} <= stages[stage], entity
        assert (stage == "static") == all(not i.times for i in logged), entity
    assert set(documented) - seen == {"/world/camN/image/homography"}  # this scene is not a plane


@pytest.mark.parametrize("image", [1, 2])
@pytest.mark.parametrize("name", OPERATORS)
def test_keypoints_carry_operator_scale_and_fate(recording, name, image):
    entity = f"/world/cam{image}/image/keypoints/{name}"
    f, logged, columns = (
        RESULT.features[name][image - 1],
        recording.latest(entity),
        own(recording, entity),
    )
    np.testing.assert_array_equal(logged["Points2D:positions"], f.keypoints)
    assert logged["Points2D:colors"].tolist() == [packed(operator_rgb(name))]
    np.testing.assert_array_equal(columns["scale_px"], f.scales)
    np.testing.assert_allclose(columns["angle_deg"], np.degrees(f.angles), rtol=1e-6)
    k = OPERATORS.index(name)
    n = np.arange(POINTS + OUTLIERS)
    kept = n[n % 3 == k]
    merged = n[((n + 1) % 3 == k) & (n % 4 == 0)]
    expected = np.concatenate([kept, merged, np.full(LONELY, -1)])
    np.testing.assert_array_equal(columns["match"], expected)
    np.testing.assert_array_equal(columns["point"], np.where(expected < POINTS, expected, -1))
    assert (
        columns["fate"][: len(kept)]
        == np.where(kept < POINTS, "point", "outlier: off its epipolar line")
    ).mean() > 0.95
    assert set(columns["fate"][len(kept) : len(kept) + len(merged)]) == {"merged into a duplicate"}
    assert set(columns["fate"][-LONELY:]) == {"unmatched"}


def test_regions_show_scale_and_orientation(recording):
    for name in OPERATORS:
        entity = f"/world/cam1/image/regions/{name}"
        f, rows, logged = (
            RESULT.features[name][0],
            own(recording, entity)["keypoint"],
            recording.latest(entity),
        )
        np.testing.assert_allclose(
            logged["Ellipses2D:half_sizes"], np.stack([f.scales[rows] / 2] * 2, 1)
        )
        ticks = np.array(recording.latest(f"{entity}/ticks")["LineStrips2D:strips"])
        np.testing.assert_allclose(ticks[:, 0], f.keypoints[rows], atol=1e-4)
        turned = np.arctan2(*(ticks[:, 1] - ticks[:, 0]).T[::-1])
        np.testing.assert_allclose(np.cos(turned - f.angles[rows]), 1, atol=1e-5)


def test_survivors_thin_out_stage_by_stage(recording):
    counts = {
        i.times["stage"]: len(i.values)
        for i in recording.logged("/world/cam2/image/survivors")
        if i.component == "Points2D:positions"
    }
    account = RESULT.account["multi"]
    assert counts == {
        1: account.keypoints[1],
        2: account.matches,
        3: account.initial,
        4: account.inliers,
        7: 0,
    }


def test_matches_are_split_by_operator_and_fate_and_keep_their_pixels(recording):
    found = []
    for what, inside in (("inliers", True), ("outliers", False)):
        for name in OPERATORS:
            entity = f"/world/cam1/image/{what}/{name}"
            columns = own(recording, entity)
            rows = columns["match"]
            found.extend(rows.tolist())
            assert (RESULT.two_view.inliers.numpy()[rows] == inside).all()
            assert (RESULT.correspondences.operator_id.numpy()[rows] == OPERATORS.index(name)).all()
            np.testing.assert_allclose(
                columns["x2"], RESULT.correspondences.x2.numpy()[rows], rtol=1e-6
            )
            np.testing.assert_allclose(
                positions(recording, entity), RESULT.correspondences.x1.numpy()[rows], rtol=1e-6
            )
            assert all(name in joined.split("+") for joined in columns["operators"])
    assert sorted(found) == list(range(POINTS + OUTLIERS))


def test_side_by_side_lines_join_the_two_images(recording):
    for what in ("inliers", "outliers"):
        entity = f"/matches/{what}/orb"
        strips, rows = (
            np.array(recording.latest(entity)["LineStrips2D:strips"]),
            own(recording, entity)["match"],
        )
        np.testing.assert_allclose(strips[:, 0], RESULT.correspondences.x1.numpy()[rows], rtol=1e-6)
        shift = strips[:, 1] - RESULT.correspondences.x2.numpy()[rows]
        assert np.ptp(shift[:, 0]) < 1e-3
        assert shift[0, 0] >= 320
    merged = own(recording, "/matches/merged/orb")
    assert (merged["match"] % 4 == 0).all()
    assert set(merged["merged_into"]) == {"surf"}


def test_the_cloud_carries_its_whole_origin(recording):
    cloud, corr = RESULT.cloud, RESULT.correspondences
    for name in ("photograph", "operator", "density", "uncertainty"):
        entity = f"/world/points/{name}"
        np.testing.assert_allclose(positions(recording, entity), cloud.xyz.numpy(), rtol=1e-6)
        columns = own(recording, entity)
        np.testing.assert_array_equal(columns["match"], cloud.match)
        np.testing.assert_array_equal(columns["operator_mask"], cloud.operator_mask)
        np.testing.assert_allclose(columns["residual_px"], cloud.reprojection_error, rtol=1e-6)
        np.testing.assert_allclose(columns["parallax_deg"], cloud.parallax, rtol=1e-6)
        np.testing.assert_allclose(columns["x1"], corr.x1[cloud.match], rtol=1e-6)
        np.testing.assert_allclose(columns["sigma"], (1e-4 + 1e-2) ** 0.5, rtol=1e-5)
        f = RESULT.features["surf"][0].keypoints[columns["keypoint1"][0]]  # point 0 is SURF's
        np.testing.assert_allclose(f, columns["x1"][0], rtol=1e-6)
    assert len(recording.latest("/world/points/photograph")["Points3D:colors"]) == POINTS


def test_the_cloud_projects_onto_the_pixels_it_came_from(recording):
    X = positions(recording, "/world/points/operator").astype(float)
    for image, x in ((1, RESULT.correspondences.x1), (2, RESULT.correspondences.x2)):
        pinhole = recording.latest(f"/world/cam{image}/image")
        K = pinhole["Pinhole:image_from_camera"].reshape(3, 3).T  # the viewer stores columns
        Y = X
        if image == 2:
            place = recording.latest("/world/cam2")
            Y = X @ place["Transform3D:mat3x3"].reshape(3, 3) + place["Transform3D:translation"][0]
        y = Y @ K.T
        assert (
            np.abs(y[:, :2] / y[:, 2:] - x.numpy()[:POINTS]).max() < 1.5
        )  # 0.3 px of noise, 1200 times
        np.testing.assert_array_equal(
            recording.latest(f"/world/cam{image}/image/photo")["Transform3D:translation"][0, :2],
            -0.5,
        )


def test_epipolar_lines_and_epipoles(recording):
    view = RESULT.two_view
    K, R, t = view.camera1.K, view.R.numpy(), view.t.numpy()
    epipole1 = K @ (-R.T @ t)  # camera 2's centre, seen by camera 1
    np.testing.assert_allclose(
        positions(recording, "/world/cam1/image/epipole")[0],
        (epipole1 / epipole1[2])[:2],
        rtol=1e-4,
    )
    epipole2 = K @ t
    np.testing.assert_allclose(
        positions(recording, "/world/cam2/image/epipole")[0],
        (epipole2 / epipole2[2])[:2],
        rtol=1e-4,
    )
    lines = recording.latest("/world/cam2/image/epipolar/lines")
    rows = own(recording, "/world/cam2/image/epipolar/lines")["match"]
    for row, (a, b) in zip(rows, np.array(lines["LineStrips2D:strips"])):
        # The line of x1 joins the epipole and the image of any point on its ray.
        ray = np.linalg.inv(K) @ np.append(RESULT.correspondences.x1.numpy()[row], 1)
        for depth in (3.0, 9.0):
            y = K @ (R @ (depth * ray) + t)
            p = y[:2] / y[2]
            off = (b - a)[0] * (p - a)[1] - (b - a)[1] * (p - a)[0]
            assert abs(off) / np.linalg.norm(b - a) < 1e-2


def test_four_poses_with_counts_and_the_chosen_one(recording):
    poses = [own(recording, f"/world/poses/{k}/count") for k in range(1, 5)]
    assert sorted(int(p["in_front"][0]) for p in poses)[-1] == POINTS
    (chosen,) = [k for k, p in enumerate(poses, start=1) if p["chosen"][0]]
    assert poses[chosen - 1]["in_front"][0] == POINTS
    place = recording.latest(f"/world/poses/{chosen}")
    np.testing.assert_allclose(place["Transform3D:translation"][0], RESULT.two_view.t, atol=1e-6)


def test_residuals_are_drawn_fifty_times_longer(recording):
    strips = np.array(recording.latest("/world/cam2/image/residuals")["LineStrips2D:strips"])
    view = RESULT.two_view
    projected = project(RESULT.cloud.xyz, view.camera2.tensors()[0], view.R, view.t).numpy()
    seen = RESULT.correspondences.x2.numpy()[:POINTS]
    np.testing.assert_allclose(strips[:, 0], seen, rtol=1e-6)
    np.testing.assert_allclose(strips[:, 1] - strips[:, 0], 50 * (projected - seen), atol=1e-3)
    length = own(recording, "/world/cam2/image/residuals")["residual_px"]
    np.testing.assert_allclose(length, np.linalg.norm(projected - seen, axis=1), rtol=1e-4)


def test_ellipsoids_are_three_sigma_and_stretched_along_the_ray(recording):
    logged = recording.latest("/world/ellipsoids")
    half = logged["Ellipsoids3D:half_sizes"]
    np.testing.assert_allclose(half.max(1), 3 * (1e-4 + 1e-2) ** 0.5, rtol=1e-5)
    np.testing.assert_allclose(half.min(1), 3 * 1e-2, rtol=1e-4)
    x, y, z, w = logged["Ellipsoids3D:quaternions"].T
    third = np.stack(
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1
    )  # R e3: the longest axis
    rays = positions_of(logged["Ellipsoids3D:centers"])
    np.testing.assert_allclose(np.abs((third * rays).sum(1)), 1, atol=1e-5)


def positions_of(X: np.ndarray) -> np.ndarray:
    return X / np.linalg.norm(X, axis=1, keepdims=True)


def test_the_rays_meet_in_the_point(recording):
    strips = np.array(recording.latest("/world/rays")["LineStrips3D:strips"])
    point = int(own(recording, "/world/rays")["point"][0])
    np.testing.assert_allclose(strips[:, 1], [RESULT.cloud.xyz[point].numpy()] * 2, rtol=1e-5)
    np.testing.assert_allclose(strips[0, 0], 0)
    np.testing.assert_allclose(
        strips[1, 0], -(RESULT.two_view.R.T @ RESULT.two_view.t).numpy(), atol=1e-6
    )


def test_history_is_replayed_on_iteration(recording):
    inliers = [
        i for i in recording.logged("/estimation/inliers") if i.component == "Scalars:scalars"
    ]
    assert [(i.times["iteration"], i.values[0]) for i in inliers] == [(0, 50), (1, 150), (2, 250)]
    lines = [
        i.times
        for i in recording.logged("/world/cam1/image/epipolar/lines")
        if i.component == "LineStrips2D:strips"
    ]
    assert [t.get("iteration") for t in lines] == [
        0,
        1,
        2,
        None,
    ]  # and at last the result, on the timeline stage alone


def test_photographs_are_compressed_and_originals_kept_on_request(tmp_path):
    pixels = np.tile(np.linspace(0, 255, 320).astype(np.uint8)[None, :, None], (240, 1, 3))
    PIL.Image.fromarray(pixels).save(tmp_path / "photo.jpg", quality=97)
    image = read_image(tmp_path / "photo.jpg")
    result = replace(make_result(), images=(image, read_image(pixels)))
    small = saved(tmp_path, result)
    blob = bytes(
        np.array(small.latest("/world/cam1/image/photo")["EncodedImage:blob"][0], np.uint8)
    )
    assert blob[:2] == b"\xff\xd8"
    assert np.abs(np.asarray(PIL.Image.open(io.BytesIO(blob))).astype(int) - image.rgb).max() < 12
    whole = saved(tmp_path, result, originals=True)
    blob1, blob2 = (
        bytes(
            np.array(whole.latest(f"/world/cam{i}/image/photo")["EncodedImage:blob"][0], np.uint8)
        )
        for i in (1, 2)
    )
    assert blob1 == (tmp_path / "photo.jpg").read_bytes()
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(io.BytesIO(blob2))), pixels)


def test_distortion_is_taken_out_so_that_the_cloud_projects_onto_the_pixels(tmp_path):
    view = RESULT.two_view
    camera = Camera(
        view.camera1.K, view.camera1.size_wh, np.array([-0.2, 0.05, 0.001, -0.001, 0.0])
    )
    K, d = camera.tensors()
    x1 = project(RESULT.cloud.xyz, K, distortion=d)
    corr = RESULT.correspondences
    bent = replace(corr, x1=torch.cat([x1, corr.x1[POINTS:].clamp(60, 180)]))
    result = replace(RESULT, correspondences=bent, two_view=replace(view, camera1=camera))
    recording = saved(tmp_path, result)
    straight = project(RESULT.cloud.xyz, K).numpy()
    for name in OPERATORS:
        entity = f"/world/cam1/image/inliers/{name}"
        rows = own(recording, entity)["match"]
        np.testing.assert_allclose(positions(recording, entity), straight[rows], atol=1e-3)
        np.testing.assert_allclose(own(recording, entity)["x1"], x1.numpy()[rows], rtol=1e-5)
    assert np.abs(x1.numpy() - straight).max() > 3


def test_pixels_outside_the_field_of_the_lens_are_moved_to_its_border():
    """k1 = -0.27 at a focal length of 150 pixels: the image folds back 111 pixels from its centre,
    where the undistorted radius is 150 / sqrt(0.81) = 166.7 pixels."""
    K = np.array([[150.0, 0, 159.5], [0, 150.0, 119.5], [0, 0, 1]])
    camera = Camera(K, (320, 240), np.array([-0.27, 0, 0, 0, 0]))
    far = np.array([[0.0, 0.0], [319.0, 119.5], [159.5, 0.0]])
    ideal = recordings.marks.ideal_pixels(far, camera)
    out, there = far - K[:2, 2], ideal - K[:2, 2]
    np.testing.assert_allclose(np.linalg.norm(there, axis=1), 150 / 0.81**0.5, rtol=1e-2)
    np.testing.assert_allclose(out[:, 0] * there[:, 1], out[:, 1] * there[:, 0], atol=1e-6)
    near = np.array([[170.0, 100.0]])
    np.testing.assert_array_equal(
        recordings.marks.ideal_pixels(np.concatenate([near, far]), camera)[:1],
        recordings.marks.ideal_pixels(near, camera),
    )


def test_a_plane_shows_the_warped_outline(tmp_path):
    H = torch.tensor([[1.0, 0, 10], [0, 1, -5], [0, 0, 1]], dtype=torch.float64)
    recording = saved(
        tmp_path, replace(RESULT, two_view=replace(RESULT.two_view, verdict=Verdict.PLANAR, H=H))
    )
    (outline,) = recording.latest("/world/cam2/image/homography")["LineStrips2D:strips"]
    np.testing.assert_allclose(np.min(outline, 0), [9.5, -5.5], atol=1e-4)
    np.testing.assert_allclose(np.max(outline, 0), [329.5, 234.5], atol=1e-4)


def test_no_geometry_and_nothing_found_make_a_recording_too(tmp_path):
    view = replace(
        RESULT.two_view,
        verdict=Verdict.TOO_LITTLE,
        R=None,
        t=None,
        E=None,
        F=None,
        H=None,
        inliers=torch.zeros_like(RESULT.two_view.inliers),
    )
    recording = saved(tmp_path, replace(RESULT, two_view=view, cloud=None))
    assert "/world/points/operator" not in recording
    assert set(own(recording, "/world/cam1/image/outliers/surf")["fate"]) == {
        "no geometry to agree with"
    }
    empty = make_result(points=0, outliers=0, lonely=0)
    recording = saved(
        tmp_path, replace(empty, two_view=replace(view, inliers=empty.two_view.inliers), cloud=None)
    )
    assert recording.report()["verdict"]["kind"] == "too little evidence"


def test_operators_may_hold_any_character(tmp_path):
    names = {"surf": "gftt+brief", "orb": "orb", "fast-brief": "a/b c"}

    def renamed(mapping):
        return {names.get(k, k): v for k, v in mapping.items()}

    r = RESULT
    result = replace(
        r,
        features=renamed(r.features),
        matches=renamed(r.matches),
        account=renamed(r.account),
        correspondences=replace(
            r.correspondences,
            operators=tuple(names.values()),
            counts=renamed(r.correspondences.counts),
        ),
        cloud=replace(r.cloud, operators=tuple(names.values())),
    )
    recording = saved(tmp_path, result)
    assert set(recording.below("/world/cam1/image/keypoints")) == set(names.values())


def test_a_prefix_keeps_several_apart_and_run_replays_an_ablation(tmp_path):
    path = tmp_path / "runs.rrd"
    rec = rr.RecordingStream("sfmkit", recording_id="runs", send_properties=False)
    rec.save(path)
    recordings.log_reconstruction(rec, RESULT, "left")
    recordings.log_reconstruction(rec, make_result(points=120), "/right/")
    for run, n in enumerate((300, 90)):
        recordings.log_run(rec, make_result(points=n), run, "ablation", images=run == 0)
    rec.flush()
    rec.disconnect()
    recording = read_recording(path)
    assert set(recording.prefixes()) == {"/left", "/right"}
    assert len(positions(recording, "/left/world/points/operator")) == POINTS
    assert len(positions(recording, "/right/world/points/operator")) == 120
    runs = {
        i.times["run"]: len(i.values)
        for i in recording.logged("/ablation/world/points/operator")
        if i.component == "Points3D:positions"
    }
    assert runs == {0: 300, 1: 90}
    assert all("run" not in i.times for i in recording.logged("/left/world/points/operator"))


def test_a_failed_write_leaves_nothing_and_keeps_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "a.rrd"
    path.write_bytes(b"before")

    def fail(*_):
        raise RuntimeError("no more")

    monkeypatch.setattr(recordings, "log_account", fail)
    with pytest.raises(RuntimeError, match="no more"):
        recordings.save_recording(path, RESULT)
    assert [p.name for p in tmp_path.iterdir()] == ["a.rrd"]
    assert path.read_bytes() == b"before"
    with pytest.raises(OutputError):
        recordings.save_recording(tmp_path / "no such folder" / "a.rrd", RESULT)


def test_a_viewer_that_is_closed_meanwhile_does_not_stop_the_logging():
    from sfmkit._utils import tether
    from sfmkit.recording.viewer import free_ports, listens

    (port,) = free_ports(1)
    command = [
        sys.executable,
        "-m",
        "rerun_cli",
        "--serve-grpc",
        "--bind",
        "127.0.0.1",
        "--port",
        str(port),
    ]
    server = tether.start(
        command, session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    rec = rr.RecordingStream("sfmkit", recording_id="live", send_properties=False)
    try:
        deadline = time.monotonic() + 120
        while not listens(port) and time.monotonic() < deadline:
            time.sleep(0.05)
        rec.connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy")
        log_photographs(rec, *RESULT.images, (RESULT.two_view.camera1, RESULT.two_view.camera2))
    finally:
        server.end()
    began = time.monotonic()
    recordings.log_reconstruction(rec, RESULT)
    assert time.monotonic() - began < 20


@pytest.mark.slow
@pytest.mark.data
def test_a_full_size_recording_is_small_and_quick(data_dir, tmp_path):
    folder = data_dir / "strecha" / "fountain-P11" / "images"
    images = (read_image(folder / "0004.jpg"), read_image(folder / "0005.jpg"))
    result = make_result(
        points=28_000, outliers=8_000, lonely=46_000, size_wh=images[0].size_wh, image=images[0].rgb
    )
    result = replace(result, images=images)
    assert result.account["multi"].keypoints[0] > 170_000
    seconds = []
    for _ in range(3):
        began = time.process_time()  # others may be using the cores
        recordings.save_recording(tmp_path / "full.rrd", result)
        seconds.append(time.process_time() - began)
    assert min(seconds) < 3
    assert (tmp_path / "full.rrd").stat().st_size < 40e6
    shutil.rmtree(tmp_path)
