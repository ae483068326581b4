"""The cache: by content, whole or not at all, bounded, checked."""

from __future__ import annotations

import errno
import hashlib
import os
import pickletools
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from sfmkit.ablation.cache import Cache
from sfmkit.ablation.entry import DamagedEntry, Entry
from sfmkit.errors import InputError, OutputError


def entry(key: str = "ab" * 20, n: int = 50, fill: float = 1.5) -> Entry:
    return Entry(
        key,
        {"seconds": 0.25, "H": [1.0, None]},
        {"x": np.full((n, 2), fill), "empty": np.zeros((0, 4), np.uint8)},
    )


def test_what_is_put_in_comes_out(tmp_path):
    cache, e = Cache(tmp_path / "cache"), entry()
    assert cache.get("features", e.key) is None
    cache.put("features", e)
    found = cache.get("features", e.key)
    assert found is not None
    assert found.meta == e.meta
    assert found.arrays.keys() == e.arrays.keys()
    for name, a in e.arrays.items():
        assert found.arrays[name].dtype == a.dtype
        np.testing.assert_array_equal(found.arrays[name], a)


def test_nothing_in_it_is_pickled(tmp_path):
    cache, e = Cache(tmp_path), entry()
    cache.put("features", e)
    with zipfile.ZipFile(tmp_path / cache.name("features", e.key)) as archive:
        for name in archive.namelist():
            assert archive.read(name).startswith(b"\x93NUMPY")
            assert b"|O" not in archive.read(name)[:128]
    with pytest.raises(ValueError):
        list(pickletools.genops((tmp_path / cache.name("features", e.key)).read_bytes()))
    objects = Entry("k", {}, {"x": np.array([{}], dtype=object)}).to_bytes()
    with pytest.raises(
        DamagedEntry
    ):  # the object array was pickled into the bytes; it must not be read back
        Entry.from_bytes(objects, "k")


@pytest.mark.parametrize("place", [0.0, 0.2, 0.5, 0.9])
def test_a_flipped_byte_is_noticed_said_and_removed(tmp_path, place):
    cache, e = Cache(tmp_path), entry()
    cache.put("features", e)
    path = tmp_path / cache.name("features", e.key)
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 0xFF
    path.write_bytes(bytes(data))
    said: list[str] = []
    assert cache.get("features", e.key, said.append) is None
    assert "computed again" in said[0]
    assert not path.exists()


def test_no_flip_of_a_single_bit_is_accepted():
    data = entry(n=3).to_bytes()
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DamagedEntry):
            Entry.from_bytes(bytes(damaged), entry().key)


@pytest.mark.parametrize("content", [b"", b"PK", b"\0" * 100])
def test_bytes_with_a_right_digest_that_are_not_an_entry(content):
    with pytest.raises(DamagedEntry, match="damaged"):
        Entry.from_bytes(content + hashlib.sha256(content).digest(), "k")


def test_a_cut_off_entry_is_noticed(tmp_path):
    cache, e = Cache(tmp_path), entry()
    cache.put("matches", e)
    path = tmp_path / cache.name("matches", e.key)
    path.write_bytes(path.read_bytes()[:-40])
    assert cache.get("matches", e.key) is None


def test_an_entry_under_another_key_is_not_believed(tmp_path):
    cache, e = Cache(tmp_path), entry()
    other = "cd" * 20
    cache.put_bytes("features", other, e.to_bytes())
    assert cache.get("features", other) is None


def test_verify_finds_and_drops_what_is_damaged(tmp_path):
    cache = Cache(tmp_path)
    for k in range(5):
        cache.put("features", entry(f"{k:040x}"))
    (tmp_path / cache.name("features", f"{3:040x}")).write_bytes(b"rubbish")
    n, damaged = cache.verify()
    assert (n, len(damaged)) == (5, 1)
    assert cache.verify() == (4, [])


def test_it_stays_below_its_limit_and_drops_the_least_recently_used(tmp_path):
    size = len(entry().to_bytes())
    cache = Cache(tmp_path, limit=6 * size)
    for k in range(10):
        cache.put("features", entry(f"{k:040x}"))
        os.utime(tmp_path / cache.name("features", f"{k:040x}"), (1e9 + k, 1e9 + k))
    cache.get("features", f"{0:040x}")  # the oldest is used, and so the youngest
    assert cache.tidy() >= 4 * size
    left = {int(f.stem, 16) for f in tmp_path.rglob("*.npz")}
    assert cache.stats().nbytes <= 6 * size
    assert left == {0, 6, 7, 8, 9}


def test_clear_leaves_nothing(tmp_path):
    cache = Cache(tmp_path)
    cache.put("features", entry())
    cache.put("estimates", entry("cd" * 20))
    assert cache.clear().entries == 2
    assert cache.stats().entries == 0
    assert not list(tmp_path.rglob("*.npz"))


def test_concurrent_writers_and_readers_see_whole_entries(tmp_path):
    cache, wrong = Cache(tmp_path), []

    def work() -> None:
        for _ in range(40):
            cache.put("features", entry(n=2000))
            found = cache.get("features", entry().key)
            if found is None or found.arrays["x"].shape != (2000, 2):
                wrong.append(found)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert not wrong
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_full_disk_is_an_error_that_says_so_and_leaves_nothing(tmp_path, monkeypatch):
    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    cache = Cache(tmp_path)
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match="No space left"):
        cache.put("features", entry())
    assert not [f for f in tmp_path.rglob("*") if f.is_file()]


def test_limits_that_make_no_sense(tmp_path):
    with pytest.raises(InputError):
        Cache(tmp_path, limit=0)
