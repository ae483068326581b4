"""COLMAP models: written ones are read by COLMAP's own library, and the other way round."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sfmkit.errors import InputError
from sfmkit.geometry.reprojection import project, reprojection_error
from sfmkit.io.colmap import image_path, read_colmap, write_colmap
from sfmkit.io.colmap.cameras import MODELS, SUPPORTED, ColmapCamera
from sfmkit.types import Camera, Correspondences, OperatorCounts, PointCloud, TwoView, Verdict

K1 = np.array([[800.0, 0, 310], [0, 810, 250], [0, 0, 1]])
K2 = np.array([[700.0, 0, 400], [0, 690, 290], [0, 0, 1]])
DISTORTION = {
    "PINHOLE": (),
    "OPENCV": (-0.1, 0.02, 1e-3, -2e-3),
    "FULL_OPENCV": (-0.1, 0.02, 1e-3, -2e-3, 0.05),
}


def make_result(distortion=(), same_camera=False) -> tuple[TwoView, Correspondences, PointCloud]:
    """Forty points seen with half a pixel of noise; every fourth correspondence has no point."""
    rng = np.random.default_rng(0)
    cameras = (Camera(K1, (640, 480), distortion), Camera(K2, (800, 600), distortion))
    if same_camera:
        cameras = (cameras[0], Camera(K1, (640, 480), distortion))
    R = torch.tensor(Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix())
    t = torch.tensor([-0.9, 0.1, 0.2], dtype=torch.float64)
    t /= t.norm()
    X = torch.tensor(rng.uniform([-2, -1.5, 4], [2, 1.5, 9], (40, 3)))
    (k1, d1), (k2, d2) = (c.tensors() for c in cameras)
    x1 = project(X, k1, distortion=d1) + torch.tensor(rng.normal(0, 0.5, (40, 2)))
    x2 = project(X, k2, R, t, d2) + torch.tensor(rng.normal(0, 0.5, (40, 2)))
    zeros = torch.zeros(40, dtype=torch.int64)
    corr = Correspondences(
        x1,
        x2,
        x1[:, 0],
        x1[:, 0],
        zeros,
        zeros + 1,
        zeros,
        zeros,
        ("orb",),
        {"orb": OperatorCounts((40, 40), 40)},
    )
    rows = torch.tensor([k for k in range(40) if k % 4]).flip(
        0
    )  # not in the order of the correspondences
    error = reprojection_error(X, x1, x2, k1, k2, R, t, d1, d2)[rows]
    n = len(rows)
    cloud = PointCloud(
        X[rows],
        torch.arange(3 * n, dtype=torch.uint8).reshape(n, 3),
        zeros[:n],
        zeros[:n] + 1,
        ("orb",),
        error,
        error,
        rows,
    )
    return TwoView(*cameras, zeros.bool(), Verdict.GENERAL, R=R, t=t), corr, cloud


@pytest.mark.peers
@pytest.mark.parametrize("model", DISTORTION)
@pytest.mark.parametrize("same_camera", [True, False])
@pytest.mark.parametrize("binary", [True, False])
def test_colmap_reads_the_same_geometry(tmp_path, model, same_camera, binary):
    pycolmap = pytest.importorskip("pycolmap")
    view, corr, cloud = make_result(DISTORTION[model], same_camera)
    write_colmap(tmp_path / "model", view, corr, cloud, ("a.jpg", "b.jpg"), binary=binary)
    read = pycolmap.Reconstruction(tmp_path / "model")

    assert len(read.cameras) == (1 if same_camera else 2)
    images = {image.name: image for image in read.images.values()}
    pair = (images["a.jpg"], images["b.jpg"])
    for image, ours in zip(pair, (view.camera1, view.camera2)):
        camera = read.cameras[image.camera_id]
        assert camera.model.name == model
        assert (camera.width, camera.height) == ours.size_wh
        # a point in the middle of the top-left pixel is (0, 0) with us and (0.5, 0.5) there
        assert np.allclose(
            camera.calibration_matrix(), ours.K + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        )
    pose = pair[1].cam_from_world()
    assert np.allclose(pose.rotation.matrix(), view.R)
    assert np.allclose(pose.translation, view.t)

    assert read.num_points3D() == len(cloud)
    for k in range(len(cloud)):
        point = read.points3D[k + 1]
        row = int(cloud.match[k])
        assert np.allclose(point.xyz, cloud.xyz[k], rtol=0, atol=1e-15)
        assert point.color.tolist() == cloud.rgb[k].tolist()
        assert {(e.image_id, e.point2D_idx) for e in point.track.elements} == {
            (i.image_id, row) for i in pair
        }
        errors = []
        for image, seen in zip(pair, (corr.x1, corr.x2)):
            observed = image.points2D[row]
            assert observed.point3D_id == k + 1
            assert np.allclose(observed.xy, seen[row] + 0.5)
            projected = read.cameras[image.camera_id].img_from_cam(
                image.cam_from_world() * point.xyz
            )
            errors.append(np.sum((projected - observed.xy) ** 2))
        assert np.sqrt(np.mean(errors)) == pytest.approx(
            float(cloud.reprojection_error[k]), rel=1e-6
        )
        assert point.error == pytest.approx(float(cloud.reprojection_error[k]))
    assert all(not pair[0].points2D[row].has_point3D() for row in range(0, 40, 4))
    assert pair[0].num_points2D() == len(corr)

    read.update_point_3d_errors()
    mean = np.mean([p.error for p in read.points3D.values()])  # COLMAP averages the two distances
    assert 0.9 * mean <= cloud.reprojection_error.mean() <= 1.5 * mean


@pytest.mark.peers
@pytest.mark.parametrize(
    "names,expected",
    [
        (("a.jpg", "a.jpg"), {"1/a.jpg", "2/a.jpg"}),
        (("IMG 1.jpg", "Größe  2.jpg"), {"IMG_1.jpg", "Größe_2.jpg"}),
    ],
)
def test_names(tmp_path, names, expected):
    pycolmap = pytest.importorskip("pycolmap")
    write_colmap(tmp_path, *make_result(), names)
    assert {image.name for image in pycolmap.Reconstruction(tmp_path).images.values()} == expected


def test_half_pixel_in_the_files(tmp_path):
    """Without COLMAP: the numbers themselves."""
    view, corr, cloud = make_result()
    write_colmap(tmp_path, view, corr, cloud, ("a.jpg", "b.jpg"))
    cameras, images, points = (
        [line for line in (tmp_path / name).read_text().splitlines() if not line.startswith("#")]
        for name in ("cameras.txt", "images.txt", "points3D.txt")
    )
    assert cameras == [
        "1 PINHOLE 640 480 800 810 310.5 250.5",
        "2 PINHOLE 800 600 700 690 400.5 290.5",
    ]
    assert images[0] == "1 1 0 0 0 0 0 0 1 a.jpg"
    seen = np.array(images[1].split(), float).reshape(-1, 3)
    assert np.array_equal(seen[:, :2], corr.x1.numpy() + 0.5)
    assert (seen[:, 2] == -1).sum() == 10
    assert len(points) == len(cloud)


def test_what_colmap_cannot_hold(tmp_path):
    view, corr, cloud = make_result()
    rotation_only = TwoView(
        view.camera1, view.camera2, view.inliers, Verdict.PURE_ROTATION, R=view.R
    )
    with pytest.raises(InputError, match="pure rotation"):
        write_colmap(tmp_path / "m", rotation_only, corr, cloud, ("a", "b"))
    skewed = Camera(K1 + [[0, 2.0, 0], [0, 0, 0], [0, 0, 0]], (640, 480))
    with pytest.raises(InputError, match="skew"):
        write_colmap(
            tmp_path / "m",
            TwoView(skewed, skewed, view.inliers, Verdict.GENERAL, R=view.R, t=view.t),
            corr,
            cloud,
            ("a", "b"),
        )
    assert not (tmp_path / "m").exists()


# --- reading


@pytest.mark.parametrize("model", DISTORTION)
@pytest.mark.parametrize("binary", [True, False])
def test_what_was_written_reads_back(tmp_path, model, binary):
    view, corr, cloud = make_result(DISTORTION[model])
    write_colmap(tmp_path, view, corr, cloud, ("a.jpg", "b.jpg"), binary=binary)
    read = read_colmap(tmp_path)
    first, second = (read.images[k] for k in (1, 2))
    assert (first.name, second.name) == ("a.jpg", "b.jpg")
    for image, camera in ((first, view.camera1), (second, view.camera2)):
        back = read.camera(image)
        assert np.allclose(back.K, camera.K, rtol=1e-15)
        assert np.array_equal(back.distortion, camera.distortion)
        assert back.size_wh == camera.size_wh
    assert np.allclose(second.R, view.R, atol=1e-15)
    assert np.array_equal(second.t, view.t)
    assert np.allclose(first.xy, corr.x1, rtol=0, atol=1e-12)
    assert np.allclose(second.xy, corr.x2, rtol=0, atol=1e-12)
    assert len(read.points) == len(cloud)
    for k, point in read.points.items():
        row = int(cloud.match[k - 1])
        assert np.array_equal(point.xyz, cloud.xyz[k - 1])
        assert list(point.rgb) == cloud.rgb[k - 1].tolist()
        assert point.track.tolist() == [[1, row], [2, row]]
        assert first.point_id[row] == k
    light = read_colmap(tmp_path, observations=False)
    assert not light.points
    assert len(light.images[1].xy) == 0
    assert np.array_equal(light.images[2].R, second.R)


@pytest.mark.peers
@pytest.mark.parametrize("binary", [True, False])
def test_models_that_colmap_wrote(tmp_path, binary):
    """Two cameras with observations, through COLMAP's writer."""
    pycolmap = pytest.importorskip("pycolmap")
    view, corr, cloud = make_result(DISTORTION["OPENCV"])
    write_colmap(tmp_path / "ours", view, corr, cloud, ("a.jpg", "sub/b.jpg"))
    theirs = pycolmap.Reconstruction(tmp_path / "ours")
    (tmp_path / "theirs").mkdir()
    (theirs.write_binary if binary else theirs.write_text)(tmp_path / "theirs")
    read, expected = read_colmap(tmp_path / "theirs"), read_colmap(tmp_path / "ours")
    assert {i.name for i in read.images.values()} == {"a.jpg", "sub/b.jpg"}
    for k, image in expected.images.items():
        assert np.allclose(read.images[k].xy, image.xy)
        assert np.array_equal(read.images[k].point_id, image.point_id)
        assert np.allclose(read.images[k].R, image.R)
        assert np.allclose(read.camera(read.images[k]).K, expected.camera(image).K)
    assert all(np.allclose(read.points[k].xyz, p.xyz) for k, p in expected.points.items())


