"""A short run of the fuzz suite, and proof that it notices what it looks for."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks and limits")
if sys.platform.startswith("linux"):
    from fuzz import engine
    from fuzz.engine import Kind, endings
    from fuzz.kinds import KINDS
else:
    KINDS = {}

INPUTS = 16  # of each kind


@pytest.mark.parametrize("name", sorted(KINDS))
def test_every_input_is_accepted_or_refused_with_a_message(name):
    found = list(endings(KINDS[name], range(INPUTS)))
    assert [ending.number for ending in found] == list(range(INPUTS))
    assert [ending for ending in found if ending.is_finding] == []
    if name != "images":  # one of whose seeds is PostScript
        valid = found[: len(engine.seeds_of(KINDS[name]))]
        assert [ending for ending in valid if ending.outcome != "accepted"] == []


def misbehave(data: bytes, folder: Path) -> None:
    """Fail in one of the ways that the suite must notice."""
    if data == b"exception":
        raise KeyError("x")
    if data == b"hang":
        time.sleep(60)
    while data == b"loop":
        pass
    if data == b"crash":
        os.abort()
    if data == b"memory":
        np.ones(5 << 27)  # 5 GiB
    if data == b"outside":
        (folder.parents[1] / f"outside-{os.getpid()}").write_text("x")
    if data == b"silent":
        from sfmkit.errors import InputError

        raise InputError("")


def test_findings_are_noticed(monkeypatch):
    monkeypatch.setattr(engine, "LIMIT_S", 0.5)
    monkeypatch.setattr(engine, "WAIT_S", 2)
    data = [
        b"fine",
        b"exception",
        b"hang",
        b"loop",
        b"crash",
        b"memory",
        b"outside",
        b"silent",
        b"fine",
    ]
    kind = Kind("test", lambda _: data, lambda random, seeds: b"fine", misbehave)
    found = list(endings(kind, range(len(data))))
    for file in Path(engine.tempfile.gettempdir()).glob("outside-*"):
        file.unlink()
    assert [ending.outcome for ending in found] == [
        *("accepted", "KeyError", "hang", "hang", "crash", "memory", "wrote outside"),
        *("no message", "accepted"),
    ]
