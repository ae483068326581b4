"""Catalogue of the public data sets: addresses, terms of use and checksums.

The home pages publish no checksums, so ``checksums.json`` contains those of copies in use. The
checksum of a lossless image covers its decoded pixels, so a converted copy (such as PNG) passes.
The checksum of a lossy image covers its bytes, that of a text file its words.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path, PurePath

from ..errors import InputError
from .oxford import SEQUENCES

_VGG = "https://www.robots.ox.ac.uk/~vgg/research/affine/det_eval_files"
_VGG_MIRROR = "https://thor.robots.ox.ac.uk/affine"
_EPFL = "https://raw.githubusercontent.com/openMVG/SfM_quality_evaluation/master/Benchmarking_Camera_Calibration_2008"
_TOLEDO = "https://raw.githubusercontent.com/OpenDroneMap/odm_data_toledo/master/images"
_HPATCHES = "https://huggingface.co/datasets/vbalnt/hpatches/resolve/main"
_HPATCHES_HOME = "http://icvl.ee.ic.ac.uk/vbalnt/hpatches"
MB = 1 << 20


@dataclass(frozen=True)
class Download:
    """A file to download.

    Attributes:
        urls: Address and mirrors, tried in this order.
        folder: Destination of the contents, relative to the folder of the data set.
        archive: Whether the file is a tar or zip archive to unpack.
        max_files, max_bytes: Largest number and total size of the files in the archive.
        sha256: Checksum of the file; None if only its contents have checksums, or if there is none.
    """

    urls: tuple[str, ...]
    folder: str = ""
    archive: bool = True
    max_files: int = 100
    max_bytes: int = 100 * MB
    sha256: str | None = None


@dataclass(frozen=True)
class DatasetSpec:
    """A data set that can be fetched.

    Attributes:
        name: Name of the data set and of its folder.
        title, home, terms, citation: Texts that are printed before a download.
        size_mb: Approximate size of the download, megabytes.
        downloads: Files to download.
    """

    name: str
    title: str
    home: str
    terms: str
    citation: str
    size_mb: int
    downloads: tuple[Download, ...]

    @property
    def pins(self) -> Mapping[str, str]:
        """Relative path -> ``pixels:``, ``bytes:`` or ``words:`` and the sha256.

        Paths of images have no suffix.
        """
        return _checksums().get(self.name, {})


@cache
def _checksums() -> dict[str, dict[str, str]]:
    return json.loads(
        files("sfmkit.datasets").joinpath("checksums.json").read_text(encoding="utf-8")
    )


_FOUNTAIN = [f"images/{k:04d}.jpg" for k in range(11)] + [
    f"gt_dense_cameras/{k:04d}.jpg.camera" for k in range(11)
]

DATASETS: Mapping[str, DatasetSpec] = {
    spec.name: spec
    for spec in (
        DatasetSpec(
            "oxford",
            "Affine covariant features: 8 sequences of 6 images with homographies",
            "https://www.robots.ox.ac.uk/~vgg/research/affine/",
            "no licence is stated; made available for research",
            "Mikolajczyk, Tuytelaars, Schmid, Zisserman, Matas, Schaffalitzky, Kadir & Van Gool: "
            "A comparison of affine "
            "region detectors. IJCV 65, 2005",
            60,
            tuple(
                Download((f"{_VGG}/{name}.tar.gz", f"{_VGG_MIRROR}/{name}.tar.gz"), folder=name)
                for name in SEQUENCES
            ),
        ),
        DatasetSpec(
            "hpatches",
            "HPatches full sequences: 116 sequences of 6 images with homographies",
            "https://github.com/hpatches/hpatches-dataset",
            "no licence is stated for the images; made available for research",
            "Balntas, Lenc, Vedaldi & Mikolajczyk: HPatches: a benchmark and evaluation of "
            "handcrafted and learned local "
            "descriptors. CVPR 2017",
            1300,
            (
                Download(
                    (
                        f"{_HPATCHES_HOME}/hpatches-sequences-release.tar.gz",
                        f"{_HPATCHES}/hpatches-sequences-release.zip",
                    ),
                    max_files=3000,
                    max_bytes=4000 * MB,
                ),
            ),
        ),
        DatasetSpec(
            "strecha",
            "EPFL multi-view set, fountain-P11: 11 photographs with cameras",
            "https://github.com/openMVG/SfM_quality_evaluation",
            "no licence is stated; made available for research",
            "Strecha, von Hansen, Van Gool, Fua & Thoennessen: On benchmarking camera "
            "calibration and multi-view stereo "
            "for high resolution imagery. CVPR 2008",
            30,
            tuple(
                Download((f"{_EPFL}/fountain-P11/{name}",), f"fountain-P11/{name}", archive=False)
                for name in (*_FOUNTAIN, "images/K.txt")
            ),
        ),
        DatasetSpec(
            "uav",
            "Five consecutive drone photographs of roofs (Toledo), with EXIF",
            "https://github.com/OpenDroneMap/odm_data_toledo",
            "see the home page; test data of OpenDroneMap",
            "OpenDroneMap contributors: odm_data_toledo",
            15,
            tuple(
                Download(
                    (f"{_TOLEDO}/1JI_{k:04d}.JPG",), f"toledo-p3pro/1JI_{k:04d}.JPG", archive=False
                )
                for k in range(64, 69)
            ),
        ),
    )
}


def dataset_spec(name: str) -> DatasetSpec:
    """Return the data set with this name.

    Raises:
        InputError: There is no such data set.
    """
    if name not in DATASETS:
        raise InputError(
            f"unknown data set '{name}'; `sfmkit data list` shows them: {', '.join(DATASETS)}"
        )
    return DATASETS[name]


_LOSSLESS = (".png", ".ppm", ".pgm", ".bmp", ".tif", ".tiff")
_LOSSY = (".jpg", ".jpeg")


def pin_name(file: PurePath) -> str:
    """Return the key of a file in the checksums; lossless images have no suffix."""
    return file.with_suffix("").as_posix() if file.suffix.lower() in _LOSSLESS else file.as_posix()


def fingerprint(file: Path) -> str:
    """Compute the checksum of a file: ``pixels:``, ``bytes:`` or ``words:`` and a sha256.

    Raises:
        ImageError: An image cannot be decoded.
    """
    suffix = file.suffix.lower()
    if suffix in _LOSSLESS:
        from ..io.images import read_image

        image = read_image(file)
        return (
            "pixels:"
            + hashlib.sha256(str(image.size_wh).encode() + image.rgb.tobytes()).hexdigest()
        )
    data = file.read_bytes()
    if suffix in _LOSSY:
        return "bytes:" + hashlib.sha256(data).hexdigest()
    return "words:" + hashlib.sha256(b" ".join(data.split())).hexdigest()


def check_folder(spec: DatasetSpec, root: Path, part: str = "") -> list[str]:
    """List the files of a data set that are missing or changed, one message per file.

    Args:
        root: Folder of the data set, or of its `part`.
        part: Path of a folder or file to check, relative to the folder of the data set; empty for
            the whole data set.
    """
    files_in = [root] if root.is_file() else sorted(f for f in root.rglob("*") if f.is_file())
    have = {pin_name(PurePath(part) / f.relative_to(root)): f for f in files_in}
    wrong = []
    for name, pin in spec.pins.items():
        if not Path(name).is_relative_to(part):
            continue
        if name not in have:
            wrong.append(f"{name}: missing")
            continue
        try:
            found = fingerprint(have[name])
        except InputError as error:
            wrong.append(f"{name}: {error}")
            continue
        if found != pin:
            wrong.append(f"{name}: its contents differ ({found[:19]}..., not {pin[:19]}...)")
    return wrong
