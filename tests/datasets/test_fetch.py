"""Fetching over a local server: resuming, mirrors, checks; and archives that must not be
unpacked."""

from __future__ import annotations

import contextlib
import hashlib
import io
import random
import tarfile
import threading
import zipfile
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from click.testing import CliRunner
from PIL import Image

import sfmkit.datasets.catalog as catalog
from sfmkit.cli.data import data as data_commands
from sfmkit.datasets.archives import unpack
from sfmkit.datasets.catalog import DatasetSpec, Download, check_folder, fingerprint
from sfmkit.datasets.fetch import fetch
from sfmkit.errors import InputError

LIMITS = {"max_files": 10, "max_bytes": 100_000}


class Server:
    """Files under 127.0.0.1, with ranges; `cut` closes the connection after that many bytes,
    once."""

    def __init__(self):
        self.files: dict[str, bytes] = {}
        self.requests: list[tuple[str, str | None]] = []
        self.cut: int | None = None
        self.ranges = True
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                name, wanted = self.path.strip("/"), self.headers.get("Range")
                outer.requests.append((name, wanted))
                if name not in outer.files:
                    self.send_error(404)
                    return
                body = outer.files[name]
                start = (
                    int(wanted.removeprefix("bytes=").rstrip("-")) if wanted and outer.ranges else 0
                )
                if start and start >= len(body):
                    self.send_error(416)
                    return
                self.send_response(206 if start else 200)
                self.send_header("Content-Length", str(len(body) - start))
                self.end_headers()
                end = len(body)
                if outer.cut is not None:
                    end, outer.cut = outer.cut, None
                self.wfile.write(body[start:end])

            def log_message(self, *_):
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.http.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self.http.server_port}"


@pytest.fixture
def server():
    s = Server()
    yield s
    s.http.shutdown()
    s.http.server_close()


def tar_of(files: dict[str, bytes], **members: tarfile.TarInfo) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as tar:
        for name, body in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(body)
            tar.addfile(info, io.BytesIO(body))
        for info in members.values():
            tar.addfile(info)
    return out.getvalue()


def picture(colour=(200, 10, 10), format="PPM") -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (40, 30), colour).save(out, format)
    return out.getvalue()


@pytest.fixture
def spec(server, tmp_path, monkeypatch):
    """A data set of one archive, pinned by the pixels of a PNG and the words of a text file."""
    (tmp_path / "img1.png").write_bytes(picture(format="PNG"))
    (tmp_path / "H1to2p").write_text("1 0 0\n0 1 0\n0 0 1")
    pins = {
        "toy": {
            "a/img1": fingerprint(tmp_path / "img1.png"),
            "a/H1to2p": fingerprint(tmp_path / "H1to2p"),
        }
    }
    monkeypatch.setattr(catalog, "_checksums", lambda: pins)
    server.files["a.tar.gz"] = tar_of(
        {"a/img1.ppm": picture(), "a/H1to2p": b"1 0 0 \r\n 0 1 0 \r\n 0 0 1 \r\n"}
    )
    download = Download((f"{server.url}/gone.tar.gz", f"{server.url}/a.tar.gz"), folder="a")
    return DatasetSpec("toy", "A toy", "home", "terms", "cite", 1, (download,))


def names(folder):
    return sorted(str(f.relative_to(folder)) for f in folder.rglob("*") if f.is_file())


def test_fetch_takes_the_mirror_and_checks_pixels_and_words(spec, server, tmp_path):
    seen = []
    root = fetch(spec, tmp_path / "data", lambda *a, **k: seen.append((*a, k["fraction"])))
    assert names(tmp_path / "data") == ["toy/a/H1to2p", "toy/a/img1.ppm"]
    assert seen[-1] == ("download", "a.tar.gz", 1.0)
    asked = len(server.requests)
    assert fetch(spec, tmp_path / "data") == root
    assert len(server.requests) == asked, "what is there is not fetched again"
    assert check_folder(spec, root) == []
    (root / "a/img1.ppm").write_bytes(picture((0, 0, 0)))
    (root / "a/H1to2p").unlink()
    assert [line.split(":")[0] for line in check_folder(spec, root)] == ["a/img1", "a/H1to2p"]


