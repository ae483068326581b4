"""Given intrinsics: files of every kind, and images of other sizes and layouts."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from sfmkit.errors import CameraError
from sfmkit.io.calibration import Calibration
from sfmkit.io.cameras import CameraWarning
from sfmkit.io.intrinsics import fit_intrinsics, parse_intrinsics, turned
from sfmkit.types import Camera

SIZE = (640, 480)
K = np.array([[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]])


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


def test_camera_files_and_json_scale_with_the_image(tmp_path):
    files = [camera_file(tmp_path / "a.camera"), tmp_path / "K.json"]
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
        ("", "no file"),
    ],
)
def test_texts_that_are_not_cameras(text, message):
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
            b'{"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "distortion": [[1, 2], [3, 4]]}',
            "list of numbers",
        ),
    ],
)
def test_files_that_are_not_cameras(tmp_path, content, message):
    (tmp_path / "K.txt").write_bytes(content)
    with pytest.raises(CameraError, match=message):
        parse_intrinsics(tmp_path / "K.txt", SIZE)


def test_the_unit_of_the_focal_length():
    with pytest.warns(CameraWarning, match="in pixels"):
        parse_intrinsics("3.61,3.61,319.5,239.5", SIZE)


def camera_file(path: Path) -> Path:
    path.write_text("500 0 319.5\n0 510 239.5\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n640 480\n")
    return path


def read(tmp_path: Path, text: str, size_wh=SIZE, **options) -> Camera:
    (tmp_path / "K.txt").write_text(text, encoding="utf-8")
    return parse_intrinsics(tmp_path / "K.txt", size_wh, **options)


def quiet(tmp_path: Path, text: str, size_wh=SIZE, **options) -> Camera:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read(tmp_path, text, size_wh, **options)


# --- nine numbers and decimal commas


@pytest.mark.parametrize(
    "text",
    [
        "[[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]]",
        "500;0;319.5;0;510;239.5;0;0;1",
        "500,0,319.5,0,510,239.5,0,0,1",
        "[500 0 319.5; 0 510 239.5; 0 0 1]",
        "500 0 0 0 510 0 319.5 239.5 1",
        "500 0 0\n0 510 0\n319.5 239.5 1",
    ],
)
def test_nine_numbers_are_a_matrix(tmp_path, text):
    assert np.array_equal(quiet(tmp_path, text).K, K)


def test_nine_numbers_with_skew(tmp_path):
    camera = quiet(tmp_path, "[500 0.3 319.5; 0 510 239.5; 0 0 1]")
    assert camera.K[0, 1] == 0.3
    assert not camera.has_distortion


@pytest.mark.parametrize("text", ["520,5 521,5 319,5 239,5", "520,5 319,5", "520,5;0,0;319,5"])
def test_decimal_commas_are_refused(tmp_path, text):
    with pytest.raises(CameraError, match="commas inside its numbers"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    "text,message",
    [
        ("520,5,319,239", "not those of one lens"),
        ("520.5,0.3,319.5,239.5", "not those of one lens"),
        ("500,510,319.5,239.5,521.5", "moves the edge of the image by"),
        ("500,510,319.5,239.5,0,-90", "moves the edge of the image by"),
    ],
)
def test_numbers_that_no_lens_has(text, message):
    with pytest.raises(CameraError, match=message):
        parse_intrinsics(text, SIZE)


@pytest.mark.parametrize(
    "text,message",
    [
        ("500,600,319.5,239.5", "fy 600"),
        ("500,510,260,239.5", "far from the centre"),
        ("500,510,319.5,239.5,-1.5", "edge of the image by 61%"),
    ],
)
def test_numbers_that_hardly_any_lens_has(text, message):
    with pytest.warns(CameraWarning, match=message):
        parse_intrinsics(text, SIZE)


def test_strong_distortion_of_long_and_wide_lenses_is_usual(tmp_path):
    for text in ("500,510,319.5,239.5,-0.35,0.12", "6000,6000,319.5,239.5,-2,150"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            parse_intrinsics(text, SIZE)


# --- formats of other programs

D = np.array([-0.1, 0.01, 0.001, -0.002, 0.05])


@pytest.mark.parametrize("suffix", ["yml", "json"])
def test_files_that_opencv_writes(tmp_path, suffix):
    path = tmp_path / f"K.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Thu Nov 26 02:00:00 2026")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", D[:, None])
    storage.release()
    camera = parse_intrinsics(path, SIZE)
    assert np.array_equal(camera.K, K)
    assert np.array_equal(camera.distortion, D)
    with pytest.warns(CameraWarning, match="scaled"):
        assert parse_intrinsics(path, (320, 240)).K[0, 0] == 250


ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0.0, 319.5, 0.0, 510.0, 239.5, 0.0, 0.0, 1.0]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {n}
  data: {d}
"""
CAMERA_INFO = """header:
  frame_id: camera
height: 480
width: 640
distortion_model: plumb_bob
D: [-0.1, 0.01, 0.001, -0.002, 0.05]
K: [500.0, 0.0, 319.5, 0.0, 510.0, 239.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
"""
KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.01, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [500.0, 510.0, 319.5, 239.5]
  resolution: [640, 480]
