"""A full disk while a recording is written is an error, not a wait and not half a file."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# Runs in namespaces of its own, where the caller is root over disks that no other process sees.
FULL_DISK = """
import subprocess, sys
from pathlib import Path
from made_up_result import make_result
from sfmkit import recording
from sfmkit.errors import OutputError
disk = Path(sys.argv[1])
result = make_result()
rec = recording.new_stream("pair")
recording.log_reconstruction(rec, result)
for write in (
    lambda: recording.save_recording(disk / "a.rrd", result),
    lambda: recording.write_stream(rec, disk / "a.rrd"),
):
    write()
    assert recording.read_recording(disk / "a.rrd").entities
    size = (disk / "a.rrd").stat().st_size
    (disk / "a.rrd").unlink()
    for share in (0, 0.1, 0.5, 0.9):  # of the file that fits
        room = max(8192, int(share * size) // 4096 * 4096)
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", disk], check=True)
        (disk / "a.rrd").write_text("before")
        try:
            write()
        except OutputError as error:
            assert "No space left" in str(error), error
        else:
            raise SystemExit(f"a disk with room for {share:.0%} of the file went unnoticed")
        assert [p.name for p in disk.iterdir()] == ["a.rrd"]
        assert (disk / "a.rrd").read_text() == "before"
        subprocess.run(["umount", disk], check=True)
print("done")
"""


def test_disk_full(tmp_path):
    unshare = shutil.which("unshare")
    own = [unshare or "", "--user", "--map-root-user", "--mount"]
    trial = [*own, "mount", "-t", "tmpfs", "tmpfs", str(tmp_path)]
    if unshare is None or subprocess.run(trial, capture_output=True, check=False).returncode:
        pytest.skip("this system does not allow to mount a small disk")
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*own, sys.executable, "-c", FULL_DISK, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.stdout == "done\n", done.stderr
