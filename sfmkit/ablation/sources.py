"""The pairs of a sweep: each image is identified by its bytes; rendered pairs are cached."""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

from .._utils.progress import Progress, silent
from ..datasets import DATASETS, Pair, Source, find_source
from ..datasets.pair import HOMOGRAPHY, image_size
from ..errors import CameraError, InputError
from ..io.images import Image, read_image
from ..pipeline.stages import choose_cameras
from ..types import Camera
from .cache import Cache
from .entry import Entry
from .tasks import ImageRef
from .version import digest, stage_version


@dataclass(frozen=True, eq=False)
class PlannedPair:
    """A pair of a plan.

    Attributes:
        dataset, sequence, name: See :class:`sfmkit.datasets.Pair`.
        images: None where an image cannot be read.
        homography: Whether a homography is to be estimated.
        cameras: The cameras of both images, where a two-view geometry is to be estimated.
        H, R, t, check_points: The truth, where known.
        failure: Why the pair cannot be run; empty where it can.
    """

    dataset: str
    sequence: str
    name: str
    images: tuple[ImageRef, ImageRef] | None
    homography: bool
    cameras: tuple[Camera, Camera] | None = None
    H: np.ndarray | None = None
    R: np.ndarray | None = None
    t: np.ndarray | None = None
    check_points: np.ndarray | None = None
    failure: str = ""

    def __str__(self) -> str:
        return f"{self.dataset}/{self.sequence} {self.name}"

    @property
    def has_truth(self) -> bool:
        if self.homography:
            return self.H is not None or self.check_points is not None
        return self.R is not None

    def as_json(self) -> dict[str, Any]:
        """The pair for the sweep's folder."""

        def matrix(a: np.ndarray | None) -> list | None:
            return None if a is None else np.asarray(a).tolist()

        return {
            "dataset": self.dataset,
            "sequence": self.sequence,
            "pair": self.name,
            "kind": "homography" if self.homography else "two-view",
            "images": self.images
            and [
                {"path": i.path, "sha256": i.digest, "size_wh": list(i.size_wh)}
                for i in self.images
            ],
            "cameras": self.cameras
            and [
                {
                    "K": matrix(c.K),
                    "distortion": matrix(c.distortion),
                    "model": c.model,
                    "source": c.source,
                }
                for c in self.cameras
            ],
            "H": matrix(self.H),
            "R": matrix(self.R),
            "t": matrix(self.t),
            "check_points": matrix(self.check_points),
            "failure": self.failure,
        }


@dataclass
class ImageShelf:
    """References to images by their bytes; arrays become PNG files, which workers can read.

    Attributes:
        folder: The folder of these files; None writes none, for a plan that is only counted.
    """

    folder: Path | None
    _known: dict[Path, ImageRef] = field(default_factory=dict)

    def ref(self, image: Path | np.ndarray) -> ImageRef:
        """The reference to an image.

        Raises:
            ImageError: The file is not an image.
        """
        if isinstance(image, np.ndarray):
            return self._of_array(image)
        path = Path(os.path.abspath(image))
        if path not in self._known:
            data = path.read_bytes() if path.is_file() else b""
            self._known[path] = ImageRef(
                hashlib.sha256(data).hexdigest(), str(path), image_size(path)
            )
        return self._known[path]

    def _of_array(self, pixels: np.ndarray) -> ImageRef:
        size = (pixels.shape[1], pixels.shape[0])
        file = io.BytesIO()
        PIL.Image.fromarray(pixels).save(file, "PNG", compress_level=1)
        data = file.getvalue()
        name = hashlib.sha256(data).hexdigest()
        if self.folder is None:
            return ImageRef(name, "(an array)", size)
        path = self.folder / f"{name[:16]}.png"
        if not (path.is_file() and path.stat().st_size == len(data)):
            self.folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return ImageRef(name, str(path.resolve()), size)


def plan_pair(pair: Pair, shelf: ImageShelf) -> PlannedPair:
    """Check the images and cameras of a pair; an error becomes its failure."""
    homography = pair.kind == HOMOGRAPHY
    failure, images, cameras = "", None, None
    try:
        images = (shelf.ref(pair.image1), shelf.ref(pair.image2))
        if not homography:
            cameras = _cameras(pair, images)
    except (InputError, OSError) as error:
        failure = f"{type(error).__name__}: {error}"
    return PlannedPair(
        pair.dataset,
        pair.sequence,
        pair.name,
        images,
        homography,
        cameras,
        pair.H,
        pair.R,
        pair.t,
        pair.check_points,
        failure,
    )