"""


@pytest.mark.parametrize(
    "text,model,distortion",
    [
        (ROS.format(model="plumb_bob", n=5, d=D.tolist()), "opencv", D),
        (
            ROS.format(model="rational_polynomial", n=8, d=[*D.tolist(), 0.1, 0.2, 0.3]),
            "opencv",
            [*D, 0.1, 0.2, 0.3],
        ),
        (
            ROS.format(model="equidistant", n=4, d=[0.1, 0.2, 0.3, 0.4]),
            "fisheye",
            [0.1, 0.2, 0.3, 0.4],
        ),
        (CAMERA_INFO, "opencv", D),
        (CAMERA_INFO.lower(), "opencv", D),
        (KALIBR, "opencv", [*D[:4], 0]),
    ],
)
def test_files_of_ros_and_kalibr(tmp_path, text, model, distortion):
    camera = quiet(tmp_path, text)
    assert np.array_equal(camera.K, K)
    assert camera.model == model
    assert np.array_equal(camera.distortion, distortion)


MATLAB = """
  cameraIntrinsics with properties:

             FocalLength: [500 510]
          PrincipalPoint: [320.5000 240.5000]
               ImageSize: [480 640]
        RadialDistortion: [-0.1000 0.0100 0.0500]
    TangentialDistortion: [1.0000e-03 -0.0020]
                    Skew: 0
                       K: [3×3 double]
