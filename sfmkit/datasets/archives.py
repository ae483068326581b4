"""Safe extraction of downloaded archives: no paths outside the folder, no links, bounded size."""

from __future__ import annotations

import errno
import stat
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

from ..errors import InputError

_CHUNK = 1 << 20


def unpack(archive: Path, folder: Path, *, max_files: int, max_bytes: int) -> Path:
    """Unpack a tar (plain, gz, bz2, xz) or zip archive into an existing folder.

    Args:
        archive: Path of the archive.
        folder: An empty folder; after an error the caller removes it.
        max_files, max_bytes: Largest number of files, and largest number of bytes of all files.

    Returns:
        `folder`, or its only subfolder if the archive contains just one folder.

    Raises:
        InputError: The file is not an archive or is damaged, it contains links, devices or names
            that point outside the folder, or it exceeds the limits.
        OSError: The disk is full or `folder` cannot be written.
    """
    count = total = 0
    try:
        for name, stream in _members(archive):
            target = _target(folder, name)
            if target is None:
                continue
            count += 1
            if count > max_files:
                raise InputError(
                    f"{archive.name} holds more than the {max_files:,} files expected; it is not "
                    "unpacked"
                )
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as out:
                while chunk := stream.read(_CHUNK):
                    total += len(chunk)
                    if total > max_bytes:
                        raise InputError(
                            f"{archive.name} unpacks to more than the {max_bytes:,} bytes "
                            "expected; it is not unpacked"
                        )
                    out.write(chunk)
    except InputError:
        raise
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise InputError(
            f"{archive.name} names a file twice: {error.filename}; it is not unpacked"
        ) from error
    except Exception as error:  # zlib, LZMA, bz2, tar and zip raise errors of many classes
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EACCES):
            raise
        reason = " ".join(str(error).split())  # tarfile lists one reason per line
        raise InputError(
            f"{archive.name} is damaged or not an archive ({reason}); fetch it again"
        ) from error
    if not count:
        raise InputError(f"{archive.name} holds no files")
    inside = list(folder.iterdir())
    return inside[0] if len(inside) == 1 and inside[0].is_dir() else folder


def _members(archive: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Yield the name and the contents of every file."""
    if zipfile.is_zipfile(archive):
        with zipfile.ZipFile(archive) as z:
            for info in z.infolist():
                kind = stat.S_IFMT(info.external_attr >> 16)
                if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                    raise InputError(
                        f"{archive.name} holds a link or device, '{info.filename}'; "
                        "it is not unpacked"
                    )
                _check_name(archive, info.filename)
                if not info.is_dir():
                    with z.open(info) as stream:
                        yield info.filename, stream
        return
    with tarfile.open(archive) as tar:
        for member in tar:
            if not (member.isfile() or member.isdir()):
                raise InputError(
                    f"{archive.name} holds a link or device, '{member.name}'; it is not unpacked"
                )
            _check_name(archive, member.name)
            if member.isfile():
                contents = tar.extractfile(member)
                assert contents is not None
                yield member.name, contents


def _check_name(archive: Path, name: str) -> None:
    path = PurePosixPath(name.replace("\\", "/"))
    if (
        path.is_absolute()
        or ".." in path.parts
        or (path.parts and ":" in path.parts[0])
        or "\0" in name
    ):
        raise InputError(
            f"{archive.name} holds '{name}', which leads out of its folder; it is not unpacked"
        )


def _target(folder: Path, name: str) -> Path | None:
    """Return the path of the unpacked file; None for metadata added by desktop systems."""
    parts = [part for part in PurePosixPath(name.replace("\\", "/")).parts if part != "."]
    if (
        not parts
        or parts[0] == "__MACOSX"
        or parts[-1].startswith("._")
        or parts[-1] == ".DS_Store"
    ):
        return None
    return folder.joinpath(*parts)
