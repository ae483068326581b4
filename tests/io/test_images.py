"""Reading photographs: every kind that works, every kind that is refused."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
from PIL import ImageOps

from sfmkit.errors import ImageError
from sfmkit.io.images import MAX_PIXELS, Exif, Image, read_image

W, H = 61, 43


@pytest.fixture(scope="module")
def rgb() -> np.ndarray:
    rng = np.random.default_rng(1)
    return cv2.GaussianBlur(rng.integers(0, 256, (H, W, 3), dtype=np.uint8), (0, 0), 1.5)


def _save(path: Path, pixels: np.ndarray, **options) -> Path:
    PIL.Image.fromarray(pixels).save(path, **options)
    return path


def _png(w: int, h: int) -> bytes:
    """A PNG that claims to be w x h pixels and holds next to nothing."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", w, h, 8, 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


# --- what works


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp", "ppm"])
def test_lossless_rgb_keeps_every_value(tmp_path, rgb, suffix):
    path = _save(tmp_path / f"a.{suffix}", rgb)
    image = read_image(path)
    assert np.array_equal(image.rgb, rgb)
    assert np.array_equal(image.grey, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
    assert np.abs(image.grey.astype(int) - cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)).max() <= 1
    assert image.size_wh == (W, H)
    assert image.path == path
    assert image.name == f"a.{suffix}"


@pytest.mark.parametrize(
    "options", [{"quality": 90}, {"quality": 60, "progressive": True}, {"subsampling": 0}]
)
def test_jpeg_is_decoded_as_pillow_does(tmp_path, rgb, options):
    path = _save(tmp_path / "a.jpg", rgb, **options)
    image = read_image(path)
    assert np.array_equal(image.rgb, np.asarray(PIL.Image.open(path)))
    assert np.abs(image.grey.astype(int) - cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)).max() <= 1


def test_sixteen_bit_keeps_the_high_byte(tmp_path, rgb):
    deep = rgb.astype(np.uint16) * 256 + np.random.default_rng(2).integers(
        0, 256, rgb.shape, dtype=np.uint16
    )
    for suffix in ("png", "tif"):
        assert cv2.imwrite(str(tmp_path / f"rgb.{suffix}"), deep[..., ::-1])
        assert cv2.imwrite(str(tmp_path / f"grey.{suffix}"), deep[..., 0])
        assert np.array_equal(read_image(tmp_path / f"rgb.{suffix}").rgb, rgb)
        assert np.array_equal(read_image(tmp_path / f"grey.{suffix}").grey, rgb[..., 0])
    assert np.array_equal(read_image(deep).rgb, rgb)


def test_alpha_is_dropped(tmp_path, rgb):
    alpha = np.random.default_rng(3).integers(0, 256, (H, W, 1), dtype=np.uint8)
    rgba = np.concatenate([rgb, alpha], -1)
    assert np.array_equal(read_image(_save(tmp_path / "rgba.png", rgba)).rgb, rgb)
    la = PIL.Image.fromarray(rgb[..., 0]).copy()
    la.putalpha(PIL.Image.fromarray(alpha[..., 0]))
    la.save(tmp_path / "la.png")
    assert np.array_equal(read_image(tmp_path / "la.png").grey, rgb[..., 0])
    assert np.array_equal(read_image(rgba).rgb, rgb)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_grey_is_three_equal_channels(tmp_path, rgb, suffix):
    path = _save(tmp_path / f"g.{suffix}", rgb[..., 0])
    image = read_image(path)
    assert np.array_equal(image.grey, np.asarray(PIL.Image.open(path)))
    assert all(np.array_equal(image.rgb[..., c], image.grey) for c in range(3))


