"""Outputs appear whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from sfmkit._utils.writing import (
    atomic_write,
    check_file,
    check_folder,
    check_free,
    staged_folder,
)
from sfmkit.errors import OutputError


def tree(folder: Path) -> dict[str, str | None]:
    """Every path below `folder`, hidden ones included, and what the files hold."""
    return {
        str(p.relative_to(folder)): p.read_text() if p.is_file() else None
        for p in folder.rglob("*")
    }


FAILURES = [
    KeyboardInterrupt(),
    ValueError("a bug"),
    OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)),
    SystemExit(1),
]


def test_file_is_written_and_replaced(tmp_path):
    for text in ("first", "second"):
        with atomic_write(tmp_path / "a.txt") as path:
            assert path.parent == tmp_path
            path.write_text(text)
        assert tree(tmp_path) == {"a.txt": text}
    plain = tmp_path / "plain"
    plain.touch()
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


@pytest.mark.parametrize("failure", FAILURES, ids=lambda f: type(f).__name__)
def test_failed_file_leaves_the_old_one(tmp_path, failure):
    (tmp_path / "a.txt").write_text("old")
    with (  # noqa: PT012
        pytest.raises(OutputError if isinstance(failure, OSError) else type(failure)),
        atomic_write(tmp_path / "a.txt") as path,
    ):
        path.write_text("half")
        raise failure
    assert tree(tmp_path) == {"a.txt": "old"}


def test_file_that_cannot_be(tmp_path):
    with pytest.raises(OutputError, match="is a folder"), atomic_write(tmp_path):
        pass
    with (
        pytest.raises(OutputError, match="cannot be written: No such file"),
        atomic_write(tmp_path / "no" / "a"),
    ):
        pass


def test_folder_with_its_parents(tmp_path):
    with staged_folder(tmp_path / "a" / "b") as folder:
        assert folder.name.startswith(".sfmkit-")
        (folder / "sub").mkdir()
        (folder / "sub" / "x").write_text("x")
        assert not (tmp_path / "a" / "b").exists()
    assert tree(tmp_path) == {"a": None, "a/b": None, "a/b/sub": None, "a/b/sub/x": "x"}


def test_existing_folder_is_refused_before_anything_is_written(tmp_path):
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "precious").write_text("p")
    with pytest.raises(OutputError, match="--overwrite"), staged_folder(tmp_path / "o"):
        pytest.fail("must not come this far")
    assert tree(tmp_path) == {"o": None, "o/precious": "p"}


def test_folder_that_appears_meanwhile_is_kept(tmp_path):
    with pytest.raises(OutputError, match="meantime"), staged_folder(tmp_path / "o") as folder:  # noqa: PT012
        (folder / "x").write_text("x")
        (tmp_path / "o").mkdir()
        (tmp_path / "o" / "other").write_text("o")
    assert tree(tmp_path) == {"o": None, "o/other": "o"}


def test_overwrite_replaces_the_whole_folder(tmp_path):
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "old").write_text("old")
    with staged_folder(tmp_path / "o", overwrite=True) as folder:
        (folder / "new").write_text("new")
        assert tree(tmp_path / "o") == {"old": "old"}
    assert tree(tmp_path) == {"o": None, "o/new": "new"}


def test_overwrite_replaces_a_link_and_keeps_its_target(tmp_path):
    (tmp_path / "target").mkdir()
    (tmp_path / "target" / "precious").write_text("p")
    (tmp_path / "o").symlink_to(tmp_path / "target")
    with staged_folder(tmp_path / "o", overwrite=True) as folder:
        (folder / "new").write_text("new")
    assert tree(tmp_path) == {"target": None, "target/precious": "p", "o": None, "o/new": "new"}


@pytest.mark.parametrize("failure", FAILURES, ids=lambda f: type(f).__name__)
@pytest.mark.parametrize("exists", [True, False])
def test_failed_folder_leaves_the_old_one_and_no_parents(tmp_path, failure, exists):
    out = tmp_path / "a" / "b" / "o"
    if exists:
        out.mkdir(parents=True)
        (out / "old").write_text("old")
    before = tree(tmp_path)
    with (  # noqa: PT012
        pytest.raises(OutputError if isinstance(failure, OSError) else type(failure)),
        staged_folder(out, overwrite=True) as folder,
    ):
        (folder / "half").write_text("half")
        raise failure
    assert tree(tmp_path) == before


def test_failure_between_the_two_moves_restores_the_old_folder(tmp_path, monkeypatch):
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "old").write_text("old")
    real = Path.rename

    def rename(self, target):
        if (self / "new").exists():
            raise KeyboardInterrupt
        return real(self, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(KeyboardInterrupt), staged_folder(tmp_path / "o", overwrite=True) as folder:
        (folder / "new").write_text("new")
    assert tree(tmp_path) == {"o": None, "o/old": "old"}


def test_folder_that_cannot_be(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("f")
    with (
        pytest.raises(OutputError, match="is a file"),
        staged_folder(tmp_path / "file", overwrite=True),
    ):
        pass
    with (
        pytest.raises(OutputError, match=r"cannot be written: (File exists|Not a directory)"),
        staged_folder(tmp_path / "file" / "o"),
    ):
        pass
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match="working folder"), staged_folder(".", overwrite=True):
        pass
    assert tree(tmp_path) == {"file": "f"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="Permission denied"), staged_folder(tmp_path / "o"):
        pass


# Runs in namespaces of its own, where the caller is root over a 64 KiB disk that no other process
# sees.
FULL_DISK = """
import subprocess, sys
from pathlib import Path
from sfmkit.errors import OutputError
from sfmkit._utils.writing import atomic_write, staged_folder
disk = Path(sys.argv[1])
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], check=True)
(disk / "o").mkdir()
(disk / "o" / "old").write_text("old")
managers = ((staged_folder(disk / "o", overwrite=True), "x"), (atomic_write(disk / "x"), ""))
for manager, name in managers:
    try:
        with manager as path:
            (path / name).write_bytes(bytes(1 << 20))
    except OutputError as error:
        assert "No space left" in str(error), error
    else:
        raise SystemExit("a full disk went unnoticed")
    left = sorted(str(p.relative_to(disk)) for p in disk.rglob("*"))
    assert left == ["o", "o/old"], left
