"""Temporary limits of torch's thread count."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, local

import torch

_lock = Lock()
_here = local()  # whether the current thread is in a block
_inside = 0  # number of threads that are in a block
_outside = 1  # torch's thread count before the first of them entered its block


@contextmanager
def one_thread() -> Iterator[None]:
    """Run the torch operations of a block, or of a decorated function, on one thread.

    This is intended for stages with many small operations. With several threads, each operation
    ends with its slowest thread. On a busy machine, that thread waits for a core, and the stage
    takes 20 to 80 times as long as on an idle machine. On an idle machine, a second thread saves
    less than a fifth of the time (``benchmarks/contention.py``).

    torch stores the count per thread, but the last count that any thread has set is also the
    default of every new thread. The number of open blocks is therefore counted. If a thread uses
    torch for the first time while another thread is in a block, the count from before that block is
    restored for it.
    """
    global _inside, _outside
    if getattr(_here, "inside", False):
        yield
        return
    before = torch.get_num_threads()
    with _lock:
        if _inside == 0:
            _outside = before
        elif before == 1:
            before = _outside
        _inside += 1
    _here.inside = True
    torch.set_num_threads(1)
    try:
        yield
    finally:
        _here.inside = False
        with _lock:
            _inside -= 1
            torch.set_num_threads(before)
