"""A real Dask cluster: scheduler and workers as processes of their own, on loopback or on hosts of
their own."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from small_sweep import OPERATORS, InlineEngine, pairs

from sfmkit.ablation import AblationTable, SweepState, ablate, engine_choice, run
from sfmkit.errors import InputError, OutputError

pytestmark = pytest.mark.cluster
pytest.importorskip("distributed", reason="Dask is not installed (the cluster extra)")

SEEDS = 2


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> AblationTable:
    folder = tmp_path_factory.mktemp("truth")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_choice, "LocalEngine", InlineEngine)
        return ablate(pairs(folder / "images"), OPERATORS, seeds=SEEDS, cache=folder / "cache")


class Cluster:
    """Processes of a cluster. `prefix(k)` is the command that runs something on host k; host 0 has
    the scheduler."""

    def __init__(
        self, folder: Path, host: Callable[[int], str], prefix: Callable[[int], list[str]]
    ):
        self.folder, self.host, self.prefix = folder, host, prefix
        self.processes: list[subprocess.Popen] = []
        self.workers: list[subprocess.Popen] = []

    def start(self, workers: int) -> None:
        file = self.folder / "scheduler.json"
        self._run(
            0, "dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)
        )
        end = time.monotonic() + 60
        while not (file.exists() and file.read_text().endswith("}")):
            assert time.monotonic() < end, "the scheduler did not start"
            time.sleep(0.1)
        self.address = json.loads(file.read_text())["address"]
        self.workers = [
            self._run(
                k + 1,
                "dask_worker",
                self.address,
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
                "--local-directory",
                str(self.folder / f"worker{k}"),
            )
            for k in range(workers)
        ]

    def _run(self, k: int, module: str, *args: str) -> subprocess.Popen:
        env = {
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "critical",
        }
        process = subprocess.Popen(
            [
                *self.prefix(k),
                sys.executable,
                "-m",
                f"distributed.cli.{module}",
                *args,
                "--host",
                self.host(k),
            ],
            env=env,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process

    def stop(self) -> None:
        for process in reversed(self.processes):
            process.kill()
            process.wait()


@contextmanager
def loopback(folder: Path, workers: int = 2) -> Iterator[Cluster]:
    cluster = Cluster(folder, lambda k: "127.0.0.1", lambda k: [])
    try:
        cluster.start(workers)
        yield cluster
    finally:
        cluster.stop()


def kills_after(worker: subprocess.Popen, outcomes: int) -> Callable[[SweepState], None]:
    """A watcher that kills a worker once there have been some outcomes."""
    seen = [0]

    def watch(progress: SweepState) -> None:
        seen[0] += progress.stage == "run"
        if seen[0] == outcomes and worker.poll() is None:
            worker.send_signal(signal.SIGKILL)

    return watch


def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed_in_mid_sweep(truth, tmp_path):
    with loopback(tmp_path) as cluster:
        table = ablate(
            pairs(tmp_path / "images"),
            OPERATORS,
            seeds=SEEDS,
            out=tmp_path / "out",
            cache=tmp_path / "cache",
            scheduler=cluster.address,
            progress=kills_after(cluster.workers[0], 15),
        )
        assert cluster.workers[0].poll() == -signal.SIGKILL
    assert table.results() == truth.results()


def test_a_cluster_with_its_cache_in_memory_gives_the_same_rows(truth, tmp_path):
    """Memory is shared by the threads of one process only, so the workers are threads."""
    fsspec = pytest.importorskip("fsspec")
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        table = ablate(
            pairs(tmp_path / "images"),
            OPERATORS,
            seeds=SEEDS,
            scheduler=cluster.scheduler_address,
            cache="memory://cluster",
        )
    assert table.results() == truth.results()
    assert len(fsspec.filesystem("memory").find("/cluster")) >= len(table)


def test_workers_that_do_not_see_the_cache_are_refused(tmp_path):
    with (
        loopback(tmp_path, workers=1) as cluster,
        pytest.raises(InputError, match="does not see the cache memory://"),
    ):
        ablate(
            pairs(tmp_path / "images", 1, 0),
            ["orb"],
            cache="memory://alone",
            scheduler=cluster.address,
        )


@pytest.mark.slow
def test_workers_that_share_no_files_get_images_as_bytes_and_lose_scattered_arrays_with_a_worker(
    truth, tmp_path
):
    with loopback(tmp_path) as cluster:
        table = ablate(
            pairs(tmp_path / "images"),
            OPERATORS,
            seeds=SEEDS,
            out=tmp_path / "out",
            cache=tmp_path / "cache",
            scheduler=cluster.address,
            ship="bytes",
            progress=kills_after(cluster.workers[1], 18),
        )
        assert cluster.workers[1].poll() == -signal.SIGKILL
    assert table.results() == truth.results()
    kinds = {
        file.relative_to(tmp_path / "cache").parts[0]
        for file in (tmp_path / "cache").rglob("*.npz")
    }
    assert kinds == {"features", "matches", "estimates"}  # what was made came back


def test_an_unknown_scheduler_is_said_within_seconds(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    began = time.monotonic()
    with pytest.raises(InputError, match="no Dask scheduler answers at"):
        ablate(
            pairs(tmp_path / "images", 1, 0), ["orb"], cache=tmp_path / "cache", scheduler=address
        )
    assert time.monotonic() - began < 20


@pytest.mark.parametrize(
    "address", ["127.0.0.1", "nonsense://x:1", "tcp://no.such.host.invalid:8786"]
)
def test_addresses_that_are_none(tmp_path, address, monkeypatch):
    monkeypatch.setattr("sfmkit.ablation.cluster.CONNECT_S", 1.0)
    with pytest.raises(InputError, match="no Dask scheduler answers at"):
        ablate(
            pairs(tmp_path / "images", 1, 0), ["orb"], cache=tmp_path / "cache", scheduler=address
        )
    # A client that is left half made hangs, some time, whoever makes the next one.
    assert not any(thread.name == "IO loop" for thread in threading.enumerate())


@pytest.mark.slow
def test_clusters_without_workers_of_another_version_and_gone_ones(tmp_path, monkeypatch):
    options = {"cache": tmp_path / "cache", "out": tmp_path / "out"}
    with (
        loopback(tmp_path, workers=0) as cluster,
        pytest.raises(InputError, match=r"no worker .* appeared in 2 s \(--wait\)"),
    ):
        ablate(
            pairs(tmp_path / "images", 1, 0),
            ["orb"],
            scheduler=cluster.address,
            wait=2.0,
            **options,
        )
    (tmp_path / "scheduler.json").unlink()
    with loopback(tmp_path, workers=1) as cluster:
        with monkeypatch.context() as other:
            other.setattr(run, "engine_version", lambda: "sfmkit 99")
            with pytest.raises(InputError, match=r"runs sfmkit .* here is sfmkit 99"):
                ablate(
                    pairs(tmp_path / "images", 1, 0), ["orb"], scheduler=cluster.address, **options
                )

        def end(progress: SweepState) -> None:
            if progress.what.startswith("orb on"):
                cluster.stop()

        with pytest.raises(OutputError, match="run the same command again"):
            ablate(
                pairs(tmp_path / "images", 1, 0),
                ["orb"],
                scheduler=cluster.address,
                progress=end,
                **options,
            )


# ---- hosts made of network namespaces


_SETS = itertools.count()
# Another run of the tests on this machine, or one that was killed, can have its own network.
NETWORK = f"10.97.{os.getpid() % 250}"


def _ip(*args: str) -> None:
    subprocess.run(["ip", *args], check=True, capture_output=True)


@contextmanager
def hosts(n: int) -> Iterator[list[str]]:
    """Network namespaces with addresses NETWORK.2 ... joined by a bridge at NETWORK.1.

    Skips where none can be made.
    """
    if shutil.which("ip") is None:
        pytest.skip("there is no `ip` command to make network namespaces with")
    # another each time: links go a while after their host
    tag = f"sfm{os.getpid() % 10_000}{chr(97 + next(_SETS) % 26)}"
    made: list[list[str]] = []
    try:
        _ip("link", "add", tag, "type", "bridge")
        made.append(["link", "del", tag])
        _ip("addr", "add", f"{NETWORK}.1/24", "dev", tag)
        _ip("link", "set", tag, "up")
        for k in range(n):
            name = f"{tag}-{k}"
            _ip("netns", "add", name)
            made.append(["netns", "del", name])
            _ip("link", "add", f"{tag}v{k}", "type", "veth", "peer", "name", "eth0", "netns", name)
            _ip("link", "set", f"{tag}v{k}", "master", tag, "up")
            _ip("-n", name, "addr", "add", f"{NETWORK}.{k + 2}/24", "dev", "eth0")
            _ip("-n", name, "link", "set", "eth0", "up")
            _ip("-n", name, "link", "set", "lo", "up")
    except subprocess.CalledProcessError as error:
        for command in reversed(made):
            subprocess.run(["ip", *command], capture_output=True, check=False)
        pytest.skip(f"network namespaces cannot be made here: {error.stderr.decode().strip()}")
    try:
        yield [f"{tag}-{k}" for k in range(n)]
    finally:
        for command in reversed(made):
            subprocess.run(["ip", *command], capture_output=True, check=False)


@pytest.mark.slow
@pytest.mark.netns
@pytest.mark.parametrize("ship", ["path", "bytes"])
def test_a_cluster_of_hosts_gives_the_same_rows(truth, tmp_path, ship):
    with hosts(2) as names:
        cluster = Cluster(
            tmp_path,
            lambda k: f"{NETWORK}.{k + 1}",
            lambda k: ["ip", "netns", "exec", names[k - 1]] if k else [],
        )
        try:
            cluster.start(2)
            table = ablate(
                pairs(tmp_path / "images"),
                OPERATORS,
                seeds=SEEDS,
                out=tmp_path / "out",
                cache=tmp_path / "cache",
                scheduler=cluster.address,
                ship=ship,
                wait=240,
                progress=kills_after(cluster.workers[0], 15),
            )
        finally:
            cluster.stop()
    assert table.results() == truth.results()