print("done")
"""


def test_disk_full(tmp_path):
    unshare = shutil.which("unshare")
    own = [unshare or "", "--user", "--map-root-user", "--mount"]
    if (
        unshare is None
        or subprocess.run(
            [*own, "mount", "-t", "tmpfs", "tmpfs", tmp_path], capture_output=True
        ).returncode
    ):
        pytest.skip("this system lets nobody mount a small disk")
    done = subprocess.run(
        [*own, sys.executable, "-c", FULL_DISK, tmp_path], capture_output=True, text=True
    )
    assert done.stdout == "done\n", done.stderr


KILLED = """
import os, signal, sys
from sfmkit._utils.writing import atomic_write, staged_folder
with staged_folder(sys.argv[1] + "/o") as folder, atomic_write(sys.argv[1] + "/a.npz") as file:
    (folder / "cloud.ply").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_left_is_removed_by_the_next_and_nothing_else(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    left = list(tmp_path.iterdir())
    assert len(left) == 2
    assert all(p.name.startswith(".sfmkit-") for p in left)
    place = left[0].name.split("-")[1]
    kept = {
        f".sfmkit-{place}-{os.getpid()}-01234567",  # of a process that runs
        f".sfmkit-{place}-99999999-0123456",  # not our pattern
        ".sfmkit-notes",
        ".o.7c5480fd",
        ".sfmkit-01234567-99999999-01234567",  # of another machine or boot, an hour old
    }
    for name in kept:
        (tmp_path / name).mkdir()
    old = tmp_path / ".sfmkit-01234567-99999999-89abcdef"
    old.mkdir()
    os.utime(old, (0, 0))
    target = tmp_path / "target"
    target.mkdir()
    (target / "precious").write_text("p")
    link = tmp_path / f".sfmkit-{place}-99999999-01234567"
    link.symlink_to(target)
    with staged_folder(tmp_path / "o") as folder:
        (folder / "new").write_text("new")
    assert {p.name for p in tmp_path.iterdir()} == kept | {"o", "target", link.name}
    assert (target / "precious").read_text() == "p"


def test_a_name_may_be_as_long_as_the_system_takes(tmp_path):
    with staged_folder(tmp_path / ("a" * 255)) as folder:
        (folder / "x").write_text("x")
    with atomic_write(tmp_path / ("b" * 200 + "." + "c" * 54)) as file:
        file.write_text("x")
    for name, reason in (
        ("a" * 256, "255"),
        ("é" * 128, "255"),
        ("a\0b", "zero byte"),
        ("a/" * 3000, "too long"),
    ):
        for manager in (staged_folder, atomic_write):
            with pytest.raises(OutputError, match=reason), manager(tmp_path / name):
                pass
        with pytest.raises(OutputError, match=reason):
            check_free(tmp_path / name / "below", overwrite=False)


def test_the_check_before_the_work(tmp_path, monkeypatch):
    check_free(tmp_path / "a" / "b" / "c", overwrite=False)
    check_free(tmp_path / "caf\udce9", overwrite=False)  # not UTF-8, which the system takes
    assert tree(tmp_path) == {}
    (tmp_path / "file").write_text("f")
    for bad, reason in (
        (tmp_path / "file", "is a file"),
        (tmp_path / "file" / "o" / "p", "is not a folder"),
        (Path("/proc/x/y"), "cannot be written"),
    ):
        if bad.parts[1] != "proc" or Path("/proc").is_dir():
            with pytest.raises(OutputError, match=reason):
                check_free(bad, overwrite=True)
            with pytest.raises(OutputError, match=reason):
                check_folder(bad)
    check_folder(tmp_path)
    check_folder(tmp_path / "a" / "b")
    check_file(tmp_path / "file")  # would be replaced
    check_file(tmp_path / "new")
    for bad, reason in (
        (tmp_path, "is a folder"),
        (tmp_path / "a" / "b", "there is no folder"),
        (tmp_path / "file" / "b", "is not a folder"),
    ):
        with pytest.raises(OutputError, match=reason):
            check_file(bad)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1 << 20))
    with pytest.raises(OutputError, match=r"1\.0 MiB are left"):
        check_free(tmp_path / "o", overwrite=False)
    assert tree(tmp_path) == {"file": "f"}
