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
from .engines import ATTEMPTS, died
from .tasks import Task
from .version import engine_version
from .worker import Outcome, Parcel, Setup, perform

CONNECT_S = 5.0
WORKERS_S = 10.0
_AHEAD = 2  # tasks a worker has waiting, so that it need not wait for the next
_GO_ON = "what was done is kept: start again when the cluster is back"
_SHARED = 64  # results that stay scattered over the cluster


class DaskEngine:
    """An existing Dask cluster.

    Args:
        address: of its scheduler, ``tcp://host:port``.
        setup: what the workers are told; with a cache they must see its folder.

    Raises:
        InputError: dask is not installed, no scheduler answers within seconds, it has no workers,
            or these run another version of sfmkit.
    """

    def __init__(self, address: str, setup: Setup):
        try:
            from distributed import Client
        except ImportError:
            raise InputError("--scheduler needs Dask: pip install 'sfmkit[cluster]'") from None
        for name in ("distributed", "distributed.client", "distributed.comm"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            _reach(address)
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # whatever the transport of that address raises
            raise InputError(
                f"no Dask scheduler answers at {address} ({type(error).__name__} after {CONNECT_S:.0f} s); start one with "
                "`dask scheduler`, workers with `dask worker ADDRESS --nthreads 1`"
            ) from None
        self._setup, self.shares_files = setup, setup.cache is not None
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            self.close()
            raise InputError(
                f"the Dask cluster at {address} has no workers; start some: dask worker {address}"
            ) from None
        try:
            self._check_versions()
        except BaseException:
            self.close()
            raise
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._running: dict[Any, tuple[Task, Parcel, int]] = {}
        self._shared: OrderedDict[str, Any] = OrderedDict()
        self._number = itertools.count()

    def _check_versions(self) -> None:
        try:
            found = self._client.run(engine_version, on_error="return")
        except Exception as error:
            raise InputError(
                f"the cluster's workers cannot be asked for their version: {error}"
            ) from None
        for worker, version in found.items():
            if version != self._setup.version:
                what = (
                    f"cannot import this sfmkit ({version!r})"
                    if isinstance(version, Exception)
                    else f"runs {version}"
                )
                raise InputError(
                    f"the worker {worker} {what}, here is {self._setup.version}; install the same version everywhere"
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
        """The bytes in a worker's memory, from which the others fetch them; not through the
        scheduler."""
        if key not in self._shared:
            try:
                self._shared[key] = self._client.scatter(data, hash=False)
            except (
                OSError,
                TimeoutError,
            ):  # that worker has just died: this once they go with the task
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
            except (
                Exception
            ) as error:  # scattered bytes were lost with a worker, or the cluster is gone
                self._alive()
                if attempt == ATTEMPTS:
                    return task, Outcome(
                        "failed", f"the cluster lost this task {ATTEMPTS} times: {error}"
                    )
                for key in (*parcel.images, *parcel.inputs):
                    self._shared.pop(key, None)
                self.submit(task, parcel, attempt + 1)

    def _wait(self) -> Any:
        """The next future that is done.

        Raises:
            OutputError: the scheduler is gone, or all workers are and none comes back.
        """
        idle_since = time.monotonic()
        while True:
            try:
                return self._done.get(timeout=1.0)
            except queue.Empty:
                if self._alive():
                    idle_since = time.monotonic()
                elif time.monotonic() - idle_since > WORKERS_S:
                    raise OutputError(
                        f"the cluster has lost all its workers and none came back in {WORKERS_S:.0f} s; {_GO_ON}"
                    ) from None

    def _alive(self) -> bool:
        """Whether the cluster has workers.

        Raises:
            OutputError: its scheduler is gone.
        """
        if self._client.status != "running":
            raise OutputError(f"the scheduler of the cluster is gone; {_GO_ON}")
        return bool(self._client.scheduler_info(n_workers=-1)["workers"])

    def close(self) -> None:
        with suppress(
            TimeoutError
        ):  # of a cluster that is gone; what ended the sweep is what must be told
            self._client.close(timeout=2)


def _reach(address: str) -> None:
    """Raise whatever the transport does where no scheduler answers.

    A Client that finds none leaves its thread behind, and deadlocks when it is collected while
    another one starts (distributed 2026.8), so none is made before somebody answers. In a thread: a
    notebook has a loop of its own.
    """
    from distributed.comm import connect

    async def reach() -> None:
        comm = await connect(address, timeout=CONNECT_S)
        await comm.close()

    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(reach())).result()


def _perform(
    task: Task, setup: Setup, images: dict[str, bytes], inputs: dict[str, bytes]
) -> Outcome:
    return perform(task, setup, Parcel(images, inputs))
