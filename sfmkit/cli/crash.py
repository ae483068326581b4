"""Message and log file of unexpected errors."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
import traceback

__all__ = ["describe_crash", "write_log"]


def describe_crash(error: BaseException) -> str:
    """Describe an error in one line, with the path of a log file that contains the traceback."""
    what = " ".join(f"{type(error).__name__}: {error}".split())
    if len(what) > 200:
        what = what[:197] + "..."
    try:
        log = f"attach {write_log(error)}"
    except OSError:  # the disk is full; print the traceback instead
        log = f"attach this traceback:\n{''.join(traceback.format_exception(error))}"
    return f"error: sfmkit failed ({what}). Please open an issue with the project and {log}"


def write_log(error: BaseException) -> str:
    """Write the traceback, the command and the versions to a new file in the temporary folder.

    The file is readable by its owner only.

    Raises:
        OSError: The file cannot be written.
    """
    descriptor, path = tempfile.mkstemp(prefix="sfmkit-crash-", suffix=".log")
    with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as log:
        log.write(f"command: {shlex.join(sys.argv)}\n")
        try:
            from .._utils.versions import all_versions

            log.writelines(f"{name}: {version}\n" for name, version in all_versions().items())
        except Exception as other:  # an error here must not hide the traceback
            log.write(f"versions: {other!r}\n")
        log.write("\n")
        log.writelines(traceback.format_exception(error))
    return path
