"""The choice of the engine: local processes or a Dask cluster."""

from __future__ import annotations

import os

from .engines import Engine, LocalEngine
from .worker import Setup

__all__ = ["WAIT_S", "start_engine"]

WAIT_S = 600.0  # for workers; batch systems start jobs within minutes, or much later


def start_engine(
    setup: Setup,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    wait_s: float = WAIT_S,
) -> Engine:
    """Start local processes, or connect to a Dask cluster.

    Args:
        setup: What the workers need.
        workers: Number of local processes; None for one per core.
        scheduler: Address of the cluster, ``tcp://host:port``; None for local processes.
        wait_s: Seconds to wait for a worker of the cluster.

    Raises:
        InputError: `workers` is less than 1, or the cluster cannot be used.
    """
    if scheduler is None:
        return LocalEngine(os.cpu_count() or 1 if workers is None else workers, setup)
    from .cluster import DaskEngine

    return DaskEngine(scheduler, setup, wait_s)
