"""Log what the photographs show: themselves, keypoints and matches."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import rerun as rr

from ..errors import InputError, OutputError
from ..io.images import Image
from ..types import Camera, Correspondences, Features, Matches
from ..viz.colours import operator_rgb
from . import marks
from .scales import log_coverage
from .stream import GREY, Cameras, Details, Size, beside, columns, pinhole, points_2d, put, strokes

JPEG_QUALITY = 80
MAX_WIDTH = 1280  # pixels of a photograph in the side-by-side views, which are about that wide
# kind of match -> the stage that makes it
KINDS = {"tentative": "match", "merged": "fuse", "inliers": "estimate", "outliers": "estimate"}
MULTI = "multi"  # stands for marks without an operator of their own


def log_photographs(
    rec: rr.RecordingStream,
    image1: Image | np.ndarray,
    image2: Image | np.ndarray,
    cameras: Cameras | None = None,
    *,
    originals: bool = False,
    frustum: float = 0.5,
    prefix: str = "",
) -> None:
    """Log both photographs below their cameras, and smaller side by side for matches.

    Args:
        image1, image2: images, or (H, W, 3) or (H, W) uint8 arrays.
        cameras: intrinsics; photographs with distortion are undistorted. Without cameras the
            photographs appear in the 2-D views only.
        originals: keep the file's own JPEG (or PNG) instead of a JPEG at quality 80.
        frustum: distance of the image plane from the camera in the 3-D view, baselines.
    """
    put(rec, prefix, "world", rr.ViewCoordinates.RDF)
    for number, image in enumerate((image1, image2), start=1):
        pixels = image.rgb if isinstance(image, Image) else np.asarray(image)
        rgb = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
        at = f"world/cam{number}/image"
        if cameras is not None:
            rgb = marks.ideal_image(rgb, cameras[number - 1])
            put(rec, prefix, at, pinhole(cameras[number - 1], frustum))
        keep = originals and isinstance(image, Image) and cameras is not None
        data = _original(image, cameras[number - 1]) if keep else _jpeg(rgb)  # type: ignore[arg-type,index]
        # The viewer puts the origin at an image's corner, sfmkit at the centre of its first pixel.
        put(rec, prefix, f"{at}/photo", data, rr.Transform3D(translation=[-0.5, -0.5, 0]))
        h, w = rgb.shape[:2]
        factor = max(1.0, max(w, h) / MAX_WIDTH)
        small = (
            cv2.resize(rgb, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
            if factor > 1
            else rgb
        )
        x0 = 0 if number == 1 else beside(_width(image1))
        place = rr.Transform3D(
            translation=[x0 - 0.5, -0.5, 0], scale=[w / small.shape[1], h / small.shape[0], 1]
        )
        put(rec, prefix, f"matches/photo{number}", _jpeg(small), place)


def log_keypoints(
    rec: rr.RecordingStream,
    image: int,
    xy: Features | Any,
    *,
    operator: str | None = None,
    scales: Any = None,
    angles: Any = None,
    scores: Any = None,
    camera: Camera | None = None,
    details: Details | None = None,
    size_wh: Size | None = None,
    max_regions: int = 300,
    prefix: str = "",
) -> None:
    """Log the keypoints of one operator in one image, in the operator's colour.

    All keypoints are logged as dots, and their number per cell as shades. The neighbourhoods that
    are described (`scales`) and their orientations (`angles`) are drawn for an even sample of the
    strongest.

    Args:
        image: 1 or 2.
        xy: features, or (N, 2) pixels.
        operator: name that gives path and colour; default the features' own, else ``multi``.
        scales: (N,) diameters of the described neighbourhoods, pixels.
        angles: (N,) orientations, radians from x towards y.
        scores: (N,) responses, larger is stronger.
        camera: its distortion is removed from the pixels.
        details: further columns, (N,) or (N, d) each.
        size_wh: size of the image, for the shades; default that of the features or of `camera`.
        max_regions: number of neighbourhoods drawn.

    Raises:
        InputError: an array of another shape, or an image other than 1 and 2.
    """
    if image not in (1, 2):
        raise InputError(f"image must be 1 or 2, not {image!r}")
    if isinstance(xy, Features):
        f = xy
        operator, size_wh = operator or f.operator, size_wh or f.size_wh
        xy, scales, angles, scores = f.keypoints, f.scales, f.angles, f.scores
    name = operator or MULTI
    x = marks.ideal_pixels(points_2d("xy", xy), camera)
    colour, at = operator_rgb(name), f"world/cam{image}/image"
    own = {
        "scale_px": scales,
        "angle_deg": None if angles is None else np.degrees(angles),
        "score": scores,
        **(details or {}),
    }
    own = {key: np.asarray(value) for key, value in own.items() if value is not None}
    for key, value in own.items():
        if len(value) != len(x):
            raise InputError(f"{key} has {len(value)} values for {len(x)} keypoints")
    dots = rr.Points2D(x, colors=colour, radii=dot_size(len(x)))
    put(rec, prefix, [at, "keypoints", name], dots, columns(**own), stage="detect")
    if size_wh is None and camera is not None:
        size_wh = camera.size_wh
    if size_wh is not None:
        log_coverage(rec, image, x, size_wh, name, prefix)
    some = marks.spread_strongest(x, scores, max_regions)
    if scales is not None:
        half = np.asarray(scales)[some, None] / 2
        circles = rr.Ellipses2D(
            centers=x[some],
            half_sizes=np.repeat(half, 2, 1),
            colors=colour,
            line_radii=rr.Radius.ui_points(0.8),
            show_labels=False,
        )
        put(rec, prefix, [at, "regions", name], circles, columns(keypoint=some), stage="detect")
        if angles is not None:
            ticks = marks.orientation_ticks(x[some], 2 * half[:, 0], np.asarray(angles)[some])
            lines = strokes(ticks, colors=colour, width=0.8)
            put(rec, prefix, [at, "regions", name, "ticks"], lines, stage="detect")


def log_matches(
    rec: rr.RecordingStream,
    x1: Features | Any,
    x2: Features | Any,
    matches: Matches | None = None,
    *,
    width1: int | None = None,
    operator: str | None = None,
    kind: str = "tentative",
    cameras: Cameras | None = None,
    details: Details | None = None,
    max_lines: int = 80,
    prefix: str = "",
) -> None:
    """Log matches of one operator as lines between the images, which lie side by side.

    Inliers and outliers are also logged as dots in both images.

    Args:
        x1, x2: features with `matches`, or (N, 2) pixels in the order of the matches.
        matches: pairs of rows of the features.
        width1: width of image 1 in pixels; image 2 lies to its right. Features carry it.
        operator: name that gives path and colour; default the features' own, else ``multi``.
        kind: ``tentative``, ``merged``, ``inliers`` or ``outliers``; outliers are grey.
        cameras: their distortion is removed from the pixels.
        details: further columns, (N,) or (N, d) each.
        max_lines: number of lines, spread evenly over image 1.

    Raises:
        InputError: arrays of different lengths or shapes, or an unknown kind.
    """
    if kind not in KINDS:
        raise InputError(f"kind must be one of {', '.join(KINDS)}, not {kind!r}")
    own = dict(details or {})
    if isinstance(x1, Features) and isinstance(x2, Features):
        if matches is None:
            raise InputError("two Features need `matches`, the pairs of their rows")
        operator, width1 = operator or x1.operator, x1.size_wh[0]
        own = {
            "distance": matches.distance,
            "ratio": matches.ratio,
            "keypoint1": matches.index1,
            "keypoint2": matches.index2,
            **own,
        }
        x1, x2 = x1.keypoints[matches.index1], x2.keypoints[matches.index2]
    if width1 is None:
        raise InputError("width1, the width of image 1 in pixels, is needed to place image 2")
    name = operator or MULTI
    camera1, camera2 = (None, None) if cameras is None else cameras
    x1 = points_2d("x1", x1)
    a = marks.ideal_pixels(x1, camera1)
    b = marks.ideal_pixels(points_2d("x2", x2, len(x1)), camera2)
    own = {key: np.asarray(value) for key, value in own.items()}
    colour = GREY if kind == "outliers" else operator_rgb(name)
    if kind in ("inliers", "outliers"):
        dots = [rr.Points2D(x, colors=colour, radii=rr.Radius.ui_points(1.2)) for x in (a, b)]
        for number, dot in enumerate(dots, start=1):
            at = [f"world/cam{number}/image", kind, name]
            put(rec, prefix, at, dot, columns(**own), stage=KINDS[kind])
    some = marks.spread(a, max_lines)
    lines = side_by_side(a[some], b[some], width1, colour)
    own = {key: value[some] for key, value in own.items()}
    put(rec, prefix, ["matches", kind, name], lines, columns(**own), stage=KINDS[kind])


def log_correspondences(
    rec: rr.RecordingStream,
    corr: Correspondences,
    inliers: Any,
    *,
    width1: int,
    cameras: Cameras | None = None,
    details: Details | None = None,
    prefix: str = "",
) -> None:
    """Log fused correspondences by operator, inliers and outliers apart.

    Args:
        corr: N correspondences; the operator of each is the one whose pixels were kept.
        inliers: (N,) bool.
        width1, cameras, details: as in :func:`log_matches`.
    """
    inliers = np.asarray(inliers, dtype=bool)
    for kind, chosen in (("inliers", inliers), ("outliers", ~inliers)):
        for k, name in enumerate(corr.operators):
            rows = np.flatnonzero(chosen & (corr.operator_id.numpy() == k))
            if len(rows):
                log_matches(
                    rec,
                    corr.x1.numpy()[rows],
                    corr.x2.numpy()[rows],
                    width1=width1,
                    operator=name,
                    kind=kind,
                    cameras=cameras,
                    details={key: value[rows] for key, value in (details or {}).items()},
                    prefix=prefix,
                )


def side_by_side(x1: np.ndarray, x2: np.ndarray, width1: int, colours: Any) -> rr.LineStrips2D:
    """Lines from pixels of image 1 to pixels of image 2, which lies to the right."""
    return strokes(np.stack([x1, x2 + [beside(width1), 0]], 1), width=1.2, colors=colours)


def dot_size(n: int) -> rr.Radius:
    """Radius of n keypoints in a photograph: tens of thousands must not hide it."""
    return rr.Radius.ui_points(float(np.clip(60 / max(n, 1) ** 0.5, 0.5, 1.5)))


def _width(image: Image | np.ndarray) -> int:
    return image.size_wh[0] if isinstance(image, Image) else np.asarray(image).shape[1]


def _jpeg(rgb: np.ndarray) -> rr.EncodedImage:
    done, data = cv2.imencode(
        ".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    if not done:
        raise OutputError(f"an image of shape {rgb.shape} cannot be compressed to JPEG")
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg", draw_order=-10)


def _original(image: Image, camera: Camera) -> rr.EncodedImage:
    """Return the JPEG file's bytes if they need no rotation or undistortion, else a PNG."""
    upright = image.exif is None or image.exif.orientation == 1
    if (
        image.path is not None
        and image.path.suffix.lower() in (".jpg", ".jpeg")
        and upright
        and not camera.has_distortion
    ):
        return rr.EncodedImage(
            contents=image.path.read_bytes(), media_type="image/jpeg", draw_order=-10
        )
    rgb = marks.ideal_image(image.rgb, camera)
    data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))[1]
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/png", draw_order=-10)
