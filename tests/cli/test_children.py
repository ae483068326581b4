"""Servers listen on the loopback interface, and no child process outlives its parent."""

from __future__ import annotations

import ipaddress
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

psutil = pytest.importorskip("psutil")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

SIGNALS = ["SIGTERM", "SIGHUP", "SIGINT", "SIGKILL"]
WAIT_S = 240.0  # for a busy machine; the tests go on as soon as what they wait for is there

TETHER = """
import subprocess, sys, time
from sfmkit._utils import tether
# a child that starts a child of its own; both report their process ids
child = "import os, subprocess, sys; p = subprocess.Popen(['sleep', '600']); "
child += "print(os.getpid(), p.pid, flush=True); p.wait()"
tethered = tether.start([sys.executable, "-c", child], session=True)
try:
    tethered.wait()
finally:
    tethered.end()
"""


def until(condition) -> bool:
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False


def runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def family(pid: int) -> list[psutil.Process]:
    return [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]


def listening(processes: list[psutil.Process]) -> set[tuple[str, int]]:
    found = set()
    for process in processes:
        try:
            for connection in process.net_connections(kind="inet"):
                if connection.status == psutil.CONN_LISTEN:
                    found.add((connection.laddr.ip, connection.laddr.port))
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
    return found


def start(command: list[str], **streams) -> subprocess.Popen:
    # a test runner in the background may have its children ignore SIGINT
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        start_new_session=True,
        **streams,
    )


@pytest.mark.parametrize("name", SIGNALS)
def test_a_tethered_child_and_its_children_end_with_the_parent(name):
    parent = start([sys.executable, "-c", TETHER], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert parent.stdout is not None
    children = [psutil.Process(int(word)) for word in parent.stdout.readline().split()]
    assert len(children) == 2
    guard = [p for p in family(parent.pid)[1:] if p not in children]
    parent.send_signal(signal.Signals[name])
    assert until(lambda: not any(map(runs, [*children, *guard])))
    parent.communicate()


def test_a_tethered_child_gives_its_status_and_its_output():
    from sfmkit._utils import tether

    done = tether.start(["sh", "-c", "exit 3"])
    assert done.wait() == 3
    done.end()
    killed = tether.start(["sh", "-c", "kill -KILL $$"])
    assert killed.wait() == 128 + 9
    killed.end()


@pytest.mark.slow
@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("what", ["view", "lab"])
def test_servers_are_local_and_end_with_the_command(what, name, tmp_path):
    if what == "view":
        from made_up_result import make_result

        from sfmkit.recording import save_recording

        save_recording(tmp_path / "a.rrd", make_result())
        words, ports = ["view", "--web", str(tmp_path / "a.rrd")], 2
    else:
        pytest.importorskip("jupyterlab")
        (tmp_path / "a.ipynb").write_text('{"cells": [], "metadata": {}, "nbformat": 4}')
        words, ports = ["lab", "--no-browser", "--port", "0", str(tmp_path)], 1
    with (tmp_path / "log").open("w") as log:
        parent = start([sys.executable, "-m", "sfmkit.cli", *words], stdout=log, stderr=log)
    try:
        assert until(lambda: len(listening(family(parent.pid))) >= ports), Path(
            tmp_path / "log"
        ).read_text()
        time.sleep(0.5)  # whatever else it opens
        processes = family(parent.pid)
        addresses = {ip for ip, _ in listening(processes)}
        assert all(ipaddress.ip_address(ip).is_loopback for ip in addresses), addresses
        parent.send_signal(signal.Signals[name])
        status = parent.wait(WAIT_S)
        assert until(lambda: not any(map(runs, processes))), [p for p in processes if runs(p)]
    finally:
        for process in [p for p in processes if runs(p)]:
            process.kill()
    number = signal.Signals[name]
    assert status == (-number if name == "SIGKILL" else 128 + number)
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder with an Oxford sequence of noise, and a pair list."""
    folder = tmp_path_factory.mktemp("pictures")
    sequence = folder / "oxford" / "graf"
    sequence.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number in range(1, 7):
        image = cv2.resize(rng.integers(0, 255, (300, 400), np.uint8), (1600, 1200))
        cv2.imwrite(str(sequence / f"img{number}.png"), image)
        np.savetxt(sequence / f"H1to{number}p", np.eye(3))
    pairs = [{"image1": "img1.png", "image2": f"img{k}.png"} for k in range(2, 7)]
    (sequence / "pairs.json").write_text(json.dumps(pairs))
    return folder


WORKING = {
    "ablate": ["--data", "{0}/oxford/graf/pairs.json", "--operators", "surf,sift", "--cache", "c"],
    "bench oxford": ["--data", "{0}", "--operators", "surf,sift"],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("what", WORKING)
def test_worker_processes_end_with_the_command(what, name, pictures, tmp_path):
    words = [*what.split(), *(word.format(pictures) for word in WORKING[what])]
    words += ["--workers", "2", "--out", "o"]
    with (tmp_path / "log").open("w") as log:
        parent = start(
            [sys.executable, "-m", "sfmkit.cli", *words], stdout=log, stderr=log, cwd=tmp_path
        )
    try:
        # two workers that have imported torch
        assert until(lambda: sum(map(computes, family(parent.pid)[1:])) >= 2), (
            tmp_path / "log"
        ).read_text()
        processes = family(parent.pid)
        assert listening(processes) == set()
        parent.send_signal(signal.Signals[name])
        status = parent.wait(WAIT_S)
        assert until(lambda: not any(map(runs, processes))), [p for p in processes if runs(p)]
    finally:
        for process in [p for p in processes if runs(p)]:
            process.kill()
    number = signal.Signals[name]
    assert status == (-number if name == "SIGKILL" else 128 + number)
    assert "Traceback" not in (tmp_path / "log").read_text()


def computes(process: psutil.Process) -> bool:
    try:
        return process.memory_info().rss > 150 << 20
    except psutil.NoSuchProcess:
        return False


WRITING = """
import sys, time
from sfmkit._utils.writing import staged_folder
from sfmkit.cli import main
def work(**_):
    with staged_folder(sys.argv[2]) as folder:
        (folder / "cloud.ply").write_text("half")
        print("writes", flush=True)
        time.sleep(600)
main.get_command(None, "operators").callback = work
main(["operators"])
"""


@pytest.mark.parametrize("name", SIGNALS[:3])
def test_a_signal_while_it_writes_leaves_nothing(name, tmp_path):
    out = tmp_path / "below" / "o"
    command = [sys.executable, "-c", WRITING, "operators", str(out)]
    process = start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"writes\n"
    process.send_signal(signal.Signals[name])
    _, message = process.communicate(timeout=WAIT_S)
    assert process.returncode == 128 + signal.Signals[name]
    assert message.count(b"\n") == 1
    assert b"nothing was written" in message
    assert list(tmp_path.iterdir()) == []
