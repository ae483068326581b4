"""The peak memory of a block of code."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType


class PeakMemory:
    """Measure the largest memory of the process during a ``with`` block.

    On Linux the peak is reset at the start of the block. Elsewhere it is the peak since the process
    started; 0 if the peak is not available.

    Attributes:
        mb: Megabytes (10^6 bytes), set at the end of the block.
    """

    mb: float = 0.0

    def __enter__(self) -> PeakMemory:
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            lines = Path("/proc/self/status").read_text().splitlines()
            self.mb = (
                next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
                * 1024
                / 1e6
            )
        except (OSError, StopIteration):
            with suppress(ImportError):
                import resource

                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
                self.mb = peak * (1 if sys.platform == "darwin" else 1024) / 1e6