VALUES = {"f": 520, "fx": 520, "fy": 515, "cx": 330, "cy": 235, "k1": -0.11, "k2": 0.03}
VALUES |= {"p1": 0.002, "p2": -0.001, "k3": 0.004, "k4": 0.01, "k5": -0.02, "k6": 0.003}


@pytest.mark.peers
@pytest.mark.parametrize("name", SUPPORTED)
def test_camera_models_project_as_in_colmap(name):
    """COLMAP's projection against OpenCV's with the camera that was made of the parameters."""
    pycolmap = pytest.importorskip("pycolmap")
    params = [VALUES[k] for k in MODELS[name][1]]
    theirs = pycolmap.Camera(model=name, width=640, height=480, params=params)
    camera = ColmapCamera(name, (640, 480), tuple(map(float, params))).camera()
    X = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (30, 3))
    expected = theirs.img_from_cam(X)
    zero = np.zeros(3)
    if camera.model == "fisheye":
        got, _ = cv2.fisheye.projectPoints(X[:, None], zero, zero, camera.K, camera.distortion)
    else:
        got, _ = cv2.projectPoints(X, zero, zero, camera.K, camera.distortion)
    assert np.allclose(got[:, 0] + 0.5, expected, rtol=0, atol=1e-9)


@pytest.mark.peers
def test_every_model_of_colmap_has_its_parameters():
    pycolmap = pytest.importorskip("pycolmap")
    for name in pycolmap.CameraModelId.__members__:
        if name != "INVALID":
            number, names, _ = MODELS[name]
            assert number == int(getattr(pycolmap.CameraModelId, name).value)
            made = pycolmap.Camera.create_from_model_name(1, name, 100.0, 64, 48)
            assert len(names) == len(made.params)


