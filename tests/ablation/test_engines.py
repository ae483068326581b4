"""Local workers: the same rows whatever their number, and whoever is killed whenever."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import small_sweep
from small_sweep import OPERATORS, InlineEngine, pairs

from sfmkit.ablation import AblationTable, ablate, engine_choice, read_table
from sfmkit.ablation.engines import ATTEMPTS, LocalEngine
from sfmkit.ablation.plan import make_plan
from sfmkit.ablation.version import engine_version
from sfmkit.ablation.worker import Parcel, Setup


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> AblationTable:
    """The rows of the small sweep, uninterrupted, in one process."""
    folder = tmp_path_factory.mktemp("truth")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_choice, "LocalEngine", InlineEngine)
        return ablate(pairs(folder / "images"), OPERATORS, seeds=2, cache=folder / "cache")


def start(folder: Path, workers: int = 2) -> subprocess.Popen:
    """The same sweep as a process of its own."""
    return subprocess.Popen(
        [
            sys.executable,
            small_sweep.__file__,
            str(folder / "images"),
            str(folder / "out"),
            str(folder / "cache"),
            str(workers),
        ],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stderr=subprocess.PIPE,
        text=True,
    )


def all_children(pid: int) -> list[int]:
    """Children of every thread of a process."""
    found = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += [int(c) for c in file.read_text().split()]
        except OSError:
            continue
    return found


def wait_until(condition, seconds: float = 240.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.01)


def results_in(cache: Path) -> int:
    """Count the results in a cache from which other processes remove folders."""
    return sum(name.endswith(".npz") for _, _, names in os.walk(cache) for name in names)


def kill_and_resume(
    folder: Path, moments: int, seed: int, workers: int = 2
) -> tuple[AblationTable, int]:
    """Run the sweep, killing its parent or one of its workers at random moments, until it ends.

    A run gives a task up when its workers died ATTEMPTS times, also if they died while they
    started. So fewer workers than that are killed in one run; then it is the parent's turn.

    Returns:
        The table, and how many processes were killed.
    """
    rng, killed = random.Random(seed), 0
    cache = folder / "cache"
    while True:
        process = start(folder, workers)
        workers_killed = 0
        # The moment is a number of further results, so that every attempt gets somewhere however
        # slow the machine is.
        while killed < moments and process.poll() is None:
            results = results_in(cache)
            more = rng.randrange(1, 4)
            wait_until(
                lambda process=process, enough=results + more: (
                    process.poll() is not None or results_in(cache) >= enough
                )
            )
            time.sleep(rng.uniform(0, 0.1))
            living = all_children(process.pid) if process.poll() is None else []
            if process.poll() is not None:
                break
            killed += 1
            if living and workers_killed < ATTEMPTS - 1 and rng.random() < 0.5:
                os.kill(rng.choice(living), signal.SIGKILL)
                workers_killed += 1
            else:
                process.kill()
                wait_until(
                    lambda living=living: (
                        not any(Path(f"/proc/{pid}").exists() and is_running(pid) for pid in living)
                    )
                )
        _, errors = process.communicate(timeout=250)
        if process.returncode == 0:
            return read_table(folder / "out"), killed
        assert process.returncode == -signal.SIGKILL, errors


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are watched through /proc")
class TestKilling:
    def test_three_random_moments(self, truth, tmp_path):
        table, killed = kill_and_resume(tmp_path, 3, seed=5, workers=1)
        assert killed == 3
        assert table.results() == truth.results()

    @pytest.mark.slow
    @pytest.mark.timeout(1500)
    def test_twenty_random_moments(self, truth, tmp_path):
        total, seed = 0, 100
        while total < 20:
            folder = tmp_path / str(seed)
            table, killed = kill_and_resume(folder, 20 - total, seed)
            assert table.results() == truth.results()
            total, seed = total + killed, seed + 1
        assert total == 20

    def test_workers_end_when_their_parent_is_killed(self, tmp_path):
        process = start(tmp_path)
        wait_until(lambda: len(all_children(process.pid)) == 2)
        workers = all_children(process.pid)
        process.kill()
        process.communicate()
        wait_until(lambda: not any(is_running(pid) for pid in workers))


def test_a_task_that_kills_its_workers_is_given_up_and_the_others_are_done(tmp_path):
    plan = make_plan(pairs(tmp_path), ("orb",))
    tasks = list(plan.detections.values())
    setup = Setup(engine_version(), str(tmp_path / "cache"))
    engine = LocalEngine(1, setup)
    stop = threading.Event()

    def kill_whoever_works_on_the_first() -> None:
        seen: set[int] = set()
        while not stop.is_set() and len(seen) < 3:
            for pid in set(engine.pids) - seen:
                seen.add(pid)
                os.kill(pid, signal.SIGKILL)
            time.sleep(0.01)

    killer = threading.Thread(target=kill_whoever_works_on_the_first)
    killer.start()
    try:
        for task in tasks:
            engine.submit(task, Parcel())
        outcomes = dict(engine.next() for _ in tasks)
    finally:
        stop.set()
        killer.join()
        engine.close()
    assert outcomes[tasks[0]].status == "failed"
    assert "died 3 times" in outcomes[tasks[0]].reason
    assert {outcomes[t].status for t in tasks[1:]} == {"done"}
    assert engine.pids == []


def test_what_cannot_be_told_to_a_worker_fails_and_does_not_hang(tmp_path):
    engine = LocalEngine(1, Setup(engine_version(), str(tmp_path)))
    try:
        engine.submit(lambda: None, Parcel())  # type: ignore[arg-type]
        _, outcome = engine.next()
    finally:
        engine.close()
    assert outcome.status == "failed"
    assert "pickle" in outcome.reason.lower()


@pytest.mark.slow
def test_one_and_two_workers_give_the_rows_of_one_process(truth, tmp_path):
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        table = ablate(
            pairs(folder / "images"),
            OPERATORS,
            seeds=2,
            out=folder / "out",
            cache=folder / "cache",
            workers=workers,
        )
        assert table.results() == truth.results()


def test_a_failing_unit_is_tried_job_by_job(tmp_path, monkeypatch):
    """One estimate that its worker does not survive costs its own row only."""
    from sfmkit.ablation.tasks import EstimateTask
    from sfmkit.ablation.worker import Outcome

    class Fragile(InlineEngine):
        def next(self):
            task, outcome = super().next()
            if isinstance(task, EstimateTask) and any(
                job.combination == ("orb", "akaze") for job in task.jobs
            ):
                return task, Outcome("failed", "the worker died 3 times")
            return task, outcome

    monkeypatch.setattr(engine_choice, "LocalEngine", Fragile)
    table = ablate(pairs(tmp_path / "i", 1, 0), ("orb", "akaze"), seeds=1, cache=tmp_path / "c")
    assert {(r["combination"], r["status"]) for r in table} == {
        ("orb", "ok"),
        ("akaze", "ok"),
        ("orb/akaze", "failed"),
    }
