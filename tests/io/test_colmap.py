"""The COLMAP text model, read back by COLMAP's own library."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sfmkit.errors import InputError
from sfmkit.geometry.reprojection import project, reprojection_error
from sfmkit.io.colmap import write_colmap
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
def test_colmap_reads_the_same_geometry(tmp_path, model, same_camera):
    pycolmap = pytest.importorskip("pycolmap")
    view, corr, cloud = make_result(DISTORTION[model], same_camera)
    write_colmap(tmp_path / "model", view, corr, cloud, ("a.jpg", "b.jpg"))
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
