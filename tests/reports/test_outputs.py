"""The folder of a reconstruction: what is written, and that a failed part leaves nothing."""

from __future__ import annotations

import json

import pytest
from made_up_result import make_result

from sfmkit.errors import OutputError
from sfmkit.recording import read_recording
from sfmkit.reports import outputs, write_outputs

RESULT = make_result(points=20, outliers=5, lonely=3)
ALWAYS = {"report.json", "matches.npz", "cloud.ply"}


@pytest.mark.parametrize("pictures", [False, True])
@pytest.mark.parametrize("recording", [False, True])
def test_pictures_and_the_recording_can_be_left_out(tmp_path, pictures, recording):
    report = write_outputs(RESULT, tmp_path / "out", pictures=pictures, recording=recording)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == (
        ALWAYS
        | ({"matches.png", "cloud.png"} if pictures else set())
        | ({"recording.rrd"} if recording else set())
    )
    assert json.loads((tmp_path / "out" / "report.json").read_text()) == report
    if recording:
        assert "/world/points/operator" in read_recording(tmp_path / "out" / "recording.rrd")


def test_a_recording_that_fails_beside_the_pictures_leaves_nothing(tmp_path, monkeypatch):
    def fail(folder, result):
        raise OutputError("the recording cannot be written")

    monkeypatch.setattr(outputs, "_record", fail)
    with pytest.raises(OutputError, match="cannot be written"):
        write_outputs(RESULT, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
