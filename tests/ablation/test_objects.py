"""Stores of a cache: a folder, memory, and an S3-compatible server where moto is installed."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

from sfmkit.ablation import ablate, engine_choice
from sfmkit.ablation.cache import Cache
from sfmkit.ablation.entry import Entry
from sfmkit.ablation.objects import open_objects
from sfmkit.errors import InputError, OutputError

pytest.importorskip("fsspec", reason="fsspec is not installed (the remote extra)")


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """A bucket of a server on loopback."""
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    try:
        host, port = server.get_host_and_port()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
            patch.setenv("AWS_ACCESS_KEY_ID", "test")
            patch.setenv("AWS_SECRET_ACCESS_KEY", "test")
            patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
            import boto3

            boto3.client("s3").create_bucket(Bucket="sweeps")
            yield "s3://sweeps"
    finally:
        server.stop()


@pytest.fixture(params=["folder", "file", "memory", "s3"])
def location(request, tmp_path) -> str:
    if request.param == "s3":
        return f"{request.getfixturevalue('bucket')}/{tmp_path.name}"
    name = {"folder": "", "file": "file://", "memory": "memory:/"}[request.param]
    return f"{name}{tmp_path / 'cache'}"


def entry(k: int) -> Entry:
    return Entry(f"{k:040x}", {"seconds": 0.25}, {"x": np.full((50, 2), k)})


def test_a_cache_in_every_store_keeps_bounds_and_checks_its_entries(location):
    cache = Cache(location, limit=6 * len(entry(0).to_bytes()))
    cache.check(local_workers=False)
    assert cache.stats().entries == 0
    assert cache.get("features", entry(0).key) is None
    for k in range(10):
        cache.put("features", entry(k))
    other = Cache(cache.location)  # as another process opens it
    found = other.get("features", entry(3).key)
    assert found is not None
    np.testing.assert_array_equal(found.arrays["x"], np.full((50, 2), 3))
    assert (other.has("features", entry(3).key), other.has("matches", entry(3).key)) == (1, 0)
    assert other.stats().kinds["features"] == (10, 10 * len(entry(0).to_bytes()))
    other.put_bytes("features", entry(9).key, b"rubbish")
    assert other.verify()[0] == 10
    assert other.stats().entries == 9
    assert cache.tidy() > 0
    assert cache.stats().nbytes <= cache.limit
    with cache.token() as token:
        assert other.sees(token)
    assert not other.sees(token)
    cache.clear()
    assert cache.stats().entries == 0


def test_a_sweep_with_its_cache_in_a_bucket_gives_the_same_rows(bucket, tmp_path, monkeypatch):
    from small_sweep import InlineEngine, pairs

    monkeypatch.setattr(engine_choice, "LocalEngine", InlineEngine)
    images = pairs(tmp_path / "images", 1, 1)
    table, truth = (
        ablate(images, ["orb", "akaze"], cache=cache)
        for cache in (f"{bucket}/sweep", tmp_path / "cache")
    )
    assert table.results() == truth.results()
    assert Cache(f"{bucket}/sweep").stats().kinds["estimates"][0] == len(table)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("nonsense://bucket/cache", "cannot be opened.*nonsense"),
        ("file://relative/folder", "file:///absolute"),
    ],
)
def test_urls_that_cannot_be_opened(url, message):
    with pytest.raises(InputError, match=message):
        open_objects(url)


def test_a_scheme_without_its_package(monkeypatch):
    import fsspec.core

    def missing(url: str, **options: object) -> None:
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr(fsspec.core, "url_to_fs", missing)
    with pytest.raises(InputError, match="needs another package: Install s3fs"):
        open_objects("s3://bucket/cache")


def test_missing_rights_and_a_missing_bucket_are_reported_before_the_work(monkeypatch):
    from fsspec.implementations.memory import MemoryFileSystem

    def denied(self: object, path: str, value: bytes, **options: object) -> None:
        raise PermissionError("Access Denied")

    monkeypatch.setattr(MemoryFileSystem, "pipe_file", denied)
    with pytest.raises(InputError, match=r"cannot be written.*memory://denied: Access Denied"):
        Cache("memory://denied").check(local_workers=False)
    with pytest.raises(OutputError, match="cannot be written: Access Denied"):
        Cache("memory://denied").put("features", entry(0))


def test_a_bucket_that_does_not_exist(bucket):
    with pytest.raises(InputError, match="s3://absent/cache"):
        Cache("s3://absent/cache").check(local_workers=False)


def test_local_processes_do_not_share_memory(tmp_path):
    from small_sweep import pairs

    with pytest.raises(InputError, match="exists in one process only"):
        ablate(pairs(tmp_path / "images", 1, 0), ["orb"], cache="memory://local")


def test_a_relative_folder_has_an_absolute_location(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert open_objects("cache").location == os.path.join(tmp_path, "cache")
