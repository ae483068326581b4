"""Fixtures that the tests share."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real photographs with ground truth, from SFMKIT_DATA; without it the test is
    skipped."""
    folder = os.environ.get("SFMKIT_DATA")
    if not folder:
        if os.environ.get("CI"):
            pytest.fail("SFMKIT_DATA is not set; data-driven tests must not skip in CI")
        pytest.skip(
            "SFMKIT_DATA is not set: see data/README.md for the real photographs this test needs"
        )
    path = Path(folder).resolve()
    if not path.is_dir():
        pytest.fail(f"SFMKIT_DATA={folder} is not a folder")
    return path


@pytest.fixture(scope="session")
def demo_images() -> tuple[Path, Path]:
    """The bundled pair."""
    from sfmkit.datasets.synthetic import demo_pair

    return demo_pair()[:2]


@pytest.fixture(scope="session")
def demo_fundamental() -> np.ndarray:
    """(3, 3) true fundamental matrix of the bundled pair, in pixels."""
    from sfmkit.datasets.synthetic import demo_pair

    truth = json.loads(demo_pair()[2].read_text())
    R, t, K = (np.array(truth[name]) for name in ("R", "t", "K"))
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    inverse = np.linalg.inv(K)
    return inverse.T @ cross @ R @ inverse


def pytest_configure() -> None:
    """Undo an ignored SIGHUP (nohup), which the commands under test would inherit and respect."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests marked `cuda` need a device; without one they are skipped."""
    if not any(item.get_closest_marker("cuda") for item in items):
        return
    import torch

    if not torch.cuda.is_available():
        for item in items:
            if item.get_closest_marker("cuda"):
                item.add_marker(pytest.mark.skip(reason="there is no CUDA device"))
