"""Forward-mode derivatives without torch's word to itself."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def forward_mode() -> Iterator[None]:
    """Around jvp and jacfwd: torch scripts decompositions of its own on the first one, and warns
    that scripting is deprecated (2.15). Whoever asks for a gradient can do nothing about that.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=r"`torch\.jit\.script` is deprecated", category=FutureWarning
        )
        yield
