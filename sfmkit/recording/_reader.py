"""Write the contents of a recording to standard output; :mod:`sfmkit.recording.read` runs this.

Rerun's reader is a process of its own: at some damaged files it panics, and Rerun (0.41) is built
so that a panic aborts the process.

Output is one Arrow IPC stream per chunk. The exit status is :data:`DAMAGED` for a file that the
reader refuses.
"""

from __future__ import annotations

import sys
import warnings
from typing import BinaryIO

import pyarrow as pa
from rerun.chunk import RrdReader

DAMAGED = 65  # EX_DATAERR of sysexits.h


def write_chunks(path: str, out: BinaryIO) -> int:
    """Write the chunks of a file, without the viewer's internal ones; return the exit status."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # for a truncated file the reader only warns
        try:
            for chunk in RrdReader(path).stream():
                if not chunk.entity_path.startswith("/__"):
                    batch = chunk.to_record_batch()
                    batch.validate(full=True)
                    with pa.ipc.new_stream(out, batch.schema) as stream:
                        stream.write_batch(batch)
        except (RuntimeError, ValueError, Warning):  # pyarrow's errors are ValueErrors
            return DAMAGED
    out.flush()
    return 0


if __name__ == "__main__":
    sys.exit(write_chunks(sys.argv[1], sys.stdout.buffer))
