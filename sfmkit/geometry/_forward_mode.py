"""Forward-mode AD with torch's deprecation warning suppressed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def forward_mode() -> Iterator[None]:
    """Suppress the warning of the first jvp or jacfwd: torch (2.15) scripts its decompositions."""
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=r"`torch\.jit\.script` is deprecated", category=FutureWarning
        )
        yield