def text_model(folder: Path, cameras="1 PINHOLE 64 48 50 50 32 24\n", images="") -> Path:
    (folder / "cameras.txt").write_text(cameras, encoding="utf-8")
    (folder / "images.txt").write_text(images, encoding="utf-8")
    return folder


IMAGES = "1 1 0 0 0 0 0 0 1 a.png\n1 2 -1\n2 1 0 0 0 1 0 0 1 b c.png\n\n"


@pytest.mark.parametrize(
    "cameras,images",
    [
        ("\ufeff1 PINHOLE 64 48 50 50 32 24\n", "\ufeff" + IMAGES),
        ("# Camera list\n\n  1 PINHOLE 64 48 50 50 32 24  \n\n", "# Image list\n\n\n" + IMAGES),
        ("1\tPINHOLE\t64 48 50 50 32 24\r\n", IMAGES.replace("\n", "\r\n")),
        ("1 PINHOLE 64 48 50 50 32 24", IMAGES.rstrip()),
        ("1 PINHOLE 64 48 50 50 32 24\n2 FOV 64 48 50 50 32 24 .9\n", IMAGES),
    ],
    ids=["byte order mark", "blank lines", "tabs and carriage returns", "no end", "unused camera"],
)
def test_layouts_of_text(tmp_path, cameras, images):
    read = read_colmap(text_model(tmp_path, cameras, images))
    assert [image.name for image in read.images.values()] == ["a.png", "b c.png"]
    assert read.images[2].t.tolist() == [1, 0, 0]
    assert np.array_equal(read.images[1].xy, [[0.5, 1.5]])
    assert np.array_equal(read.camera(read.images[1]).K, [[50, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])


@pytest.mark.parametrize(
    "cameras,message",
    [
        ("!\n", "cameras.txt, line 1: a camera is ID MODEL"),
        ("# c\none PINHOLE 64 48 50 50 32 24", "line 2: 'one' is not a whole number"),
        ("1 PINHOLE 64 48 50 50 32", "PINHOLE has 4 parameters, not 3"),
        ("1 PINHOLE 64 48 50 50 32 x", "'x' is not a number"),
        ("1 PINHOLE 64 48 50 50 32 nan", "finite"),
        ("1 PINHOLE 0 48 50 50 32 24", "cannot have 0 x 48"),
        ("1 PINHOLE 9999999999 48 50 50 32 24", "cannot have"),
        ("1 PINHOLE " + "9" * 5000 + " 48 50 50 32 24", "not a whole number"),
        ("1 CAMERA 64 48 50 50 32 24", "not one of COLMAP's"),
        ("1 PINHOLE 64 48 50 50 32 24\n1 PINHOLE 64 48 50 50 32 24", "line 2: .* twice"),
    ],
)
def test_malformed_cameras(tmp_path, cameras, message):
    with pytest.raises(InputError, match=message):
        read_colmap(text_model(tmp_path, cameras, IMAGES))


@pytest.mark.parametrize(
    "images,message",
    [
        ("1 1 0 0 0 0 0 0 1\n\n", "images.txt, line 1: an image is ID"),
        ("\n1 1 0 0 0 0 0 0 1.5 a.png\n\n", "line 2: '1.5' is not a whole number"),
        ("1 0 0 0 0 0 0 0 1 a.png\n\n", "quaternion"),
        ("1 nan 0 0 0 0 0 0 1 a.png\n\n", "NaN"),
        ("1 1 0 0 0 0 0 0 1 a.png\n1 2\n", "line 2: observations are triples"),
        ("1 1 0 0 0 0 0 0 1 a.png\n1 2 x\n", "line 2: 'x' is not a whole number"),
        ("1 1 0 0 0 0 0 0 1 a.png\n1 2 99999999999999999999\n", "not a whole number"),
        ("1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 0 0 0 0 1 b.png\n", "line 2: observations"),
        ("1 1 0 0 0 0 0 0 1 a.png\n\n1 1 0 0 0 0 0 0 1 b.png\n\n", "line 3: .* twice"),
        ("1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 0 0 0 1 a.png\n\n", "line 3: .* twice"),
        ("1 1 0 0 0 0 0 0 1 ../a.png\n\n", "line 1: .* leads out"),
    ],
)
def test_malformed_images(tmp_path, images, message):
    with pytest.raises(InputError, match=message):
        read_colmap(text_model(tmp_path, images=images))


def test_a_camera_is_refused_when_an_image_needs_it(tmp_path):
    cameras = "1 FOV 64 48 50 50 32 24 .9\n"
    read = read_colmap(text_model(tmp_path, cameras, IMAGES.replace("1 b c", "5 b c")))
    with pytest.raises(InputError, match=r"camera 1 of the image a\.png: .* FOV is not supported"):
        read.camera(read.images[1])
    with pytest.raises(InputError, match="there is no camera 5"):
        read.camera(read.images[2])


@pytest.mark.parametrize(
    "name",
    ["/etc/hostname", "../secret.png", "a/../../b.png", "C:\\a.png", "..\\a.png", "a\0b", ""],
)
def test_names_must_stay_in_the_folder(name):
    with pytest.raises(InputError, match="leads out of"):
        image_path(Path("images"), name)


def test_names_in_the_folder():
    for name in ("a b.png", "sub/a.png", "..a.png", "a..png"):
        assert image_path(Path("images"), name) == Path("images") / name


def test_missing_files(tmp_path):
    for folder in (tmp_path / "none", tmp_path):
        with pytest.raises(InputError, match="holds no COLMAP model"):
            read_colmap(folder)
