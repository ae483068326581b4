"""Recordings, archives, pair lists, and the files of ablations and benchmarks."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import tarfile
import zipfile
from functools import partial
from pathlib import Path
from random import Random
from subprocess import CompletedProcess
from typing import Any
from unittest import mock

import numpy as np
from fuzz.engine import Kind, write
from fuzz.mutations import choose, mutate_bytes, mutate_json, mutate_text

PAIRS = [{"image1": "a.png", "image2": "b.png", "name": "p", "K1": [500, 0, 9, 0, 500, 9, 0, 0, 1]}]
PAIRS.append({"image1": "a.png", "image2": "b.png", "H": [1, 0, 5, 0, 1, 3, 0, 0, 1]})  # type: ignore[dict-item]


def _bytes(random: Random, seeds: list[bytes]) -> bytes:
    return mutate_bytes(random, choose(random, seeds))


def _json(random: Random, seeds: list[bytes]) -> bytes:
    return mutate_json(random, random.choice(seeds))


def _text(random: Random, seeds: list[bytes]) -> bytes:
    return mutate_text(random, choose(random, seeds))


# --- recordings


def _recordings(folder: Path) -> list[bytes]:
    from made_up_result import make_result

    from sfmkit.recording import save_recording

    save_recording(
        folder / "seed.rrd", make_result(points=20, outliers=5, lonely=5, size_wh=(160, 120))
    )
    return [(folder / "seed.rrd").read_bytes()]


def _read_recording(data: bytes, folder: Path) -> None:
    from sfmkit.recording import read, read_recording
    from sfmkit.recording.inspection import describe_recording

    path = write(folder / "a.rrd", data)
    # Forked instead of started, because a new process needs half a second to import Rerun.
    with mock.patch.object(read.subprocess, "run", partial(_fork_reader, folder / "chunks")):
        recording = read_recording(path)
        for entity in recording.entities:
            recording.logged(entity)
        describe_recording(path)


def _fork_reader(out: Path, command: list[str], **_: Any) -> CompletedProcess:
    from sfmkit.recording import _reader

    child = os.fork()
    if child == 0:
        status = 1
        try:
            with out.open("wb") as stream:
                status = _reader.write_chunks(command[-1], stream)
        finally:
            os._exit(status)
    try:
        _, status = os.waitpid(child, 0)
    except BaseException:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    return CompletedProcess(command, os.waitstatus_to_exitcode(status), out.read_bytes(), b"")


# --- archives


def _archives(_: Path) -> list[bytes]:
    files = {"set/a.txt": b"a" * 300, "set/b.bin": bytes(range(256)) * 4}
    found = []
    for mode in ("w", "w:gz", "w:bz2", "w:xz"):
        memory = io.BytesIO()
        with tarfile.open(fileobj=memory, mode=mode) as archive:
            for name, data in files.items():
                info = tarfile.TarInfo(name)
                info.size = len(data)
                archive.addfile(info, io.BytesIO(data))
        found.append(memory.getvalue())
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive_:
        for name, data in files.items():
            archive_.writestr(name, data)
    return [*found, memory.getvalue()]


def _unpack(data: bytes, folder: Path) -> None:
    from sfmkit.datasets.archives import unpack

    (folder / "into").mkdir()
    path = write(folder / "archive", data)
    unpack(path, folder / "into", max_files=10, max_bytes=1_000_000)


# --- pair lists


def _csv_seed() -> bytes:
    memory = io.StringIO()
    writer = csv.DictWriter(memory, ["image1", "image2", "name", "K1", "H"])
    writer.writeheader()
    for row in PAIRS:
        cells = {k: v if isinstance(v, str) else " ".join(map(str, v)) for k, v in row.items()}
        writer.writerow(cells)
    return memory.getvalue().encode()


def _pair_list(name: str):
    def run(data: bytes, folder: Path) -> None:
        import cv2

        from sfmkit.datasets.pair_list import pair_list

        for stem in "ab":
            cv2.imwrite(str(folder / f"{stem}.png"), np.zeros((20, 20), np.uint8))
        list(pair_list(write(folder / name, data)))

    return run


# --- ablations and benchmarks


def _tables(folder: Path) -> list[bytes]:
    from made_up_sweep import made_up_rows

    from sfmkit.ablation.table import table_of
    from sfmkit.ablation.table_file import write_table

    write_table(table_of(made_up_rows(pairs=3, seeds=1)), folder / "seed.parquet")
    return [(folder / "seed.parquet").read_bytes()]


def _read_table(data: bytes, folder: Path) -> None:
    from sfmkit.ablation.table import read_table

    read_table(write(folder / "ablation.parquet", data))


def _read_shard(data: bytes, folder: Path) -> None:
    from sfmkit.ablation.table_file import read_shard

    read_shard(write(folder / "shard.parquet", data))


def _sweeps(folder: Path) -> list[bytes]:
    from sfmkit.ablation.folder import write_sweep

    write_sweep(folder, {"operators": ["surf"], "combinations": [["surf"]], "pairs": [{"a": 1}]})
    return [(folder / "sweep.json").read_bytes()]


def _read_sweep(data: bytes, folder: Path) -> None:
    from sfmkit.ablation.folder import read_sweep

    write(folder / "sweep.json", data)
    read_sweep(folder)


def _rows(_: Path) -> list[bytes]:
    lines = [{"settings": {"seed": 0}}, {"pair": "a", "error": 0.5}, {"pair": "b", "error": None}]
    return ["".join(json.dumps(line) + "\n" for line in lines).encode()]


def _read_rows(data: bytes, folder: Path) -> None:
    from sfmkit.evaluation.rows import RowStore

    RowStore(write(folder / "rows.jsonl", data), {"seed": 0}).read()


def _entries(_: Path) -> list[bytes]:
    from sfmkit.ablation.entry import Entry

    arrays = {"xy": np.zeros((3, 2), np.float32), "names": np.array(["surf"])}
    return [Entry("ab" * 16, {"seconds": 1.0}, arrays).to_bytes()]


def _read_entry(data: bytes, folder: Path) -> None:
    from sfmkit.ablation.cache import Cache

    store = Cache(folder / "cache")
    path = folder / "cache" / store.name("features", "ab" * 16)
    path.parent.mkdir(parents=True)
    write(path, data)
    store.stats()
    store.verify()
    write(path, data)
    store.get("features", "ab" * 16)


KINDS = [
    Kind("recording", _recordings, _bytes, _read_recording),
    Kind("archive", _archives, _bytes, _unpack),
    Kind("pairs-json", lambda _: [json.dumps(PAIRS).encode()], _json, _pair_list("pairs.json")),
    Kind("pairs-csv", lambda _: [_csv_seed()], _text, _pair_list("pairs.csv")),
    Kind("table", _tables, _bytes, _read_table),
    Kind("shard", _tables, _bytes, _read_shard),
    Kind("sweep", _sweeps, _json, _read_sweep),
    Kind("rows", _rows, _text, _read_rows),
    Kind("cache-entry", _entries, _bytes, _read_entry),
]