"""


def test_text_of_matlab(tmp_path):
    """MATLAB counts pixels from 1 and gives rows before columns."""
    camera = quiet(tmp_path, MATLAB)
    assert np.array_equal(camera.K, K)
    assert np.array_equal(camera.distortion, D)
    with pytest.raises(CameraError, match=r"\.mat file"):
        read(tmp_path, "MATLAB 5.0 MAT-file, Platform: GLNXA64")


def test_cameras_of_colmap(tmp_path):
    text = "# Camera list\n1 OPENCV 640 480 500 510 320 240 -.1 .01 .001 -.002\n"
    camera = quiet(tmp_path, text)
    assert np.array_equal(camera.K, K)
    assert np.array_equal(camera.distortion, [*D[:4], 0])
    two = text + "2 PINHOLE 800 600 700 700 400 300\n"
    assert quiet(tmp_path, two).K[0, 0] == 500
    assert quiet(tmp_path, two, (800, 600)).K[0, 0] == 700
    with pytest.raises(CameraError, match="2 cameras, 0 of them for 320 x 240"):
        read(tmp_path, two, (320, 240))
    with pytest.raises(CameraError, match="line 1: PINHOLE has 4 parameters"):
        read(tmp_path, "1 PINHOLE 640 480 500\n")


@pytest.mark.parametrize(
    "text,message",
    [
        ('{"K":[[' + "9" * 300 + ",0,320],[0,500,240],[0,0,1]]}", "scale|one lens|must be"),
        ('{"K":[[' + "9" * 400 + ",0,320],[0,500,240],[0,0,1]]}", "must be numbers"),
        ('{"K":[[' + "9" * 5000 + ",0,320],[0,500,240],[0,0,1]]}", "not valid JSON"),
        ('{"K":' + "[" * 100_000, "nested too deeply|not valid JSON"),
        ('{"K":' + "[" * 500 + "]" * 500 + "}", "must be numbers|3x3|nested"),
        ("K: " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("K: " + "9" * 5000, "not valid YAML|must be numbers"),
        ("a: &a [1, 2]\nK: *a", "aliases"),
        ("K: !!python/object/apply:os.system [ls]", "not valid YAML"),
        ("K: [1, 2", "not valid YAML"),
        ("? [a]\n: 1\nK: 3", 'not valid YAML|3x3|no "K"'),
        ("cam0:\n  K: [1]\ncam1:\n  K: [1]\n", "holds 2 cameras"),
        ("K: 1\n" + "# x\n" * 100_000, "larger than"),
        ("1 " * 600_000, "larger than"),
        (ROS.format(model="thin_prism_fisheye", n=1, d=[0]), "distortion model"),
    ],
)
def test_hostile_files(tmp_path, text, message):
    with pytest.raises(CameraError, match=message):
        read(tmp_path, text)


# --- images of other sizes and layouts


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("model", ["opencv", "fisheye"])
def test_turned_cameras_project_to_turned_pixels(orientation, model):
    """The scene turned like the picture: pixels move as EXIF 2.32 defines tag 0x0112."""
    d = [-0.1, 0.02, 0.003, -0.004, 0.01] if model == "opencv" else [0.1, -0.02, 0.003, 0.01]
    skew = 3.0 if orientation < 5 else 0.0
    stored = Camera(
        np.array([[500, skew, 300], [0, 510, 260], [0, 0, 1]]), SIZE, np.array(d), model=model
    )
    upright = turned(stored, orientation)
    X = np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 5], (20, 3))

    def project(camera: Camera, points: np.ndarray) -> np.ndarray:
        zero = np.zeros(3)
        if model == "fisheye":
            skew = camera.K[0, 1] / camera.K[0, 0]
            args = (points[:, None], zero, zero, camera.K, camera.distortion)
            return cv2.fisheye.projectPoints(*args, alpha=skew)[0][:, 0]
        normal = cv2.projectPoints(points, zero, zero, np.eye(3), camera.distortion)[0][:, 0]
        return normal @ camera.K[:2, :2].T + camera.K[:2, 2]

    x, Y = project(stored, X), X.copy()
    if orientation >= 5:
        x, Y = x[:, ::-1].copy(), Y[:, [1, 0, 2]]
    w, h = upright.size_wh
    if orientation in (2, 3, 6, 7):
        x[:, 0], Y[:, 0] = w - 1 - x[:, 0], -Y[:, 0]
    if orientation in (3, 4, 7, 8):
        x[:, 1], Y[:, 1] = h - 1 - x[:, 1], -Y[:, 1]
    assert (w, h) == (SIZE if orientation < 5 else SIZE[::-1])
    assert np.allclose(project(upright, Y), x, atol=1e-9)


FOUNTAIN = "689.87 0 379.8\n0 691.04 251.33\n0 0 1"  # at 768 x 512


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
@pytest.mark.parametrize("stated", [True, False])
def test_intrinsics_of_the_stored_pixels_are_turned(tmp_path, orientation, stated):
    rows = [[float(v) for v in row.split()] for row in FOUNTAIN.split("\n")]
    text = json.dumps({"K": rows, "size_wh": [768, 512]}) if stated else FOUNTAIN
    with pytest.warns(CameraWarning, match="pixels as stored; it was turned"):
        camera = read(tmp_path, text, (512, 768), orientation=orientation)
    expected = turned(Camera(np.array(rows), (768, 512)), orientation)
    assert np.array_equal(camera.K, expected.K)
    assert camera.K[0, 0] == 691.04
    with pytest.raises(CameraError, match=r"turned|is rotated"):
        read(tmp_path, text, (512, 768))  # without the tag nothing shows which way


def test_intrinsics_of_the_upright_pixels_stay(tmp_path):
    upright = "691.04 0 251.33\n0 689.87 379.8\n0 0 1"
    for orientation in (1, 5, 6, 7, 8):
        assert quiet(tmp_path, upright, (512, 768), orientation=orientation).K[0, 2] == 251.33


@pytest.mark.parametrize("orientation", [2, 3, 4])
def test_half_turns_are_named_where_they_matter(tmp_path, orientation):
    with pytest.warns(CameraWarning, match=f"orientation {orientation};.*as stored, the principal"):
        read(tmp_path, FOUNTAIN, (768, 512), orientation=orientation)
    quiet(tmp_path, "690 0 383.5\n0 690 255.5\n0 0 1", (768, 512), orientation=orientation)


@pytest.mark.parametrize("scale", [0.25, 0.5, 0.75, 1.5, 2, 4])
def test_intrinsics_of_another_size_are_refused(scale):
    c = (np.array(SIZE) * scale - 1) / 2
    text = f"{500 * scale},{500 * scale},{c[0]},{c[1]}"
    with pytest.raises(CameraError, match=r"another size.s K|far outside"):
        parse_intrinsics(text, SIZE)
    w, h = round(640 * scale), round(480 * scale)
    matrix = np.array([[500 * scale, 0, c[0]], [0, 500 * scale, c[1]], [0, 0, 1]])
    with pytest.raises(CameraError, match=r"another size.s K|far outside"):
        fit_intrinsics(Calibration(matrix), SIZE)
    with pytest.warns(CameraWarning, match="scaled"):
        camera = fit_intrinsics(Calibration(matrix, (w, h)), SIZE)
    assert np.allclose(camera.K, [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
