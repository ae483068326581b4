"""A Dask cluster as an engine (the ``cluster`` extra)."""

from __future__ import annotations

import asyncio
import itertools
import logging
import queue
import time
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from ..errors import InputError, OutputError
from .cache import Cache
from .engines import ATTEMPTS, died
from .tasks import Task
from .version import engine_version
from .worker import Outcome, Parcel, Setup, perform

CONNECT_S = 5.0
_LEAST_WAIT_S = 0.1  # so that --wait 0 finds existing workers
_AHEAD = 2  # tasks per worker, so that a worker need not wait for its next task
_RESUME = "finished results are kept: run the same command again when the cluster is back"
_SHARED = 64  # results that are kept in the memory of the cluster


class DaskEngine:
    """An existing Dask cluster.

    Args:
        address: The address of its scheduler, ``tcp://host:port``.
        setup: What the workers need; with a cache they must see its folder.
        wait_s: Seconds to wait for the first worker, and for another one when all are lost.

    Raises:
        InputError: Dask is not installed, no scheduler answers within seconds, no worker appears in
            time, or the workers run another version of sfmkit.
    """

    def __init__(self, address: str, setup: Setup, wait_s: float):
        try:
            from distributed import Client
        except ImportError:
            raise InputError("--scheduler needs Dask: pip install 'sfmkit[cluster]'") from None
        for name in ("distributed", "distributed.client", "distributed.comm"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            _reach(address)
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # the classes depend on the transport of the address
            raise InputError(
                f"no Dask scheduler answers at {address} ({type(error).__name__} after "
                f"{CONNECT_S:.0f} s); start one with `dask scheduler`, workers with "
                "`dask worker ADDRESS --nthreads 1`"
            ) from None
        self._setup, self.shares_files = setup, setup.cache is not None
        self._address, self._wait_s = address, wait_s
        try:
            self._check_workers()
        except BaseException:
            self.close()
            raise
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._running: dict[Any, tuple[Task, Parcel, int]] = {}
        self._shared: OrderedDict[str, Any] = OrderedDict()
        self._number = itertools.count()

    def _check_workers(self) -> None:
        """Wait for a worker and compare versions; workers that die in the meantime are ignored.

        Raises:
            InputError: No worker appeared in time, or one runs another version.
        """
        deadline = time.monotonic() + self._wait_s
        while True:
            try:
                left = max(deadline - time.monotonic(), _LEAST_WAIT_S)
                self._client.wait_for_workers(1, timeout=left)
            except TimeoutError:
                raise InputError(
                    f"no worker of the Dask cluster at {self._address} appeared in "
                    f"{self._wait_s:.0f} s (--wait); start some: dask worker {self._address}"
                ) from None
            try:
                found = self._client.run(engine_version, on_error="return")
            except Exception:  # the worker died during the call
                found = {}
            alive = self._client.scheduler_info(n_workers=-1)["workers"]
            answers = {worker: v for worker, v in found.items() if worker in alive}
            for worker, version in answers.items():
                if version != self._setup.version:
                    what = (
                        f"cannot import this sfmkit ({version!r})"
                        if isinstance(version, Exception)
                        else f"runs {version}"
                    )
                    raise InputError(
                        f"the worker {worker} {what}, here is {self._setup.version}; install the "
                        "same version everywhere"
                    )
            if answers:
                self._check_cache(list(answers))
                return
            if time.monotonic() > deadline:
                raise InputError(
                    f"the workers of the Dask cluster at {self._address} die before they answer"
                )

    def _check_cache(self, workers: list[str]) -> None:
        """Check that workers see the cache.

        Raises:
            InputError: One of them does not.
        """
        if self._setup.cache is None:
            return
        with Cache(self._setup.cache).token() as token:
            found = self._client.run(
                _sees, self._setup.cache, token, workers=workers, on_error="return"
            )
        for worker, answer in found.items():
            if answer is False or isinstance(answer, InputError):
                raise InputError(
                    f"the worker {worker} does not see the cache {self._setup.cache}"
                    f"{f' ({answer})' if answer else ''}; choose a folder or a URL that all "
                    "machines see, or let results travel (--ship bytes)"
                )

    @property
    def slots(self) -> int:
        return _AHEAD * max(len(self._client.scheduler_info(n_workers=-1)["workers"]), 1)

    def submit(self, task: Task, parcel: Parcel, attempt: int = 1) -> None:
        images = {key: self._share(key, data) for key, data in parcel.images.items()}
        inputs = {key: self._share(key, data) for key, data in parcel.inputs.items()}
        future = self._client.submit(
            _perform,
            task,
            self._setup,
            images,
            inputs,
            key=f"{task.kind}-{task.key}-{next(self._number)}",
            pure=False,
        )
        self._running[future] = (task, parcel, attempt)
        future.add_done_callback(self._done.put)

    def _share(self, key: str, data: bytes) -> Any:
        """Send bytes to the memory of one worker, from which the other workers fetch them."""
        if key not in self._shared:
            try:
                self._shared[key] = self._client.scatter(data, hash=False)
            except (OSError, TimeoutError):  # the worker has just died: send them with the task
                self._alive()
                return data
        self._shared.move_to_end(key)
        while len(self._shared) > _SHARED:
            self._shared.popitem(last=False)
        return self._shared[key]

    def next(self) -> tuple[Task, Outcome]:
        from distributed import KilledWorker

        while True:
            future = self._wait()
            task, parcel, attempt = self._running.pop(future)
            try:
                return task, future.result(timeout=CONNECT_S)
            except KilledWorker:
                return task, died()
            except Exception as error:  # scattered bytes were lost, or the cluster is gone
                self._alive()
                if attempt == ATTEMPTS:
                    return task, Outcome(
                        "failed", f"the cluster lost this task {ATTEMPTS} times: {error}"
                    )
                for key in (*parcel.images, *parcel.inputs):
                    self._shared.pop(key, None)
                self.submit(task, parcel, attempt + 1)

    def _wait(self) -> Any:
        """Wait for the next finished future.

        Raises:
            OutputError: The scheduler has ended, or all workers have and none comes back.
        """
        idle_since = time.monotonic()
        while True:
            try:
                return self._done.get(timeout=1.0)
            except queue.Empty:
                if self._alive():
                    idle_since = time.monotonic()
                elif time.monotonic() - idle_since > self._wait_s:
                    raise OutputError(
                        "the cluster has lost all its workers and none came back in "
                        f"{self._wait_s:.0f} s; {_RESUME}"
                    ) from None

    def _alive(self) -> bool:
        """Return whether the cluster has workers.

        Raises:
            OutputError: Its scheduler has ended.
        """
        if self._client.status != "running":
            raise OutputError(f"the scheduler of the cluster has ended; {_RESUME}")
        return bool(self._client.scheduler_info(n_workers=-1)["workers"])

    def close(self) -> None:
        with suppress(TimeoutError):  # the error that ended the sweep must be reported
            self._client.close(timeout=2)


def _reach(address: str) -> None:
    """Connect to a scheduler once; raise the error of the transport if none answers.

    A Client that finds no scheduler leaves its thread behind, and deadlocks when it is collected
    while another one starts (distributed 2026.8). The connection is made in a thread, because a
    notebook has an event loop of its own.
    """
    from distributed.comm import connect

    async def reach() -> None:
        comm = await connect(address, timeout=CONNECT_S)
        await comm.close()

    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(reach())).result()


def _sees(cache: str, token: str) -> bool:
    """Return whether this process sees the cache of a token."""
    return Cache(cache).sees(token)


def _perform(
    task: Task, setup: Setup, images: dict[str, bytes], inputs: dict[str, bytes]
) -> Outcome:
    return perform(task, setup, Parcel(images, inputs))
