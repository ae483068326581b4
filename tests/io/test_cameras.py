"""Cameras from EXIF and XMP."""

from __future__ import annotations

import math
import warnings

import numpy as np
import PIL.Image
import pytest
from PIL.TiffImagePlugin import IFDRational

from sfmkit.io.cameras import CameraWarning, camera_from_exif
from sfmkit.io.exif import Exif
from sfmkit.io.images import Image, read_image
from sfmkit.io.sensors import SENSOR_WIDTH_MM, sensor_width

SIZE = (640, 480)


def photo(size: tuple[int, int] = SIZE, **exif) -> Image:
    w, h = size
    return Image(
        np.zeros((h, w, 3), np.uint8),
        np.zeros((h, w), np.uint8),
        exif=Exif(**exif) if exif else None,
    )


def test_focal_plane_resolution_is_the_most_precise_of_sources_that_agree():
    exif = {
        "focal_mm": 50.0,
        "focal_plane_resolution": (10.0, 10.0),
        "focal_35mm": 27.0,
        "make": "Canon",
    }
    camera = camera_from_exif(photo(**exif))
    assert np.allclose(camera.K, [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
    assert camera.source == "exif: focal plane resolution"
    assert not camera.has_distortion


@pytest.mark.parametrize("tag,unit_mm", [(2, 25.4), (3, 10.0), (4, 1.0), (5, 0.001), (None, 25.4)])
def test_unit_of_the_focal_plane_resolution(tmp_path, tag, unit_mm):
    tags = PIL.Image.Exif()
    ifd = tags.get_ifd(0x8769)
    ifd[0x920A], ifd[0xA20E], ifd[0xA20F] = 24.0, 25.0 * unit_mm, 25.0 * unit_mm
    if tag is not None:
        ifd[0xA210] = tag
    PIL.Image.new("RGB", SIZE).save(tmp_path / "a.jpg", exif=tags)
    assert camera_from_exif(read_image(tmp_path / "a.jpg")).K[0, 0] == pytest.approx(
        24 * 25, rel=1e-3
    )


@pytest.mark.parametrize("size", [(600, 400), (640, 480), (480, 640), (1920, 1080)])
def test_35_mm_equivalent_keeps_the_diagonal_angle(size):
    camera = camera_from_exif(photo(size, focal_35mm=28.0))
    angle = 2 * math.atan(math.hypot(*size) / 2 / camera.K[0, 0])
    assert angle == pytest.approx(2 * math.atan(math.hypot(36, 24) / 2 / 28))
    assert "by the diagonal" in camera.source
    if size == (600, 400):  # the shape of film, where diagonal and width agree
        assert camera.K[0, 0] == pytest.approx(28 / 36 * 600)


def test_sensor_table():
    camera = camera_from_exif(photo((4000, 3000), make="DJI", model="FC300X", focal_mm=3.61))
    assert camera.K[0, 0] == pytest.approx(3.61 / 6.17 * 4000)
    assert "6.17 mm wide sensor of FC300X" in camera.source
    for make, model in (
        ("Canon", "Canon EOS 5D Mark II"),
        ("NIKON CORPORATION", "NIKON D800"),
        ("SONY", "ILCE-7R"),
        ("Apple", "iPhone 6"),
        ("OLYMPUS CORPORATION", "E-M1"),
        ("Hasselblad", "L1D-20c"),
    ):
        assert sensor_width(make, model), (make, model)
    assert sensor_width(None, None) is None
    assert sensor_width("ACME", "FC300X") is None
    assert all(4 < width <= 36 for width in SENSOR_WIDTH_MM.values())
    assert all(sensor_width(*name.split(" ", 1)) for name in SENSOR_WIDTH_MM)


@pytest.mark.parametrize(
    "exif",
    [
        {"focal_mm": 50.0, "focal_plane_resolution": (60.0, 60.0)},
        {"focal_35mm": 35.0},
        {"make": "Nikon", "model": "D800", "focal_mm": 50.0},
    ],
)
def test_focal_length_scales_with_the_image(exif):
    full = camera_from_exif(photo((3600, 2400), size_wh=(3600, 2400), **exif))
    half = camera_from_exif(photo((1800, 1200), size_wh=(3600, 2400), **exif))
    upright = camera_from_exif(photo((1200, 1800), size_wh=(3600, 2400), **exif))
    swapped = camera_from_exif(photo((1800, 1200), size_wh=(2400, 3600), **exif))
    assert full.K[0, 0] == pytest.approx(2 * half.K[0, 0])
    assert np.allclose(half.K, full.scaled((1800, 1200)).K)
    assert half.K[0, 0] == pytest.approx(upright.K[0, 0]) == pytest.approx(swapped.K[0, 0])
    assert upright.size_wh == (1200, 1800)
    assert np.allclose(upright.K[:2, 2], (599.5, 899.5))


def test_cropped_photograph_warns():
    with pytest.warns(CameraWarning, match="cropped"):
        camera_from_exif(photo((600, 200), size_wh=(6000, 4000), focal_35mm=35.0))


@pytest.mark.parametrize(
    "exif",
    [
        {},
        {"focal_mm": 50.0},
        {"focal_mm": 4.0, "make": "ACME", "model": "X"},
        {"focal_mm": 4.0, "focal_plane_resolution": (0.01, 0.01)},
        {"focal_35mm": 65535.0},
    ],
)
def test_without_usable_exif_a_loud_guess(exif):
    with pytest.warns(CameraWarning, match="GUESSED as 768 px"):
        camera = camera_from_exif(photo(**exif))
    assert camera.source == "guessed"
    assert camera.K[0, 0] == 1.2 * 640


def test_nonsense_is_passed_over_for_the_next_best():
    camera = camera_from_exif(
        photo(focal_mm=4.0, focal_plane_resolution=(0.01, 0.01), focal_35mm=28.0)
    )
    assert "28 mm equivalent" in camera.source


@pytest.mark.data
def test_phantom_3_photographs(data_dir):
    """By the diagonal 1387 px; the nominal sensor says 1404 px; GPS baselines and height above
    ground 1.39-1.48e3."""
    for path in sorted((data_dir / "uav" / "toledo-p3pro").glob("*.JPG")):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            camera = camera_from_exif(read_image(path))
        assert camera.size_wh == (2400, 1800)
        assert camera.K[0, 0] == pytest.approx(1386.7, abs=0.1)
        assert camera.K[0, 0] == pytest.approx(3.61 / 6.17 * 2400, rel=0.02)


# --- sources that disagree


def resized_canon(path, size_in_exif):
    """A photograph of 5616 pixels, reduced to 1404 by an editor that kept the focal plane."""
    im = PIL.Image.new("RGB", (1404, 936), "grey")
    tags = im.getexif()
    tags[0x10F], tags[0x110] = "Canon", "Canon EOS 5D Mark II"
    sub = tags.get_ifd(0x8769)
    sub.update({0x920A: IFDRational(50, 1), 0xA405: 50, 0xA210: 2})
    sub.update({0xA20E: IFDRational(5616000, 1459), 0xA20F: IFDRational(3744000, 958)})
    if size_in_exif:
        sub[0xA002], sub[0xA003] = size_in_exif
    im.save(path, exif=tags)
    return read_image(path)


@pytest.mark.parametrize("size_in_exif", [(1404, 936), None])
def test_focal_plane_of_the_full_size_in_a_reduced_photograph(tmp_path, size_in_exif):
    image = resized_canon(tmp_path / "a.jpg", size_in_exif)
    with pytest.warns(CameraWarning, match="disagree.*focal plane resolution 7577 px.*1950 px"):
        camera = camera_from_exif(image)
    assert camera.K[0, 0] == pytest.approx(1950, rel=1e-3)
    assert camera.source == (
        "exif: 50 mm equivalent, by the diagonal; focal plane resolution disagrees"
    )


def test_focal_plane_scales_with_the_size_that_exif_states(tmp_path):
    image = resized_canon(tmp_path / "a.jpg", (5616, 3744))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = camera_from_exif(image)
    assert camera.source == "exif: focal plane resolution"
    assert camera.K[0, 0] == pytest.approx(7577 / 4, rel=1e-3)


@pytest.mark.parametrize("factor", [0.3, 0.8, 1.25, 3.0])
def test_two_sources_that_disagree(factor):
    """The one that does not depend on the size is taken; the doubt is part of the uncertainty."""
    equivalent = 28 / math.hypot(36, 24) * math.hypot(*SIZE)
    exif = {"focal_mm": 10.0, "focal_35mm": 28.0, "focal_plane_resolution": (1.0, 1.0)}
    exif["focal_plane_resolution"] = (factor * equivalent / 10,) * 2
    with pytest.warns(CameraWarning, match="resized, cropped or zoomed"):
        camera = camera_from_exif(photo(**exif))
    assert camera.K[0, 0] == pytest.approx(equivalent)
    assert camera.uncertainty.focal >= abs(math.log(factor)) / 2


def test_a_third_source_decides():
    """The sensor's width speaks for the focal plane: here the 35 mm equivalent is wrong."""
    exif = {"make": "Canon", "model": "EOS 5D Mark II", "focal_mm": 50.0, "focal_35mm": 80.0}
    plane = 3000 / 36.5
    with pytest.warns(CameraWarning, match="disagree"):
        camera = camera_from_exif(
            photo((3000, 2000), focal_plane_resolution=(plane, plane), **exif)
        )
    assert camera.K[0, 0] == pytest.approx(50 * plane)
    assert camera.uncertainty.focal == 0.03


@pytest.mark.parametrize("included", [True, False])
def test_digital_zoom(included):
    """The 35 mm equivalent of some makers includes the zoom, that of others does not."""
    exif = {"make": "DJI", "model": "FC300X", "focal_mm": 3.61, "digital_zoom": 2.0}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = camera_from_exif(
            photo((4000, 3000), focal_35mm=40.0 if included else 20.0, **exif)
        )
    assert camera.K[0, 0] == pytest.approx(2 * 20 / math.hypot(36, 24) * 5000)
    alone = camera_from_exif(photo((4000, 3000), **exif))
    assert alone.K[0, 0] == pytest.approx(2 * 3.61 / 6.17 * 4000)


def test_calibrated_focal_length_of_a_drone():
    exif = {"make": "DJI", "model": "FC6310", "focal_mm": 8.8, "calibrated_focal_px": 3666.67}
    camera = camera_from_exif(photo((2736, 1824), size_wh=(5472, 3648), **exif))
    assert camera.K[0, 0] == pytest.approx(3666.67 / 2)
    assert "calibrated" in camera.source
    with pytest.warns(CameraWarning, match="disagree"):  # reduced, and the size overwritten
        camera = camera_from_exif(photo((2736, 1824), size_wh=(2736, 1824), **exif))
    assert camera.K[0, 0] == pytest.approx(8.8 / 13.2 * 2736)


def test_numbers_in_pixels_without_a_size_warn():
    with pytest.warns(CameraWarning, match="wrong if the photograph was resized"):
        camera_from_exif(photo(focal_mm=24.0, focal_plane_resolution=(25.0, 25.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera_from_exif(photo(focal_mm=24.0, focal_plane_resolution=(25.0, 25.0), size_wh=SIZE))
