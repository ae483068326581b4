"""Cameras of a folder: photographs of one camera share their intrinsics."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

from .._utils.notices import collected
from ..errors import CameraError, InputError
from ..io.cameras import camera_from_exif
from ..io.intrinsics import parse_intrinsics
from ..types import Camera
from .collection import Collection, Photograph

__all__ = ["SharedCameras", "choose_shared_cameras"]

EVERYWHERE = ""  # key of intrinsics for all photographs


@dataclass(frozen=True)
class SharedCameras:
    """The cameras of a collection.

    Attributes:
        cameras: The distinct cameras.
        of_photograph: Index of the camera of each photograph.
        warnings: Warnings about the cameras, each with the affected photographs.
    """

    cameras: tuple[Camera, ...]
    of_photograph: tuple[int, ...]
    warnings: tuple[str, ...] = ()

    def __getitem__(self, photograph: int) -> Camera:
        return self.cameras[self.of_photograph[photograph]]


def choose_shared_cameras(
    collection: Collection, intrinsics: Mapping[str, str] | str | None = None
) -> SharedCameras:
    """Choose one camera for all photographs of the same origin.

    Photographs share a camera if they lie in the same subfolder, have the same size and EXIF
    orientation, and EXIF states the same make, model and focal length.

    Args:
        collection: The photographs.
        intrinsics: Text for :func:`sfmkit.io.intrinsics.parse_intrinsics` for all photographs; or a
            mapping subfolder -> text, in which the empty name stands for all other subfolders.
            Without it, the focal length is read from EXIF.

    Raises:
        InputError: A subfolder does not exist.
        CameraError: The intrinsics do not fit a photograph.
    """
    given = {EVERYWHERE: intrinsics} if isinstance(intrinsics, str) else dict(intrinsics or {})
    subfolders = {p.subfolder for p in collection.photographs}
    for name in given:
        if name != EVERYWHERE and not any(_inside(folder, name) for folder in subfolders):
            known = ", ".join(sorted(filter(None, subfolders))) or "none"
            raise InputError(
                f"intrinsics are given for the subfolder '{name}', which has no photographs; the "
                f"subfolders are: {known}"
            )
    index: dict[Hashable, int] = {}
    cameras: list[Camera] = []
    members: list[list[str]] = []
    doubts: list[list[str]] = []
    chosen = []
    for photograph in collection.photographs:
        text = _text_for(photograph.subfolder, given)
        key = _origin(photograph, text)
        if key not in index:
            index[key] = len(cameras)
            with collected() as messages:
                cameras.append(_camera(photograph, text))
            members.append([])
            doubts.append(messages)
        chosen.append(index[key])
        members[index[key]].append(photograph.name)
    warnings = tuple(
        message if len(names) == 1 else f"{message} (the same for {len(names)} photographs)"
        for names, messages in zip(members, doubts)
        for message in messages
    )
    return SharedCameras(tuple(cameras), tuple(chosen), warnings)


def _inside(folder: str, name: str) -> bool:
    return folder == name or folder.startswith(f"{name}/")


def _text_for(subfolder: str, given: Mapping[str, str]) -> str | None:
    """Return the intrinsics of the innermost subfolder for which they are given."""
    fitting = [name for name in given if name == EVERYWHERE or _inside(subfolder, name)]
    return given[max(fitting, key=len)] if fitting else None


def _origin(photograph: Photograph, text: str | None) -> Hashable:
    """Return a key that is equal for photographs of one camera."""
    exif = photograph.header.exif
    layout = (photograph.size_wh, photograph.header.orientation)
    if text is not None:
        return (text, layout)
    if exif is None:
        return (photograph.subfolder, layout)
    lens = (exif.make, exif.model, exif.focal_mm, exif.focal_35mm, exif.digital_zoom)
    return (photograph.subfolder, layout, lens, exif.focal_plane_resolution, exif.size_wh)


def _camera(photograph: Photograph, text: str | None) -> Camera:
    if text is None:
        return camera_from_exif(photograph.header)
    header = photograph.header
    try:
        return parse_intrinsics(text, header.size_wh, orientation=header.orientation)
    except CameraError as error:
        raise CameraError(f"{photograph.name}: {error}") from None
