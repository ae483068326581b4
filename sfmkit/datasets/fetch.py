"""Download of data sets: mirrors, resumption, verification and atomic installation."""

from __future__ import annotations

import hashlib
import os
import shutil
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pooch
import requests

from .._utils.progress import Progress
from .._utils.writing import check_folder as check_writable
from .._utils.writing import staged_folder
from ..errors import InputError
from .archives import unpack
from .catalog import DatasetSpec, Download, check_folder
from .pair import VARIABLE, download_folder

_CHUNK = 1 << 17
_TIMEOUT_S = 30


def fetch(
    spec: DatasetSpec, data: str | os.PathLike | None = None, progress: Progress | None = None
) -> Path:
    """Download the missing files of a data set, verify and install them.

    Correct files are kept unchanged. An interrupted download is resumed.

    Args:
        spec: Data set to download.
        data: Folder that will contain the folder of the data set; None for ``sfmkit`` in the user's
            cache folder.
        progress: Called with (``download``, file) and the fraction of the file that is downloaded.

    Returns:
        The folder of the data set.

    Raises:
        InputError: No address can be reached, or the download is damaged or has other contents; it
            is not kept.
        OutputError: The folder cannot be written.
    """
    pooch.get_logger().setLevel("WARNING")
    root = (download_folder() if data is None else Path(data)) / spec.name
    check_writable(root)
    store = root.with_name(f".{spec.name}.download")
    for item in spec.downloads:
        if _present(spec, item, root):
            continue
        file = download(item, store, progress)
        try:
            _install(spec, item, file, root)
        finally:
            file.unlink(missing_ok=True)
    shutil.rmtree(store, ignore_errors=True)
    return root


def _present(spec: DatasetSpec, item: Download, root: Path) -> bool:
    """Return whether the files of a download exist and match their checksums."""
    there = root / item.folder
    if not there.exists() or (there.is_dir() and not any(there.iterdir())):
        return False
    return not check_folder(spec, there, item.folder)


def _install(spec: DatasetSpec, item: Download, file: Path, root: Path) -> None:
    """Verify a download, and move it to its destination if it is correct."""
    target = root / item.folder
    if not item.archive:
        _check(spec, item, file, file)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, target)
        return
    with TemporaryDirectory(dir=file.parent) as scratch:
        inside = unpack(file, Path(scratch), max_files=item.max_files, max_bytes=item.max_bytes)
        _check(spec, item, file, inside)
        with staged_folder(target, overwrite=True) as staged:
            for entry in inside.iterdir():
                shutil.move(entry, staged / entry.name)


def _check(spec: DatasetSpec, item: Download, file: Path, contents: Path) -> None:
    wrong = check_folder(spec, contents, item.folder)
    if wrong:
        raise InputError(
            f"{file.name} has unexpected contents and is not kept: {len(wrong)} of its files "
            "are missing or differ, "
            f"e.g. {wrong[0]}"
        )


def download(item: Download, store: Path, progress: Progress | None = None) -> Path:
    """Download a file from the first of its addresses that provides it.

    Raises:
        InputError: No address provides it, or its checksum is wrong.
    """
    name = item.urls[0].rsplit("/", 1)[-1]
    failures = []
    for url in item.urls:
        part = store / f"{hashlib.sha256(url.encode()).hexdigest()[:12]}.part"
        try:
            # pooch verifies the checksum, and moves only a correct file to its destination.
            return Path(
                pooch.retrieve(
                    url,
                    known_hash=None if item.sha256 is None else f"sha256:{item.sha256}",
                    fname=url.rsplit("/", 1)[-1],
                    path=store,
                    downloader=_Resuming(part, progress),
                )
            )
        except requests.RequestException as error:
            failures.append(f"{url}: {_reason(error)}")
        except ValueError:
            failures.append(
                f"{url}: its sha256 is not the one expected, {str(item.sha256)[:12]}..."
            )
    raise InputError(
        f"{name} could not be fetched: "
        + "; ".join(failures)
        + ". Run the command again to resume; "
        f"off-line, point --data or {VARIABLE} to a copy"
    )


class _Resuming:
    """A downloader for pooch that resumes interrupted downloads."""

    def __init__(self, part: Path, progress: Progress | None):
        self.part, self.progress = part, progress

    def __call__(self, url: str, output_file: str, pooch_: object) -> None:
        self.part.parent.mkdir(parents=True, exist_ok=True)
        done = self.part.stat().st_size if self.part.exists() else 0
        # Transparent compression would make ranges and lengths meaningless.
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={done}-"} if done else {})
        with requests.get(url, headers=headers, stream=True, timeout=_TIMEOUT_S) as answer:
            if (
                answer.status_code == 416
            ):  # no data after the partial file, or another file: start again
                self.part.unlink()
                return self(url, output_file, pooch_)
            answer.raise_for_status()
            if answer.status_code != 206:
                done = 0
            length = answer.headers.get("Content-Length")
            total = None if length is None else done + int(length)
            # An interrupted connection is detected below by the missing bytes.
            with self.part.open("ab" if done else "wb") as out, suppress(requests.RequestException):
                for chunk in answer.iter_content(_CHUNK):
                    out.write(chunk)
                    done += len(chunk)
                    if self.progress is not None:
                        share = None if not total else done / total
                        self.progress("download", url.rsplit("/", 1)[-1], fraction=share)
        if total is not None and done < total:
            raise requests.ConnectionError(
                f"the connection closed after {done:,} of {total:,} bytes"
            )
        shutil.move(self.part, output_file)


def _reason(error: requests.RequestException) -> str:
    if error.response is not None:
        return f"the server answers {error.response.status_code} {error.response.reason}"
    if isinstance(error, requests.Timeout):
        return "no answer in time"
    text = str(error)
    return text if text.startswith("the connection closed") else "no connection"
