"""What a command says and keeps when it fails for a reason that nobody foresaw."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
import traceback

__all__ = ["describe_crash", "write_log"]


def describe_crash(error: BaseException) -> str:
    """One line for the user, with the path of a log file that holds the traceback."""
    what = " ".join(f"{type(error).__name__}: {error}".split())
    if len(what) > 200:
        what = what[:197] + "..."
    try:
        log = f"attach {write_log(error)}"
    except OSError:  # there is no room for it; standard error has to do
        log = f"attach this traceback:\n{''.join(traceback.format_exception(error))}"
    return f"error: sfmkit failed, sorry ({what}). Please open an issue with the project and {log}"


def write_log(error: BaseException) -> str:
    """Write the traceback, the command and the versions to a new file in the temporary folder.

    The file is readable by its owner only.

    Raises:
        OSError: it cannot be written.
    """
    descriptor, path = tempfile.mkstemp(prefix="sfmkit-crash-", suffix=".log")
    with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as log:
        log.write(f"command: {shlex.join(sys.argv)}\n")
        try:
            from .._utils.versions import all_versions

            log.writelines(f"{name}: {version}\n" for name, version in all_versions().items())
        except Exception as other:  # whatever is broken here must not hide the traceback
            log.write(f"versions: {other!r}\n")
        log.write("\n")
        log.writelines(traceback.format_exception(error))
    return path
