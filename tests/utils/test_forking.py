"""Forked children of a process that has used threads compute instead of waiting."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

FORKS = """
import os, signal, sys
import torch
if sys.argv[1] == "with":
    import sfmkit
torch.set_num_threads(2)
x = torch.rand(800, 800)
x @ x, torch.sort(x.flatten())
child = os.fork()
if child == 0:
    signal.alarm(20)
    y = x @ x, torch.sort(x.flatten())
    os._exit(0)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_forked_child_computes():
    command = [sys.executable, "-c", FORKS, "with"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200)
    assert done.stdout == "0\n"
