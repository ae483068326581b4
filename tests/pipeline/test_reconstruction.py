"""Reconstruction of real photographs with ground truth, and general properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from sfmkit import reconstruct
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.errors import CameraError, InputError, OperatorError
from sfmkit.geometry.fundamental import fundamental_from_pose, signed_sampson_distance
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.io.images import read_image
from sfmkit.io.intrinsics import parse_intrinsics
from sfmkit.io.truth import read_truth
from sfmkit.options import DEFAULT, PAPER
from sfmkit.types import Camera, Verdict

QUICK = replace(DEFAULT, detect=replace(DEFAULT.detect, budget=2000, max_size=800))


@pytest.fixture(scope="module")
def demo():
    image1, image2, truth = demo_pair()
    return read_image(image1), read_image(image2), truth


@pytest.fixture(scope="module")
def quick(demo):
    return reconstruct(
        *demo[:2], demo[2], ("orb", "fast-brief"), options=QUICK, truth=read_truth(demo[2])
    )


def test_points_reproject_to_the_observed_pixels(quick):
    view, cloud, corr = quick.two_view, quick.cloud, quick.correspondences
    K = torch.tensor(view.camera1.K)
    for X, x in ((cloud.xyz, corr.x1), (cloud.xyz @ view.R.mT + view.t, corr.x2)):
        assert (X[:, 2] > 0).all()
        y = X @ K.mT
        assert ((y[:, :2] / y[:, 2:] - x[cloud.match]).norm(dim=1)).max() < 2
    assert quick.errors["rotation_deg"] < 0.1
    assert quick.errors["translation_deg"] < 0.4


def test_the_standard_deviations_agree_with_the_errors_in_magnitude(quick):
    rotation, translation = quick.two_view.sigma_deg
    assert quick.errors["rotation_deg"] < 5 * rotation
    assert quick.errors["translation_deg"] < 5 * translation
    eigenvalues = torch.linalg.eigvalsh(quick.cloud.covariance)
    assert (eigenvalues > 0).all()
    depth = quick.cloud.xyz[:, 2]
    sigma_depth = quick.cloud.covariance[:, 2, 2].sqrt()
    assert (sigma_depth / depth).median() < 0.05


def test_colours_are_those_of_the_photograph(quick, demo):
    x = quick.correspondences.x1[quick.cloud.match].round().long().numpy()
    assert (quick.cloud.rgb.numpy() == demo[0].rgb[x[:, 1], x[:, 0]]).all()


def test_swapping_the_photographs_inverts_the_pose(quick, demo):
    back = reconstruct(demo[1], demo[0], demo[2], ("orb", "fast-brief"), options=QUICK)
    R, t = back.two_view.R, back.two_view.t
    assert float(rotation_error(R.mT, quick.two_view.R)) < 0.05
    assert float(translation_error(-R.mT @ t, quick.two_view.t)) < 0.3


def test_a_camera_may_be_given_as_an_array(demo, quick):
    K = quick.two_view.camera1.K
    again = reconstruct(*demo[:2], np.array(K), ("orb", "fast-brief"), options=QUICK)
    assert torch.equal(again.two_view.R, quick.two_view.R)


def test_distortion_is_removed(demo, quick):
    """Compare photographs distorted by a known lens, with and without its coefficients.

    The pose is the same if the lens is given, and worse otherwise.
    """
    import cv2

    K, d = quick.two_view.camera1.K, np.array([-0.12, 0.03, 0.0, 0.0, 0.0])
    w, h = demo[0].size_wh
    grid = (
        np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).reshape(-1, 1, 2).astype(np.float32)
    )
    ideal = cv2.undistortPoints(grid, K, d, P=K).reshape(h, w, 2)
    bent = [cv2.remap(image.rgb, ideal, None, cv2.INTER_LINEAR) for image in demo[:2]]
    truth = read_truth(demo[2])
    known = reconstruct(
        *bent, Camera(K, (w, h), d), ("orb", "fast-brief"), options=QUICK, truth=truth
    )
    ignored = reconstruct(
        *bent, Camera(K, (w, h)), ("orb", "fast-brief"), options=QUICK, truth=truth
    )
    assert known.errors["translation_deg"] < 0.4
    assert known.errors["rotation_deg"] < 0.5 * ignored.errors["rotation_deg"]


def test_bad_arguments(demo):
    small = demo[1].rgb[:600]
    with pytest.raises(CameraError, match="intrinsics2"):
        reconstruct(demo[0], small, Camera(np.diag([900.0, 900, 1]), demo[0].size_wh), ("orb",))
    with pytest.raises(OperatorError, match="no operator"):
        reconstruct(*demo[:2], demo[2], ())
    options = replace(
        QUICK, detect=replace(QUICK.detect, overrides={"surf": {"hessian_threshold": 100}})
    )
    with pytest.raises(InputError, match="not used"):
        reconstruct(*demo[:2], demo[2], ("orb",), options=options)


# --- real photographs


@pytest.fixture(scope="module")
def fountain(data_dir):
    folder = data_dir / "strecha" / "fountain-P11"
    paths = [folder / "images" / f"{i:04d}.jpg" for i in (0, 1)]
    camera = parse_intrinsics(folder / "images" / "K.txt", (3072, 2048))
    return paths, camera, read_truth(folder / "gt_dense_cameras", *paths)


def within_a_pixel(result, camera, truth) -> float:
    K = torch.tensor(camera.K)
    F = fundamental_from_pose(*(torch.as_tensor(a) for a in truth), K, K)
    rows = result.cloud.match
    d = signed_sampson_distance(F, result.correspondences.x1[rows], result.correspondences.x2[rows])
    return float((d.abs() < 1).double().mean())


@pytest.mark.data
@pytest.mark.slow
def test_fountain_with_the_default_preset(fountain):
    paths, camera, truth = fountain
    result = reconstruct(*paths, camera, options=DEFAULT, truth=truth)
    assert result.two_view.verdict is Verdict.GENERAL
    assert result.errors["rotation_deg"] < 0.06
    assert result.errors["translation_deg"] < 0.25
    assert within_a_pixel(result, camera, truth) > 0.97
    assert len(result.cloud) > 20_000


@pytest.mark.data
@pytest.mark.slow
def test_fountain_with_the_settings_of_the_paper(fountain):
    """Compare the counts with Table 6 of the paper, as closely as it can be interpreted.

    Without merging, the numbers of the operators add up to the total.
    """
    paths, camera, truth = fountain
    result = reconstruct(*paths, camera, options=PAPER, truth=truth)
    account = result.account
    for name, initial, points in (
        ("surf", 18_763, 14_093),
        ("orb", 12_980, 10_266),
        ("fast-brief", 3_284, 2_366),
    ):
        assert abs(account[name].initial / initial - 1) < 0.12
        assert abs(account[name].points / points - 1) < 0.12
    assert (
        sum(account[n].points for n in ("surf", "orb", "fast-brief"))
        == account["multi"].points
        > 25_000
    )
    assert result.errors["rotation_deg"] < 1


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("first", range(4))
def test_drone_photographs_with_the_camera_from_exif_alone(data_dir, first):
    paths = sorted((data_dir / "uav" / "toledo-p3pro").glob("*.JPG"))[first : first + 2]
    result = reconstruct(
        *paths, options=replace(DEFAULT, detect=replace(DEFAULT.detect, budget=10_000))
    )
    assert result.two_view.camera1.source.startswith("exif")
    assert result.two_view.verdict in (Verdict.GENERAL, Verdict.PLANAR)
    assert len(result.cloud) > 5_000
    # Nadir photographs of a drone in level flight: it hardly rotates about its horizontal axes and
    # does not dive.
    assert abs(float(result.two_view.t[2])) < 0.2
    assert result.reprojection_rmse_px < 0.6
