"""Thread counts of torch, changed in one place and always restored."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, local

import torch

_lock = Lock()
_here = local()  # whether the current thread is in a block
_inside = 0  # threads that are in a block now
_outside = 1  # torch's thread count before the first of them entered


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch operations of this block, or of this function as a decorator, on one thread.

    For stages of many small operations. With several threads each operation ends with its slowest
    thread; on a busy machine that thread waits for a core, and the stage takes 20 to 80 times its
    idle time. On an idle machine a second thread gains less than a fifth
    (``benchmarks/contention.py``).

    torch keeps the count per thread, but the last count that any thread has set is also the default
    of every new thread. Blocks therefore count how many of them are open, and a thread that first
    used torch while another one was inside leaves with the count from before.
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
