"""Cameras from EXIF and from text, and true poses."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from sfmkit.errors import CameraError, InputError
from sfmkit.io.cameras import CameraWarning, camera_from_exif, parse_intrinsics, read_truth
from sfmkit.io.exif import Exif
from sfmkit.io.images import Image, read_image
from sfmkit.io.sensors import SENSOR_WIDTH_MM, sensor_width

SIZE = (640, 480)
K = np.array([[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]])


def photo(size: tuple[int, int] = SIZE, **exif) -> Image:
    w, h = size
    return Image(
        np.zeros((h, w, 3), np.uint8),
        np.zeros((h, w), np.uint8),
        exif=Exif(**exif) if exif else None,
    )


# --- EXIF


def test_focal_plane_resolution_is_trusted_most():
    exif = {
        "focal_mm": 50.0,
        "focal_plane_resolution": (10.0, 10.0),
        "focal_35mm": 20.0,
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


# --- given intrinsics


@pytest.mark.parametrize(
    "text",
    [
        "500 0 319.5\n0 510 239.5\n0 0 1\n",
        "500,0,319.5\n0,510,239.5\n0,0,1",
        "# calibrated\r\n500 0 319.5 # fx\r\n\r\n0 510 239.5\r\n0 0 1",
        "[[500, 0, 319.5],\n [0, 510, 239.5],\n [0, 0, 1]]",
        "500; 0; 319.5\n0; 510; 239.5\n0; 0; 1",
        "500 0 319.5 0\n0 510 239.5 0\n0 0 1 0",
        "500 510 319.5 239.5",
        "500,510,319.5,239.5",
        "\ufeff500 510 319.5 239.5",
        json.dumps({"K": K.tolist()}),
        json.dumps({"K": K.tolist(), "size_wh": SIZE, "distortion": None, "R": [], "other": 1}),
    ],
)
def test_files(tmp_path, text):
    path = tmp_path / "K,1.txt"
    path.write_text(text, encoding="utf-8")
    for given in (path, str(path)):
        camera = parse_intrinsics(given, SIZE)
        assert np.array_equal(camera.K, K)
        assert camera.size_wh == SIZE
        assert camera.source == "given"
        assert not camera.has_distortion


def test_numbers_on_the_command_line():
    assert np.array_equal(parse_intrinsics("500, 510,319.5 ,239.5", SIZE).K, K)
    camera = parse_intrinsics("500,510,319.5,239.5,-0.1,0.01,1e-3,-2e-3,0.5", SIZE)
    assert camera.distortion.tolist() == [-0.1, 0.01, 1e-3, -2e-3, 0.5]
    assert parse_intrinsics("500,510,319.5,239.5,-0.1", SIZE).distortion.tolist() == [
        -0.1,
        0,
        0,
        0,
        0,
    ]


@pytest.mark.parametrize("text", ["24mm/36mm", "24 mm / 36 mm", "24.0mm/36.00mm"])
def test_millimetres(text):
    assert np.allclose(
        parse_intrinsics(text, SIZE).K, [[1280 / 3, 0, 319.5], [0, 1280 / 3, 239.5], [0, 0, 1]]
    )
    assert parse_intrinsics(text, SIZE[::-1]).K[0, 0] == pytest.approx(1280 / 3)


def test_distortion_in_files(tmp_path):
    for name, text in (
        ("K.txt", "500 0 319.5\n0 510 239.5\n0 0 1\n-0.1 0.01 0 0 0.5"),
        ("K.json", json.dumps({"K": K.tolist(), "distortion": [-0.1, 0.01, 0, 0, 0.5]})),
    ):
        (tmp_path / name).write_text(text)
        assert parse_intrinsics(tmp_path / name, SIZE).distortion.tolist() == [
            -0.1,
            0.01,
            0,
            0,
            0.5,
        ]


CAMERA_FILE = "500 0 319.5 \n0 510 239.5 \n0 0 1 \n0 0 0\n{} \n{} \n{} \n{} \n640 480"


def camera_file(path: Path, R: np.ndarray, C: np.ndarray) -> Path:
    path.write_text(CAMERA_FILE.format(*(" ".join(map(repr, row.tolist())) for row in (*R, C))))
    return path


def test_camera_files_and_json_scale_with_the_image(tmp_path):
    files = [camera_file(tmp_path / "a.camera", np.eye(3), np.zeros(3)), tmp_path / "K.json"]
    files[1].write_text(json.dumps({"K": K.tolist(), "size_wh": SIZE}))
    for path in files:
        assert np.array_equal(parse_intrinsics(path, SIZE).K, K)
        with pytest.warns(
            CameraWarning, match="for 640 x 480 pixels; .* scaled to the image's 320 x 240"
        ):
            camera = parse_intrinsics(path, (320, 240))
        assert np.allclose(camera.K, [[250, 0, 159.5], [0, 255, 119.5], [0, 0, 1]])
        with pytest.warns(CameraWarning):  # a size that only rounding keeps from the same shape
            parse_intrinsics(path, (213, 160))
        with pytest.raises(CameraError, match="turned"):
            parse_intrinsics(path, (480, 640))
        with pytest.raises(CameraError, match="cropped"):
            parse_intrinsics(path, (640, 400))


@pytest.mark.data
def test_strecha_files(data_dir):
    folder = data_dir / "strecha" / "fountain-P11"
    expected = [[2759.48, 0, 1520.69], [0, 2764.16, 1006.81], [0, 0, 1]]
    for path in (folder / "images" / "K.txt", folder / "gt_dense_cameras" / "0000.jpg.camera"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert np.array_equal(parse_intrinsics(path, (3072, 2048)).K, expected)


@pytest.mark.parametrize(
    "text,message",
    [
        ("0,0,0,0", "must be positive"),
        ("-500,500,320,240", "must be positive"),
        ("nan,500,320,240", "NaN"),
        ("500,inf,320,240", "NaN or infinite"),
        ("500,500,99999,240", "principal point"),
        ("500,500", r"holds 2 numbers; intrinsics are fx,fy,cx,cy"),
        ("1,2,3,4,5,6,7,8,9,10", "holds 10 numbers"),
        ("500,five hundred,320,240", "'five hundred' in .* is not a number"),
        ("500,500,,240", "'' in .* is not a number"),
        ("0mm/36mm", "must be positive"),
        ("24mm/0mm", "must be positive"),
        ("nanmm/36mm", "must be positive"),
        ("xmm/36mm", "'x' in .* is not a number"),
        ("no_such_file.txt", "no file 'no_such_file.txt'; intrinsics are fx,fy"),
        ("9" * 5000, "no file"),
        ("9," * 5000, "holds|not a number"),
        ("", "Is a directory"),
    ],
)
def test_texts_that_are_no_camera(text, message):
    with pytest.raises(CameraError, match=message):
        parse_intrinsics(text, SIZE)


@pytest.mark.parametrize(
    "content,message",
    [
        (b"", "a 3x3 matrix is needed"),
        (b"# nothing\n", "a 3x3 matrix is needed"),
        (b"500 0\n0 500\n", "a 3x3 matrix is needed"),
        (b"500 0 320\n0 500 240\n", "a 3x3 matrix is needed"),
        (b"500 0 320\n0 500\n0 0 1\n", "a 3x3 matrix is needed"),
        (b"500 0 320 7\n0 500 240 0\n0 0 1 0\n", "a projection"),
        (b"500 0 320\n0 500 240\n0 0 1\n1 2 3 4 5 6", "up to 5, or 8"),
        (b"500 0 320\n0 500 240\n0 0 2\n", "last row"),
        (b"0 0 0\n0 0 0\n0 0 0\n", "last row"),
        (b"500 0 320\n0 5OO 240\n0 0 1\n", "'5OO' in .* is not a number"),
        (b"nan 0 320\n0 500 240\n0 0 1\n", "NaN"),
        (b"\xff\xd8\xff\xe0\x00", "not a text file"),
        (b"{", "not valid JSON"),
        (b"{}", 'has no "K"'),
        (b'{"K": [[1, 2], [3]]}', "rows of one length"),
        (b'{"K": "x"}', "must be numbers"),
        (b'{"K": [[500, 0, 320], [0, 500, 240]]}', "3x3"),
        (
            b'{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "size_wh": [640]}',
            "two positive numbers",
        ),
        (
            b'{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "size_wh": [640, -480]}',
            "two positive numbers",
        ),
        (
            b'{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "size_wh": {"w": 1}}',
            "must be numbers",
        ),
        (
            b'{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "distortion": [[1, 2]]}',
            "up to 5, or 8",
        ),
    ],
)
def test_files_that_are_no_camera(tmp_path, content, message):
    (tmp_path / "K.txt").write_bytes(content)
    with pytest.raises(CameraError, match=message):
        parse_intrinsics(tmp_path / "K.txt", SIZE)


def test_intrinsics_for_another_size_or_unit_warn():
    with pytest.warns(CameraWarning, match="another size's K"):
        parse_intrinsics("1000,1000,639.5,479.5", SIZE)
    with pytest.warns(CameraWarning, match="in pixels"):
        parse_intrinsics("3.61,3.61,319.5,239.5", SIZE)


# --- true poses


def rotation(axis: list[float], degrees: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    W, a = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), math.radians(degrees)
    return np.eye(3) + math.sin(a) * W + (1 - math.cos(a)) * W @ W


def test_truth_from_camera_files_moves_points_from_one_camera_to_the_other(tmp_path):
    R1, R2 = rotation([1, 2, 3], 40), rotation([3, -1, 0.5], 65)
    C1, C2 = np.array([1.0, -2, 0.5]), np.array([-3.0, 0.7, 2])
    a = camera_file(tmp_path / "1.jpg.camera", R1, C1)
    b = camera_file(tmp_path / "2.jpg.camera", R2, C2)
    X = np.random.default_rng(0).normal(size=(5, 3))
    X1, X2 = (X - C1) @ R1, (X - C2) @ R2  # x_cam = R^T (X - C)
    for source, images in ((f"{a},{b}", ()), (tmp_path, ("x/1.jpg", Path("2.jpg")))):
        R, t = read_truth(source, *images)
        assert np.allclose(X2, X1 @ R.T + t)


def test_truth_from_json(tmp_path):
    R = rotation([0, 1, 0], 10)
    (tmp_path / "truth.json").write_text(
        json.dumps({"K": K.tolist(), "R": R.tolist(), "t": [1, 0, 0.2]})
    )
    assert np.array_equal(read_truth(tmp_path / "truth.json")[0], R)
    assert read_truth(tmp_path / "truth.json")[1].tolist() == [1, 0, 0.2]


@pytest.mark.parametrize(
    "content,message",
    [
        ("{}", "must hold"),
        ("[1]", "must hold"),
        ("x", "not valid JSON"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,-1]], "t": [1,0,0]}', "no rotation"),
        ('{"R": [[2,0,0],[0,1,0],[0,0,1]], "t": [1,0,0]}', "no rotation"),
        ('{"R": [[1,0],[0,1]], "t": [1,0,0]}', "no rotation"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": [1,0]}', "three finite numbers"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": [1,0,NaN]}', "three finite numbers"),
        ('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": "left"}', "must be numbers"),
    ],
)
def test_files_that_are_no_truth(tmp_path, content, message):
    (tmp_path / "t.json").write_text(content)
    with pytest.raises(InputError, match=message):
        read_truth(tmp_path / "t.json")


def test_truth_that_is_not_there(tmp_path):
    good = camera_file(tmp_path / "a.camera", np.eye(3), np.zeros(3))
    (tmp_path / "b.camera").write_text("1 2 3\n")
    for source, images, message in (
        (tmp_path / "none.json", (), "no file"),
        (f"{good},{tmp_path / 'none.camera'}", (), r"no file .*none\.camera"),
        (f"{good},{tmp_path / 'b.camera'}", (), r"b\.camera is no \.camera file"),
        (f"{good},{good},{good}", (), "names 3 files"),
        (tmp_path, (), "the names of both images are needed"),
        (tmp_path, ("1.jpg", "2.jpg"), r"no file .*1\.jpg\.camera"),
    ):
        with pytest.raises(InputError, match=message):
            read_truth(source, *images)


@pytest.mark.data
def test_strecha_truth_puts_the_matrices_of_both_views_in_one_frame(data_dir):
    """The fountain's cameras stand on an arc: each turns by a few degrees towards the same
    scene."""
    folder = data_dir / "strecha" / "fountain-P11" / "gt_dense_cameras"
    R, t = read_truth(folder, "0000.jpg", "0001.jpg")
    same = read_truth(f"{folder / '0000.jpg.camera'},{folder / '0001.jpg.camera'}")
    assert np.array_equal(R, same[0])
    back_R, back_t = read_truth(folder, "0001.jpg", "0000.jpg")
    assert np.allclose(back_R, R.T, atol=1e-5)
    assert np.allclose(back_t, -R.T @ t, atol=1e-4)
    assert 1 < math.degrees(math.acos((np.trace(R) - 1) / 2)) < 20
