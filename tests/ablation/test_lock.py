"""The lock of a sweep's folder: released in all cases, stale ones are recognised."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from sfmkit.ablation import lock
from sfmkit.ablation.lock import HOLDER, STALE_S, Holder, locked, read_holder
from sfmkit.errors import InputError


def leave(folder: Path, holder: Holder | bytes, age: float) -> Path:
    """A holder's file that was touched `age` seconds ago."""
    data = json.dumps(asdict(holder)).encode() if isinstance(holder, Holder) else holder
    (folder / HOLDER).write_bytes(data)
    then = time.time() - age
    os.utime(folder / HOLDER, (then, then))
    return folder / HOLDER


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, InputError, OSError])
def test_errors_and_ctrl_c_release_it(tmp_path, error):
    def work() -> None:
        with locked(tmp_path):
            assert read_holder(tmp_path / HOLDER) == Holder.here()
            raise error("stop")

    with pytest.raises(error):
        work()
    assert not (tmp_path / HOLDER).exists()
    with locked(tmp_path):
        pass
    assert [p.name for p in tmp_path.iterdir()] in ([], [".lock"])


def test_a_second_holder_is_refused(tmp_path):
    with locked(tmp_path), pytest.raises(InputError, match=f"process {os.getpid()} on"):
        locked(tmp_path).__enter__()


def test_what_a_killed_process_left_on_this_machine_is_free_at_once(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from sfmkit.ablation.lock import locked\n"
        "with locked(Path(sys.argv[1])): print('locked', flush=True); time.sleep(600)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "locked\n"
    with pytest.raises(InputError, match=f"process {process.pid} on"):
        locked(tmp_path).__enter__()
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert (tmp_path / HOLDER).exists()
    with locked(tmp_path):
        assert read_holder(tmp_path / HOLDER) == Holder.here()


def test_another_host_holds_it_while_it_shows_signs_of_life(tmp_path):
    other = Holder(1, "elsewhere", "another boot")
    leave(tmp_path, other, STALE_S / 2)
    with pytest.raises(InputError, match=r"process 1 on elsewhere.*sign of life"):
        locked(tmp_path).__enter__()
    leave(tmp_path, other, STALE_S + 5)
    with locked(tmp_path):
        assert read_holder(tmp_path / HOLDER) == Holder.here()


@pytest.mark.parametrize("data", [b"\xff\x00\xfe", b"[]", b"{}", b'{"pid": "x"}', b"[" * 10**5])
def test_a_damaged_holder_counts_by_its_age(tmp_path, data):
    file = leave(tmp_path, data, 0)
    assert read_holder(file) is None
    with pytest.raises(InputError, match="another process"):
        locked(tmp_path).__enter__()
    leave(tmp_path, data, STALE_S + 5)
    with locked(tmp_path):
        pass


def test_a_holder_shows_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "HEARTBEAT_S", 0.01)
    with locked(tmp_path):
        old = leave(tmp_path, Holder.here(), STALE_S).stat().st_mtime
        deadline = time.monotonic() + 120
        while (tmp_path / HOLDER).stat().st_mtime == old and time.monotonic() < deadline:
            time.sleep(0.01)
        assert (tmp_path / HOLDER).stat().st_mtime > old