def test_palette_and_bilevel_and_cmyk(tmp_path, rgb):
    picture = PIL.Image.fromarray(rgb)
    picture.quantize(64).save(tmp_path / "p.png")
    expected = np.asarray(picture.quantize(64).convert("RGB"))
    assert np.array_equal(read_image(tmp_path / "p.png").rgb, expected)
    picture.convert("1").save(tmp_path / "b.png")
    assert set(np.unique(read_image(tmp_path / "b.png").grey)) == {0, 255}
    for name in ("c.tif", "c.jpg"):
        picture.convert("CMYK").save(
            tmp_path / name, **({"quality": 98} if name == "c.jpg" else {})
        )
        difference = np.abs(read_image(tmp_path / name).rgb.astype(int) - rgb)
        assert difference.mean() < 2


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_orientation_is_applied_and_reported(tmp_path, rgb, orientation, suffix):
    tags = PIL.Image.Exif()
    tags[0x0112] = orientation
    path = _save(tmp_path / f"o.{suffix}", rgb, exif=tags)
    image = read_image(path)
    assert np.array_equal(image.rgb, np.asarray(ImageOps.exif_transpose(PIL.Image.open(path))))
    assert image.size_wh == ((W, H) if orientation < 5 else (H, W))
    assert image.grey.shape == image.rgb.shape[:2]
    assert image.exif.orientation == orientation
    assert image.exif.stored_wh == (W, H)


@pytest.mark.parametrize("size", [(1, 1), (40_000, 3), (2, 40_000)])
def test_extreme_shapes_are_read(tmp_path, size):
    pixels = np.random.default_rng(4).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    assert np.array_equal(read_image(_save(tmp_path / "x.png", pixels)).rgb, pixels)
    jpeg = _save(tmp_path / "x.jpg", pixels)
    assert np.array_equal(read_image(jpeg).rgb, np.asarray(PIL.Image.open(jpeg)))


def test_pictures_beyond_pillows_own_limit_are_read_without_a_warning(tmp_path):
    path = tmp_path / "large.png"
    PIL.Image.new("1", (10_000, 9_000)).save(path)
    before = PIL.Image.MAX_IMAGE_PIXELS
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_image(path).size_wh == (10_000, 9_000)
    assert before == PIL.Image.MAX_IMAGE_PIXELS


def test_arrays(rgb):
    assert np.array_equal(read_image(rgb).rgb, rgb)
    assert np.array_equal(read_image(rgb[..., :1]).grey, rgb[..., 0])
    assert np.array_equal(read_image(rgb / 255).rgb, rgb)
    assert np.array_equal(read_image(rgb[:, ::-1]).rgb, rgb[:, ::-1])
    image = read_image(rgb)
    assert read_image(image) is image
    assert image.exif is None
    assert repr(image) == "Image(array, 61 x 43)"


def test_many_threads_read_at_once(tmp_path, rgb):
    path = _save(tmp_path / "a.png", rgb)
    before = PIL.Image.MAX_IMAGE_PIXELS
    with ThreadPoolExecutor(8) as pool:
        assert all(np.array_equal(i.rgb, rgb) for i in pool.map(read_image, [path] * 64))
    assert before == PIL.Image.MAX_IMAGE_PIXELS


# --- what is refused


def test_missing_file_suggests_near_names(tmp_path, rgb):
    _save(tmp_path / "DSC_0041.JPG", rgb)
    with pytest.raises(ImageError, match=r"no file .*DSC_0014.jpg.*Did you mean DSC_0041.JPG"):
        read_image(tmp_path / "DSC_0014.jpg")
    with pytest.raises(ImageError, match="holds 1 images, e"):
        read_image(tmp_path / "quite different")
    with pytest.raises(ImageError, match="Nor is there a folder"):
        read_image(tmp_path / "nowhere" / "a.jpg")


def test_folder(tmp_path, rgb):
    with pytest.raises(ImageError, match="is a directory without images"):
        read_image(tmp_path)
    _save(tmp_path / "a.png", rgb)
    with pytest.raises(
        ImageError, match=r"is a directory; name one of its 1 images, e.g. .*a\.png"
    ):
        read_image(tmp_path)


def test_empty_file(tmp_path):
    (tmp_path / "a.jpg").touch()
    with pytest.raises(ImageError, match="is empty"):
        read_image(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    "suffix,options", [("jpg", {}), ("jpg", {"progressive": True}), ("png", {}), ("tif", {})]
)
@pytest.mark.parametrize("keep", [0.5, 0.9, -1])
def test_cut_off_files(tmp_path, rgb, suffix, options, keep):
    whole = io.BytesIO()
    PIL.Image.fromarray(rgb).save(
        whole, {"jpg": "JPEG", "tif": "TIFF"}.get(suffix, suffix.upper()), **options
    )
    data = whole.getvalue()
    cut = int(len(data) * keep) if keep > 0 else len(data) - 1
    if suffix == "png" and keep < 0:
        pytest.skip("the last byte of a PNG is a checksum of an empty chunk: no pixel is missing")
    (tmp_path / f"a.{suffix}").write_bytes(data[:cut])
    with pytest.raises(ImageError, match=r"truncated|cannot be decoded"):
        read_image(tmp_path / f"a.{suffix}")


