"""Description of the machine on which a measurement was made."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from pathlib import Path


def describe_machine() -> dict[str, str]:
    """Describe the processor, cores, memory, system and load.

    Entries that the system does not provide are left out.
    """
    found = {"processor": processor(), "cores": str(os.cpu_count() or 1)}
    with suppress(ValueError, OSError, AttributeError):
        found["memory"] = (
            f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB"
        )
    found["system"] = f"{platform.system()} {platform.machine()}"
    with suppress(OSError, AttributeError):
        found["load"] = (
            f"{os.getloadavg()[0]:.1f} over the last minute, when the results were written"
        )
    return found


def processor() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