def _cameras(pair: Pair, images: tuple[ImageRef, ImageRef]) -> tuple[Camera, Camera]:
    if pair.camera1 is None:
        with warnings.catch_warnings():
            # a guessed focal length is recorded in the camera's source
            warnings.simplefilter("ignore", UserWarning)
            both: tuple[Image, Image] = (read_image(images[0].path), read_image(images[1].path))
            return choose_cameras(both, None, pair.camera2)
    cameras = (pair.camera1, pair.camera2 or pair.camera1)
    for camera, image in zip(cameras, images):
        if camera.size_wh != image.size_wh:
            raise CameraError(
                f"the camera is for {camera.size_wh}, the image has {image.size_wh} pixels"
            )
    return cameras


def find_pairs(
    data: str | os.PathLike | Iterable[str | os.PathLike | Pair],
    root: str | os.PathLike | None,
    cache: Cache | None,
    say: Progress = silent,
) -> list[Pair]:
    """Find the pairs that `data` names or contains.

    Args:
        data: ``oxford,strecha:fountain-P11,pairs.json`` as text, or a list of such items and of
            pairs; see :func:`sfmkit.datasets.find_source`.
        root: The folder of the data sets; None: see :func:`sfmkit.datasets.pairs`.
        cache: The place of rendered pairs; None renders them.

    Raises:
        InputError: A data set, list or sequence is unknown, missing or damaged, or there are no
            pairs at all.
    """
    items: list[str | os.PathLike | Pair]
    if isinstance(data, str):
        items = [*data.split(",")]
    else:
        items = [data] if isinstance(data, os.PathLike) else list(data)
    found: list[Pair] = []
    for item in items:
        if isinstance(item, Pair):
            found.append(item)
        elif text := os.fspath(item).strip():
            say("pairs", text)
            source = find_source(text, root)
            found += _generated(source, cache, say) or source.pairs()
    if not found:
        raise InputError("there are no pairs to run on; name data sets: --data oxford,strecha")
    return found


def _generated(source: Source, cache: Cache | None, say: Progress) -> list[Pair]:
    """Return the pairs of a rendered data set, from the cache if possible.

    Empty for a data set that is read from the disk.
    """
    found: list[Pair] = []
    known = getattr(source.reader, "generated", ())
    if source.name is None or not known:
        return found
    code = DATASETS.provenance(source.name)
    for sequence in source.sequences or known:
        key = digest("pairs", stage_version("pairs"), source.name, code, sequence)
        entry = None if cache is None else cache.get("pairs", key)
        if entry is not None:
            found += _unpack(entry)
            continue
        say("render", f"{source.name} {sequence}")
        made = source.pairs((sequence,))
        found += made
        if cache is not None:
            cache.put("pairs", _pack(key, made))
    return found


_ARRAYS = ("image1", "image2", "H", "R", "t", "check_points")


def _pack(key: str, made: Sequence[Pair]) -> Entry:
    arrays = {
        f"{i}.{name}": np.asarray(getattr(pair, name))
        for i, pair in enumerate(made)
        for name in _ARRAYS
        if getattr(pair, name) is not None
    }
    for i, pair in enumerate(made):
        for n, camera in (("1", pair.camera1), ("2", pair.camera2)):
            if camera is not None:
                arrays |= {f"{i}.K{n}": camera.K, f"{i}.distortion{n}": camera.distortion}
    names = [[pair.dataset, pair.sequence, pair.name, pair.kind] for pair in made]
    return Entry(key, {"names": names}, arrays)


def _unpack(entry: Entry) -> list[Pair]:
    def pair(i: int, dataset: str, sequence: str, name: str, kind: str) -> Pair:
        mine: dict[str, Any] = {n: entry.arrays.get(f"{i}.{n}") for n in _ARRAYS}
        for n in ("1", "2"):
            K = entry.arrays.get(f"{i}.K{n}")
            if K is not None:
                size_wh = mine[f"image{n}"].shape[1::-1]
                mine[f"camera{n}"] = Camera(K, size_wh, entry.arrays[f"{i}.distortion{n}"])
        return Pair(dataset, sequence, name, kind=kind, **mine)

    return [pair(i, *words) for i, words in enumerate(entry.meta["names"])]