def test_an_interrupted_download_goes_on(spec, server, tmp_path, monkeypatch):
    monkeypatch.setattr("sfmkit.datasets.fetch._CHUNK", 10)
    body = server.files["a.tar.gz"]
    server.cut = 50
    with pytest.raises(InputError, match=r"closed after 50 of.*to resume.*off-line"):
        fetch(spec, tmp_path / "data")
    assert not (tmp_path / "data/toy").exists()
    fetch(spec, tmp_path / "data")
    assert ("a.tar.gz", "bytes=50-") in server.requests
    assert names(tmp_path / "data/toy") == ["a/H1to2p", "a/img1.ppm"]
    assert len(body) > 50


@pytest.mark.parametrize("stale", [b"x" * 50, b"x" * 100_000])
def test_a_server_without_ranges_or_a_stale_part_begins_again(spec, server, tmp_path, stale):
    server.ranges = len(stale) > 1000
    store = tmp_path / "data/.toy.download"
    store.mkdir(parents=True)
    url = spec.downloads[0].urls[1]
    (store / f"{hashlib.sha256(url.encode()).hexdigest()[:12]}.part").write_bytes(stale)
    fetch(spec, tmp_path / "data")
    assert names(tmp_path / "data/toy") == ["a/H1to2p", "a/img1.ppm"]


def test_other_contents_are_refused_and_nothing_stays(spec, server, tmp_path):
    server.files["a.tar.gz"] = tar_of(
        {"a/img1.ppm": picture((1, 2, 3)), "a/H1to2p": b"1 0 0 0 1 0 0 0 1"}
    )
    with pytest.raises(InputError, match=r"has unexpected contents.*a/img1"):
        fetch(spec, tmp_path / "data")
    assert names(tmp_path / "data") == []


def test_wrong_checksum(spec, server, tmp_path):
    item = replace(spec.downloads[0], sha256="0" * 64)
    with pytest.raises(InputError, match="sha256 is not the one expected"):
        fetch(replace(spec, downloads=(item,)), tmp_path / "data")
    right = replace(spec.downloads[0], sha256=hashlib.sha256(server.files["a.tar.gz"]).hexdigest())
    fetch(replace(spec, downloads=(right,)), tmp_path / "data")


def test_no_network_says_what_to_do(spec, tmp_path):
    item = replace(spec.downloads[0], urls=("http://127.0.0.1:9/a.tar.gz",))
    with pytest.raises(InputError, match=r"no connection.*off-line, point --data or SFMKIT_DATA"):
        fetch(replace(spec, downloads=(item,)), tmp_path / "data")


def test_single_files(server, tmp_path, monkeypatch):
    server.files["x.jpg"] = picture(format="JPEG")
    pin = "bytes:" + hashlib.sha256(server.files["x.jpg"]).hexdigest()
    monkeypatch.setattr(catalog, "_checksums", lambda: {"toy": {"f/x.jpg": pin}})
    spec = DatasetSpec(
        "toy", "", "", "", "", 1, (Download((f"{server.url}/x.jpg",), "f/x.jpg", archive=False),)
    )
    fetch(spec, tmp_path)
    assert names(tmp_path) == ["toy/f/x.jpg"]
    server.files["x.jpg"] += b"\0"
    (tmp_path / "toy/f/x.jpg").unlink()
    with pytest.raises(InputError, match="has unexpected contents"):
        fetch(spec, tmp_path)
    assert names(tmp_path) == []


def link(name: str, target: str, kind: bytes) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info


