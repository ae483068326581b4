"""Thread count of forked child processes.

The threads of torch and of OpenMP do not survive ``fork``, and a child that uses them hangs (Linux,
torch 2.15: a matrix product in the child after one in the parent). Forked children therefore
compute on one thread. torch may be imported after sfmkit or not at all, so it is looked up when the
process forks.
"""

from __future__ import annotations

import os
import sys

__all__ = ["use_one_thread_after_fork"]


def use_one_thread_after_fork() -> None:
    """Make every forked child of this process use one torch thread."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_use_one_thread)


def _use_one_thread() -> None:
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "set_num_threads"):
        torch.set_num_threads(1)