def test_text_and_rubbish_named_png(tmp_path):
    (tmp_path / "text.png").write_text("not a picture\n" * 20)
    with pytest.raises(ImageError, match="is a text file"):
        read_image(tmp_path / "text.png")
    (tmp_path / "rubbish.png").write_bytes(np.random.default_rng(5).bytes(1000))
    with pytest.raises(ImageError, match="not an image of a known kind"):
        read_image(tmp_path / "rubbish.png")


def test_decompression_bomb(tmp_path):
    (tmp_path / "bomb.png").write_bytes(_png(100_000, 100_000))
    with pytest.raises(ImageError, match="100,000 x 100,000 pixels; at most 500 megapixels"):
        read_image(tmp_path / "bomb.png")
    with pytest.raises(ImageError, match="at most 500 megapixels"):
        read_image(np.broadcast_to(np.uint8(0), (MAX_PIXELS // 1000 + 1, 1000)))


def test_no_pixels(tmp_path):
    (tmp_path / "none.png").write_bytes(_png(0, 10))
    with pytest.raises(ImageError):
        read_image(tmp_path / "none.png")
    with pytest.raises(ImageError, match="no pixels"):
        read_image(np.zeros((0, 5, 3), np.uint8))


@pytest.mark.parametrize(
    "array,message",
    [
        (np.full((4, 4), np.nan), "NaN"),
        (np.full((4, 4, 3), 2.0), r"must lie in \[0, 1\]"),
        (np.zeros((4, 4, 2), np.uint8), "must have shape"),
        (np.zeros(4, np.uint8), "must have shape"),
        (np.zeros((2, 4, 4, 3), np.uint8), "must have shape"),
        (np.zeros((4, 4), np.int64), "must be uint8"),
        (np.zeros((4, 4), complex), "must be uint8"),
        ([[0, 1]], "a path or a NumPy array, not list"),
        (None, "a path or a NumPy array, not NoneType"),
    ],
)
def test_arrays_that_are_no_image(array, message):
    with pytest.raises(ImageError, match=message):
        read_image(array)


def test_a_name_no_file_can_have():
    with pytest.raises(ImageError, match="cannot be read"):
        read_image("a\0b.png")


def test_image_checks_itself(rgb):
    with pytest.raises(ImageError, match=r"Image\.grey"):
        Image(rgb, rgb[..., 0].T)
    with pytest.raises(ImageError, match=r"Image\.rgb"):
        Image(rgb[..., :2], rgb[..., 0])


# --- EXIF


def test_exif_without_use_counts_as_nothing(tmp_path, rgb):
    tags = PIL.Image.Exif()
    tags[0x0112] = 11
    tags[0x010F] = "ACME\0\0\0"
    tags.get_ifd(0x8769)[0x920A] = 0.0
    image = read_image(_save(tmp_path / "a.jpg", rgb, exif=tags))
    assert image.exif == Exif(make="ACME", stored_wh=(W, H))
    assert read_image(_save(tmp_path / "b.jpg", rgb)).exif is None


@pytest.mark.filterwarnings("ignore::UserWarning:PIL")
def test_damaged_exif_does_not_stop_the_picture(tmp_path, rgb):
    tags = PIL.Image.Exif()
    tags[0x0112] = 3
    tags[0x010F] = "ACME"
    block = tags.tobytes()
    for k in range(8, len(block)):
        damaged = block[:k] + b"\xff" * (len(block) - k)
        image = read_image(_save(tmp_path / "a.jpg", rgb, exif=damaged))
        assert image.size_wh == (W, H)


@pytest.mark.data
def test_phantom_3_exif(data_dir):
    image = read_image(data_dir / "uav" / "toledo-p3pro" / "1JI_0064.JPG")
    exif = image.exif
    assert (exif.make, exif.model, exif.focal_mm, exif.focal_35mm) == ("DJI", "FC300X", 3.61, 20)
    assert image.size_wh == (2400, 1800)
