"""What is seen in the photographs: themselves, keypoints, matches, and what fusion merged."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import rerun as rr

from ..errors import OutputError
from ..io.images import Image
from ..pipeline.reconstruction import FeaturePairs
from ..types import Camera, Correspondences, Matches
from . import marks
from .stream import Cameras, beside, columns, log_survivors, pinhole, put, side_by_side, strokes
from .trace import KeypointTrace, matches_to_rows

JPEG_QUALITY = 80


def log_images(
    rec: rr.RecordingStream,
    images: tuple[Image, Image],
    cameras: Cameras,
    prefix: str = "",
    *,
    originals: bool = False,
    frustum: float = 0.5,
) -> None:
    """Photographs below their pinholes, and small side by side for the matches.

    Args:
        frustum: distance of the image plane from the camera in the 3-D view, baselines.
    """
    put(rec, prefix, "world", rr.ViewCoordinates.RDF)
    for number, (image, camera) in enumerate(zip(images, cameras), start=1):
        rgb = marks.ideal_image(image.rgb, camera)
        at = f"world/cam{number}/image"
        put(rec, prefix, at, pinhole(camera, frustum))
        corner = rr.Transform3D(
            translation=[-0.5, -0.5, 0]
        )  # the viewer's image begins at a corner, not at a centre
        put(
            rec,
            prefix,
            f"{at}/photo",
            _original(image, camera) if originals else _jpeg(rgb),
            corner,
        )
        factor = max(1.0, max(image.size_wh) / 1280)
        small = (
            cv2.resize(rgb, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
            if factor > 1
            else rgb
        )
        scale = [image.size_wh[0] / small.shape[1], image.size_wh[1] / small.shape[0], 1]
        shift = 0 if number == 1 else beside(cameras)
        place = rr.Transform3D(translation=[shift - 0.5, -0.5, 0], scale=scale)
        put(rec, prefix, f"matches/photo{number}", _jpeg(small), place)


def log_features(
    rec: rr.RecordingStream,
    features: FeaturePairs,
    cameras: Cameras,
    prefix: str = "",
    *,
    became: Mapping[str, tuple[KeypointTrace, KeypointTrace]] | None = None,
    max_regions: int = 300,
) -> None:
    """Keypoints of every operator in both images, and the described neighbourhoods of the
    strongest.

    Args:
        became: what became of every keypoint (:func:`sfmkit.recording.trace.trace_keypoints`).
        max_regions: neighbourhoods drawn an operator and image, the strongest spread evenly.
    """
    for number in (1, 2):
        alive = []
        for k, (name, pair) in enumerate(features.items()):
            f = pair[number - 1]
            if not len(f):
                continue
            x = marks.ideal_pixels(f.keypoints, cameras[number - 1])
            at = f"world/cam{number}/image"
            details = {"scale_px": f.scales, "angle_deg": np.degrees(f.angles), "score": f.scores}
            if became is not None:
                b = became[name][number - 1]
                details |= {"fate": b.fate, "match": b.match, "point": b.point}
            dots = rr.Points2D(x, class_ids=k, radii=rr.Radius.ui_points(1))
            put(rec, prefix, [at, "keypoints", name], dots, columns(**details), stage="detect")
            alive.append((x, np.full(len(f), k)))
            some = marks.strongest(f, max_regions)
            circles = rr.Ellipses2D(
                centers=x[some],
                half_sizes=np.repeat(f.scales[some, None] / 2, 2, 1),
                class_ids=k,
                line_radii=rr.Radius.ui_points(0.7),
                show_labels=False,
            )
            put(rec, prefix, [at, "regions", name], circles, columns(keypoint=some), stage="detect")
            ticks = marks.orientation_ticks(x[some], f.scales[some], f.angles[some])
            put(
                rec,
                prefix,
                [at, "regions", name, "ticks"],
                strokes(ticks, class_ids=k, width=0.7),
                stage="detect",
            )
        log_survivors(rec, prefix, number, alive, "detect")


def log_matches(
    rec: rr.RecordingStream,
    features: FeaturePairs,
    matches: Mapping[str, Matches],
    cameras: Cameras,
    prefix: str = "",
    *,
    max_lines: int = 80,
) -> None:
    """Every operator's matches before fusion: what is matched in the images, and lines side by
    side.

    Args:
        max_lines: lines drawn an operator, spread evenly over image 1.
    """
    alive: tuple[list, list] = ([], [])
    for k, (name, m) in enumerate(matches.items()):
        if not len(m):
            continue
        x1, x2 = (
            marks.ideal_pixels(f.keypoints[i], c)
            for f, i, c in zip(features[name], (m.index1, m.index2), cameras)
        )
        alive[0].append((x1, np.full(len(m), k)))
        alive[1].append((x2, np.full(len(m), k)))
        some = marks.spread(x1, max_lines)
        details = columns(
            distance=m.distance[some],
            ratio=m.ratio[some],
            keypoint1=m.index1[some],
            keypoint2=m.index2[some],
        )
        lines = side_by_side(x1[some], x2[some], cameras, class_ids=k)
        put(rec, prefix, ["matches", "tentative", name], lines, details, stage="match")
    for number in (1, 2):
        log_survivors(rec, prefix, number, alive[number - 1], "match")


def log_fusion(
    rec: rr.RecordingStream,
    features: FeaturePairs,
    matches: Mapping[str, Matches],
    corr: Correspondences,
    cameras: Cameras,
    prefix: str = "",
    *,
    max_lines: int = 80,
) -> None:
    """What was merged: the matches that others stand for, and what is left in the images."""
    for k, (name, (rows, merged)) in enumerate(matches_to_rows(features, matches, corr).items()):
        m = matches[name]
        x1, x2 = (
            marks.ideal_pixels(f.keypoints[i[merged]], c)
            for f, i, c in zip(features[name], (m.index1, m.index2), cameras)
        )
        if not len(x1):
            continue
        some = marks.spread(x1, max_lines)
        into = rows[merged][some]
        details = columns(
            match=into, merged_into=np.array(corr.operators)[corr.operator_id.numpy()[into]]
        )
        put(
            rec,
            prefix,
            ["matches", "merged", name],
            side_by_side(x1[some], x2[some], cameras, class_ids=k),
            details,
            stage="fuse",
        )
    for number, x in enumerate((corr.x1, corr.x2), start=1):
        fused = [(marks.ideal_pixels(x, cameras[number - 1]), corr.operator_id.numpy())]
        log_survivors(rec, prefix, number, fused, "fuse")


def _jpeg(rgb: np.ndarray) -> rr.EncodedImage:
    done, data = cv2.imencode(
        ".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    if not done:
        raise OutputError(f"an image of shape {rgb.shape} cannot be compressed to JPEG")
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg", draw_order=-10)


def _original(image: Image, camera: Camera) -> rr.EncodedImage:
    """The bytes of the photograph's own JPEG where they show what the pixels are, else PNG."""
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
