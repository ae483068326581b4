"""Fetching data sets: with mirrors, resumable, checked, and nothing half-extracted left behind."""

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
    """Download what is missing of a data set, check it, and put it in place.

    Files that are there and right are left alone. An interrupted download is resumed.

    Args:
        data: the folder to put the data set's folder into; None for ``sfmkit`` in the user's cache
            folder.
        progress: called with (``download``, file) and the fraction of the file that is there.

    Returns:
        the data set's folder.

    Raises:
        InputError: no address answers, or what comes is damaged or something else; nothing of it is
            kept.
        OutputError: the folder cannot be written.
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
    """Whether what the download would bring is there, and right as far as it is pinned."""
    there = root / item.folder
    if not there.exists() or (there.is_dir() and not any(there.iterdir())):
        return False
    return not check_folder(spec, there, item.folder)


def _install(spec: DatasetSpec, item: Download, file: Path, root: Path) -> None:
    """Check what came, and move it to its place only if it is right."""
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
            f"{file.name} is not what it should be, and is not kept: {len(wrong)} of its files "
            "are missing or differ, "
            f"e.g. {wrong[0]}"
        )


def download(item: Download, store: Path, progress: Progress | None = None) -> Path:
    """The file of a download, from the first of its addresses that has it.

    Raises:
        InputError: none has it, or its checksum is wrong.
    """
    name = item.urls[0].rsplit("/", 1)[-1]
    failures = []
    for url in item.urls:
        part = store / f"{hashlib.sha256(url.encode()).hexdigest()[:12]}.part"
        try:
            # pooch compares the checksum, and moves the file into place only if it is right.
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
        + ". Run the command again to go on where it stopped; "
        f"off-line, point --data or {VARIABLE} to a copy"
    )


class _Resuming:
    """A downloader for pooch that keeps what came before an interruption, and asks for the rest."""

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
            ):  # nothing after what we have, or the file has changed: begin again
                self.part.unlink()
                return self(url, output_file, pooch_)
            answer.raise_for_status()
            if answer.status_code != 206:
                done = 0
            length = answer.headers.get("Content-Length")
            total = None if length is None else done + int(length)
            # An interrupted connection shows below, in what is missing.
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
