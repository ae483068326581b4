"""The example plug-in package, installed once for all benchmarks."""

from __future__ import annotations

from pathlib import Path

import pytest
from plugins import install


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> Path:
    return install(tmp_path_factory.mktemp("plugins"))
