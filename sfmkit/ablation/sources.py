"""The pairs of a sweep: from data sets or given, each image known by its bytes, rendered ones made
once."""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

from ..datasets import Pair, pairs
from ..errors import CameraError, InputError
from ..io.images import Image, read_image
from ..pipeline.reconstruction import choose_cameras
from ..types import Camera
from .cache import Cache
from .entry import Entry
from .tasks import ImageRef
from .version import digest, stage_version

RENDERED = ("synthetic", "planes")
_ORIENTATION, _TURNED = 0x0112, (5, 6, 7, 8)  # EXIF: stored rows are columns


@dataclass(frozen=True, eq=False)
class PlannedPair:
    """A pair as the plan knows it.

    Attributes:
        dataset, sequence, name: as in :class:`sfmkit.datasets.Pair`.
        images: None where an image cannot be read.
        homography: whether a homography is to be estimated.
        cameras: of both images, where a two-view geometry is to be estimated.
        H, R, t: the truth, where known.
        failure: why the pair cannot be run; empty where it can.
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
    failure: str = ""

    def __str__(self) -> str:
        return f"{self.dataset}/{self.sequence} {self.name}"

    @property
    def has_truth(self) -> bool:
        return (self.H if self.homography else self.R) is not None

    def as_json(self) -> dict[str, Any]:
        """Everything, for the sweep's folder."""

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
                {"K": matrix(c.K), "distortion": matrix(c.distortion), "source": c.source}
                for c in self.cameras
            ],
            "H": matrix(self.H),
            "R": matrix(self.R),
            "t": matrix(self.t),
            "failure": self.failure,
        }


@dataclass
class ImageShelf:
    """Images by their bytes. Arrays become PNG files in `folder`, so that workers can be told a
    path.

    Attributes:
        folder: for those; None keeps them out of the file system, for a plan that is only counted.
    """

    folder: Path | None
    _known: dict[Path, ImageRef] = field(default_factory=dict)

    def ref(self, image: Path | np.ndarray) -> ImageRef:
        """Raises ImageError for what is no image."""
        if isinstance(image, np.ndarray):
            return self._of_array(image)
        path = Path(os.path.abspath(image))
        if path not in self._known:
            data = path.read_bytes() if path.is_file() else b""
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    with PIL.Image.open(io.BytesIO(data)) as picture:
                        size = (
                            picture.size[::-1]
                            if picture.getexif().get(_ORIENTATION) in _TURNED
                            else picture.size
                        )
            except (
                Exception
            ):  # Pillow raises almost anything; reading it in earnest says what is wrong
                size = read_image(path).size_wh
            self._known[path] = ImageRef(hashlib.sha256(data).hexdigest(), str(path), size)
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
    """The pair with its images looked at; what is wrong with them becomes its failure."""
    homography = pair.H is not None
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
        failure,
    )


def _cameras(pair: Pair, images: tuple[ImageRef, ImageRef]) -> tuple[Camera, Camera]:
    if pair.camera1 is None:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", UserWarning
            )  # a guessed focal length: the camera's source says so
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
    data: str | Iterable[str | Pair],
    root: str | os.PathLike | None,
    cache: Cache | None,
    say: Callable[[str, str], None] = lambda stage, detail: None,
) -> list[Pair]:
    """The pairs that `data` names or is.

    Args:
        data: ``oxford,strecha:fountain-P11,synthetic:wide+plane`` as text or a list: data sets, of
            which some sequences; or pairs.
        root: folder of the data sets; None: see :func:`sfmkit.datasets.pair`.
        cache: where rendered pairs are kept; None renders them.

    Raises:
        InputError: unknown or missing data sets or sequences, or no pairs at all.
    """
    items = data.split(",") if isinstance(data, str) else list(data)
    found: list[Pair] = []
    for item in items:
        if isinstance(item, Pair):
            found.append(item)
            continue
        name, _, sequences = item.strip().partition(":")
        if not name:
            continue
        chosen = [s for s in sequences.split("+") if s] or None
        say("pairs", item.strip())
        found += (
            _rendered(name, chosen, cache, say)
            if name in RENDERED
            else pairs(name, root, sequences=chosen)
        )
    if not found:
        raise InputError("no pairs to run on; name data sets, e.g. --data oxford,strecha")
    return found


def sequences_of(name: str) -> list[str]:
    """The sequences of a rendered data set."""
    if name == "synthetic":
        from ..datasets.synthetic import SCENES

        return list(SCENES)
    from ..datasets.planes import SEQUENCES

    return list(SEQUENCES)


def _rendered(
    name: str, sequences: Sequence[str] | None, cache: Cache | None, say: Callable[[str, str], None]
) -> list[Pair]:
    """The pairs of a rendered data set: a scene takes seconds, so it is kept."""
    found = []
    for sequence in sequences or sequences_of(name):
        key = digest("pairs", stage_version("pairs"), name, sequence)
        entry = None if cache is None else cache.get("pairs", key)
        if entry is not None:
            found += _unpack(name, sequence, entry)
            continue
        say("render", f"{name} {sequence}")
        made = list(pairs(name, sequences=[sequence]))
        found += made
        if cache is not None:
            cache.put("pairs", _pack(key, made))
    return found


_ARRAYS = ("image1", "image2", "H", "R", "t")


def _pack(key: str, made: Sequence[Pair]) -> Entry:
    arrays = {
        f"{i}.{n}": np.asarray(getattr(p, n))
        for i, p in enumerate(made)
        for n in _ARRAYS
        if getattr(p, n) is not None
    }
    for i, p in enumerate(made):
        if p.camera1 is not None and p.camera2 is not None:
            arrays |= {f"{i}.K1": p.camera1.K, f"{i}.K2": p.camera2.K}
    return Entry(key, {"names": [p.name for p in made]}, arrays)


def _unpack(dataset: str, sequence: str, entry: Entry) -> list[Pair]:
    def pair(i: int, name: str) -> Pair:
        mine: Mapping[str, Any] = {n: entry.arrays.get(f"{i}.{n}") for n in (*_ARRAYS, "K1", "K2")}
        one, two = (
            None if mine[k] is None else Camera(mine[k], mine[n].shape[1::-1])
            for k, n in (("K1", "image1"), ("K2", "image2"))
        )
        return Pair(
            dataset,
            sequence,
            name,
            mine["image1"],
            mine["image2"],
            one,
            two,
            mine["H"],
            mine["R"],
            mine["t"],
        )

    return [pair(i, name) for i, name in enumerate(entry.meta["names"])]
