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
from sfmkit.io.exif import Exif
from sfmkit.io.images import MAX_PIXELS, Image, read_image
from sfmkit.io.pixels import ImageWarning

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
@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp"])
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


def turned(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """The upright pixels by the definition of tag 0x0112: where row 0 and column 0 are."""
    if orientation >= 5:  # row 0 is a side
        pixels = pixels.swapaxes(0, 1)
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return pixels[::rows, ::columns]


def deep_tiff(pixels: np.ndarray, orientation: int) -> bytes:
    """An uncompressed 16-bit TIFF, written from the TIFF 6.0 specification."""
    h, w = pixels.shape[:2]
    count = pixels.size // (h * w)
    body, bits = pixels.astype("<u2").tobytes(), struct.pack(f"<{count}H", *[16] * count)
    tags = {
        256: (3, 1, w),
        257: (3, 1, h),
        258: (3, count, 16),
        259: (3, 1, 1),
        262: (3, 1, 2 if count == 3 else 1),
        273: (4, 1, 0),
        274: (3, 1, orientation),
        277: (3, 1, count),
        278: (3, 1, h),
        279: (4, 1, len(body)),
    }
    after = 8 + 2 + 12 * len(tags) + 4
    tags[273] = (4, 1, after + len(bits))
    if count > 1:
        tags[258] = (3, count, after)
    directory = b"".join(struct.pack("<HHII", tag, *entry) for tag, entry in tags.items())
    header = b"II*\0" + struct.pack("<IH", 8, len(tags))
    return header + directory + bytes(4) + bits + body


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_adobe_deflate", "packbits"])
def test_tiff_is_turned_once(tmp_path, rgb, orientation, compression):
    path = _save(tmp_path / "o.tif", rgb, tiffinfo={274: orientation}, compression=compression)
    image = read_image(path)
    assert np.array_equal(image.rgb, turned(rgb, orientation))
    assert image.exif.orientation == orientation
    assert image.exif.stored_wh == (W, H)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("channels", [1, 3])
def test_deep_tiff_is_turned_once(tmp_path, rgb, orientation, channels):
    pixels = rgb if channels == 3 else rgb[..., 0]
    (tmp_path / "o.tif").write_bytes(deep_tiff(pixels.astype(np.uint16) * 257, orientation))
    image = read_image(tmp_path / "o.tif")
    got = image.rgb if channels == 3 else image.grey
    assert np.array_equal(got, turned(pixels, orientation))
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


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_pillows_limit_does_not_apply_while_a_tiff_is_decoded(
    tmp_path, rgb, monkeypatch, compression
):
    """Pillow checks TIFF twice; the limit is lowered here in place of a picture of 200
    megapixels."""
    path = _save(tmp_path / "a.tif", rgb, compression=compression)
    monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", W * H // 4)
    assert np.array_equal(read_image(path).rgb, rgb)
    assert PIL.Image.MAX_IMAGE_PIXELS == W * H // 4


# --- low ranges


def quiet(source) -> Image:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_image(source)


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("channels", [1, 3])
def test_values_of_fewer_bits_in_a_16_bit_file(tmp_path, rgb, bits, suffix, channels):
    pixels = rgb if channels == 3 else rgb[..., 0]
    pixels = np.ascontiguousarray(cv2.normalize(pixels, None, 0, 255, cv2.NORM_MINMAX))
    path = str(tmp_path / f"a.{suffix}")
    stored = pixels[..., ::-1] if channels == 3 else pixels
    assert cv2.imwrite(path, stored * np.uint16(2 ** (bits - 8)))
    with pytest.warns(ImageWarning, match=f"uses {bits} of 16 bits"):
        image = read_image(path)
    assert np.array_equal(image.rgb if channels == 3 else image.grey, pixels)


@pytest.mark.parametrize("top", [255, 1023, 4095, 65535, 2**24 - 1, 2**31 - 1])
def test_32_bit_integers_are_scaled_by_what_they_use(tmp_path, top):
    ramp = np.linspace(0, top, 256).astype(np.int32).repeat(4).reshape(8, 128)
    _save(tmp_path / "a.tif", ramp)
    image = quiet(tmp_path / "a.tif")
    assert np.abs(image.grey.astype(int) - ramp / (top / 255)).max() <= 1


def test_thermal_pictures_are_stretched(tmp_path, rgb):
    """Hundredths of a kelvin: 300 K +- 20 K, of which the high byte would leave 16 levels."""
    celsius = cv2.normalize(rgb[..., 0].astype(np.float64), None, 0, 40, cv2.NORM_MINMAX)
    kelvin = np.rint((celsius + 280) * 100).astype(np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.png"), kelvin)
    assert cv2.imwrite(str(tmp_path / "a.tif"), (celsius - 10).astype(np.float32))
    for name in ("a.png", "a.tif"):
        with pytest.warns(ImageWarning, match="stretched"):
            grey = read_image(tmp_path / name).grey
        assert (grey.min(), grey.max()) == (0, 255)
        assert len(np.unique(grey)) > 90
        assert np.corrcoef(grey.ravel(), celsius.ravel())[0, 1] > 0.999


@pytest.mark.parametrize("value", [0, 300, 65535])
def test_a_picture_of_one_value_is_not_stretched(value):
    assert (quiet(np.full((9, 9), value, np.uint16)).grey == value >> 8).all()


def test_low_range_arrays_and_alpha():
    ramp = (np.arange(4096, dtype=np.uint16)).reshape(64, 64)
    rgba = np.stack([ramp, ramp, ramp, np.full_like(ramp, 65535)], -1)
    for array in (ramp, rgba):
        with pytest.warns(ImageWarning, match="the array uses 12 of 16 bits"):
            assert np.array_equal(read_image(array).grey, ramp >> 4)


# --- damage that decodes


@pytest.fixture(scope="module")
def jpeg(rgb) -> bytes:
    file = io.BytesIO()
    PIL.Image.fromarray(cv2.resize(rgb, (640, 480), interpolation=cv2.INTER_CUBIC)).save(
        file, "JPEG", quality=95
    )
    return file.getvalue()


def _middle(data: bytes, patch: bytes, at: float = 0.5) -> bytes:
    start = int(len(data) * at)
    return data[:start] + patch + data[start + len(patch) :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda d: _middle(d, bytes(1024)),
        lambda d: _middle(d, bytes(4096), 0.3),
        lambda d: _middle(d, np.random.default_rng(0).bytes(4096)),
        lambda d: d[: len(d) // 2] + b"\xff\xd9",
        lambda d: _middle(d, b"\xff\xd9"),
    ],
    ids=["zeros", "more zeros", "rubbish", "cut and closed", "early end"],
)
def test_damaged_jpeg_that_decodes_warns(tmp_path, jpeg, damage):
    (tmp_path / "a.jpg").write_bytes(damage(jpeg))
    with pytest.warns(ImageWarning, match=r"a\.jpg is damaged"):
        assert read_image(tmp_path / "a.jpg").size_wh == (640, 480)


@pytest.mark.parametrize(
    "options",
    [
        {"quality": 95},
        {"quality": 30, "optimize": True},
        {"progressive": True},
        {"restart_marker_blocks": 4},
        {"subsampling": 0, "quality": 100},
    ],
)
@pytest.mark.parametrize("grey", [False, True])
def test_sound_jpeg_does_not_warn(tmp_path, rgb, options, grey):
    large = cv2.resize(rgb, (640, 480), interpolation=cv2.INTER_CUBIC)
    flat = np.full((2000, 3000, 3), 255, np.uint8)
    flat[:40, :40] = rgb[:40, :40]
    for pixels in (large, flat, flat[::-1]):
        path = _save(tmp_path / "a.jpg", pixels[..., 0] if grey else pixels, **options)
        path.write_bytes(path.read_bytes() + bytes(5000))  # padding after the end
        quiet(path)


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


@pytest.mark.parametrize(
    "head,kind",
    [
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 30\n%%EndComments\n", "PostScript"),
        (b"%PDF-1.7\n", "PDF"),
        (b"\0\0\0\x18ftypheic\0\0\0\0", "HEIC"),
        (b"8BPS\0\1", "Photoshop"),
    ],
)
def test_no_other_decoder_is_started(tmp_path, monkeypatch, head, kind):
    """Pillow would start Ghostscript for PostScript, whatever the file's name."""
    ran = tmp_path / "ran"
    for name in ("gs", "gswin32c", "gswin64c"):
        script = tmp_path / name
        script.write_text(f"#!/bin/sh\ntouch {ran}\n")
        script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    (tmp_path / "a.jpg").write_bytes(head + bytes(200))
    with pytest.raises(ImageError, match=f"{kind}.*; JPEG, PNG"):
        read_image(tmp_path / "a.jpg")
    assert not ran.exists()


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
def test_arrays_that_are_not_images(array, message):
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


XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description
   drone-dji:RelativeAltitude="+30.20" drone-dji:GimbalRollDegree="+0.00"
   drone-dji:GimbalYawDegree="-12.5" drone-dji:GimbalPitchDegree="-89.90">
   <drone-dji:CalibratedFocalLength>3666.666504</drone-dji:CalibratedFocalLength>
 </rdf:Description></rdf:RDF></x:xmpmeta>"""


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
def test_drone_metadata(tmp_path, rgb, suffix):
    options = {"xmp": XMP.encode()}
    if suffix == "png":
        info = PIL.PngImagePlugin.PngInfo()
        info.add_itxt("XML:com.adobe.xmp", XMP)
        options = {"pnginfo": info}
    if suffix == "tif":
        options = {"tiffinfo": {700: XMP.encode()}}
    exif = read_image(_save(tmp_path / f"a.{suffix}", rgb, **options)).exif
    assert exif.calibrated_focal_px == 3666.666504
    assert exif.relative_altitude_m == 30.2
    assert exif.gimbal_deg == (-12.5, -89.9, 0)


@pytest.mark.parametrize("value", ["", "abc", "1e999", "1.2.3", "-5", "0", "9" * 5000])
def test_drone_metadata_without_use(tmp_path, rgb, value):
    xmp = f'<rdf:Description drone-dji:CalibratedFocalLength="{value}"/>'.encode()
    exif = read_image(_save(tmp_path / "a.jpg", rgb, xmp=xmp)).exif
    assert exif.calibrated_focal_px is None


@pytest.mark.data
def test_phantom_3_exif(data_dir):
    image = read_image(data_dir / "uav" / "toledo-p3pro" / "1JI_0064.JPG")
    exif = image.exif
    assert (exif.make, exif.model, exif.focal_mm, exif.focal_35mm) == ("DJI", "FC300X", 3.61, 20)
    assert image.size_wh == (2400, 1800)