@pytest.mark.parametrize(
    "body, message",
    [
        (tar_of({"../evil": b"x"}), "leads out"),
        (tar_of({"a/../../evil": b"x"}), "leads out"),
        (tar_of({"/etc/evil": b"x"}), "leads out"),
        (tar_of({}, a=link("s", "/etc/passwd", tarfile.SYMTYPE)), "link or device"),
        (tar_of({"a": b"x"}, b=link("h", "a", tarfile.LNKTYPE)), "link or device"),
        (tar_of({}, a=link("fifo", "", tarfile.FIFOTYPE)), "link or device"),
        (tar_of({str(k): b"" for k in range(11)}), "more than the 10 files"),
        (tar_of({"big": bytes(100_001)}), "more than the 100,000 bytes"),
        (tar_of({"a": b"x", "a/b": b"y"}), "twice"),
        (tar_of({"a": b"1234" * 5000})[:-40], "damaged"),
        (b"no archive at all", "not an archive"),
        (b"", "not an archive"),
        (tar_of({}), "no files"),
    ],
)
def test_bad_tar_archives_are_refused(tmp_path, body, message):
    (tmp_path / "bad.tar.gz").write_bytes(body)
    (tmp_path / "in/side").mkdir(parents=True)
    with pytest.raises(InputError, match=message):
        unpack(tmp_path / "bad.tar.gz", tmp_path / "in/side", **LIMITS)
    assert all(name.startswith("in/side/") for name in names(tmp_path) if name != "bad.tar.gz")


def test_zip_archives(tmp_path):
    file = tmp_path / "a.zip"
    with zipfile.ZipFile(file, "w") as z:
        z.writestr("top/x.txt", "hello")
        z.writestr("__MACOSX/._x", "junk")
    (tmp_path / "out").mkdir()
    assert names(unpack(file, tmp_path / "out", **LIMITS)) == ["x.txt"], (
        "the one folder inside is the contents"
    )
    with zipfile.ZipFile(file, "w") as z:
        info = zipfile.ZipInfo("s")
        info.external_attr = 0o120777 << 16
        z.writestr(info, "/etc/passwd")
    with pytest.raises(InputError, match="link or device"):
        unpack(file, tmp_path / "out", **LIMITS)
    with zipfile.ZipFile(file, "w") as z:
        z.writestr("..\\evil", "x")
    with pytest.raises(InputError, match="leads out"):
        unpack(file, tmp_path / "out", **LIMITS)


@pytest.mark.parametrize("mode", ["w", "w:gz", "w:bz2", "w:xz", "zip"])
def test_damaged_archives_are_unpacked_or_refused(tmp_path, mode):
    good, rng = tmp_path / "good", random.Random(mode)
    content = bytes(rng.randrange(256) for _ in range(600)) * 2
    if mode == "zip":
        with zipfile.ZipFile(good, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("a/x.bin", content)
    else:
        with tarfile.open(good, mode) as tar:
            info = tarfile.TarInfo("a/x.bin")
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    for k in range(60):
        data = bytearray(good.read_bytes())
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        file, folder = tmp_path / "bad", tmp_path / f"out{k}"
        file.write_bytes(data[: rng.randint(len(data) // 2, len(data))])
        folder.mkdir()
        with contextlib.suppress(InputError):
            unpack(file, folder, **LIMITS)


def test_a_refused_archive_leaves_nothing(spec, server, tmp_path):
    server.files["a.tar.gz"] = tar_of({"a/img1.ppm": picture(), "../evil": b"x"})
    with pytest.raises(InputError, match="leads out"):
        fetch(spec, tmp_path / "data")
    assert names(tmp_path / "data") == []


def test_commands(spec, tmp_path, monkeypatch):
    monkeypatch.setattr(catalog, "DATASETS", {"toy": spec})
    runner = CliRunner()
    where = ["--data", str(tmp_path / "data")]
    done = runner.invoke(data_commands, ["fetch", "toy", *where])
    assert done.exit_code == 0, done.output
    assert done.output.index("terms: terms") < done.output.index("complete")
    assert (
        "2 of 2 files as pinned" in runner.invoke(data_commands, ["verify", "toy", *where]).output
    )
    assert "A toy" in runner.invoke(data_commands, ["list", *where]).output
    (tmp_path / "data/toy/a/H1to2p").write_text("1 0 0 0 1 0 0 0")
    failed = runner.invoke(data_commands, ["verify", *where])
    assert isinstance(failed.exception, InputError)
    assert "toy/a/H1to2p" in str(failed.exception)
    with pytest.raises(InputError, match="unknown data set"):
        runner.invoke(data_commands, ["fetch", "toys", *where], catch_exceptions=False)


@pytest.mark.data
def test_shared_copies_are_as_pinned(data_dir):
    spec = catalog.DATASETS["oxford"]
    assert len(spec.pins) == 8 * 11
    assert check_folder(spec, data_dir / "oxford/graf", "graf") == []
