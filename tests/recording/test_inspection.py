"""Answers about a recording against the arrays it was made from, and invalid recordings."""

from __future__ import annotations

import random
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from click.testing import CliRunner
from made_up_result import OPERATORS, POINTS, make_result

from sfmkit.cli import main
from sfmkit.cli.inspect import inspect, view
from sfmkit.errors import OperatorError, SfmError
from sfmkit.recording import merge_recordings, viewer
from sfmkit.recording.inspection import (
    describe_entity,
    describe_operator,
    describe_point,
    describe_recording,
    diff_recordings,
)
from sfmkit.recording.log import save_recording
from sfmkit.recording.read import RecordingError, read_recording

RESULT = make_result()


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("inspection") / "a.rrd"
    save_recording(path, RESULT)
    return path


@pytest.mark.parametrize("n", [0, 1, 2, 4, 8, POINTS - 1])
def test_a_point_is_followed_back_to_its_pixels_and_operators(path, n):
    words = describe_point(path, n)
    cloud, corr = RESULT.cloud, RESULT.correspondences
    assert words.startswith(f"point {n} of {POINTS}, match {n} of {len(corr)}: point\n")
    x, y, z = cloud.xyz[n].tolist()
    assert f"point {n} at ({x:.3f}, {y:.3f}, {z:.3f}) baselines" in words
    for image, x in ((1, corr.x1[n]), (2, corr.x2[n])):
        assert re.search(rf"in image {image}, keypoint \d+, at \({x[0]:.1f}, {x[1]:.1f}\)", words)
    kept = OPERATORS[n % 3]
    found_by = {kept} | ({OPERATORS[(n + 1) % 3]} if n % 4 == 0 else set())
    said = re.search(r"the position of (.*) was kept; found by (.*)", words)
    assert (said[1], set(said[2].split(", "))) == (kept, found_by)
    assert f"error {float(cloud.reprojection_error[n]):.2f} px" in words
    worse = 100 * (POINTS - 1 - n) / POINTS  # the residuals of the fixture grow with n
    assert f"{worse:.0f} % of the points have a larger one" in words
    assert f"parallax {float(cloud.parallax[n]):.2f} deg" in words
    sigma = 0.0101**0.5
    assert f"deviation {sigma:.4f} baselines in the worst direction" in words
    assert f"{100 * sigma / z:.2f} % of the depth" in words
    merged = re.findall(
        r"(\S+) keypoints (\d+) at \((\S+), (\S+)\) and (\d+) at \((\S+), (\S+)\) were", words
    )
    assert {name for name, *_ in merged} == found_by - {kept}
    for name, k1, *xy1, k2, x2, y2 in merged:
        for f, k, xy, x in zip(
            RESULT.features[name], (k1, k2), (xy1, (x2, y2)), (corr.x1[n], corr.x2[n]), strict=True
        ):
            said_xy = np.array(xy, dtype=float)
            np.testing.assert_allclose(said_xy, f.keypoints[int(k)], atol=0.051)
            assert np.hypot(*(said_xy - x.numpy())) < 0.7  # the fixture merges from 0.57 px away


def test_a_point_without_a_covariance(path):
    bare = replace(RESULT, cloud=replace(RESULT.cloud, covariance=None))
    other = path.with_name("bare.rrd")
    save_recording(other, bare)
    assert "deviation" in describe_point(path, 4)
    assert "deviation" not in describe_point(other, 4)


def test_the_overview_has_verdict_pose_and_account(path):
    words = describe_recording(path)
    assert "general: Made up." in words
    assert "preset default" in words
    assert "rotation 5.000 deg, translation direction (-0.9600, +0.0000, +0.2800)" in words
    for name, line in RESULT.account.items():
        row = next(
            r for r in words.splitlines() if r.startswith("all" if name == "multi" else name)
        )
        numbers = [
            *line.keypoints,
            line.matches,
            line.initial,
            line.inliers,
            line.points,
            line.points_alone,
        ]
        assert row.split()[1:8] == [str(v) for v in numbers]


def test_how_an_operator_did(path):
    words = describe_operator(path, "orb")
    line = RESULT.account["orb"]
    assert re.search(rf"(?m)^orb +{line.keypoints[0]} +{line.keypoints[1]} +{line.matches}", words)
    assert re.search(r"(?m)^point +100 ", words)
    assert re.search(r"(?m)^unmatched +50 ", words)
    assert re.search(
        rf"(?m)^merged into a duplicate +{RESULT.correspondences.counts['orb'].merged} ", words
    )
    mine = RESULT.cloud.found_by("orb")
    median = float(np.median(RESULT.cloud.reprojection_error[mine]))
    assert re.search(rf"median residual, px +{median:.4g}", words)
    with pytest.raises(OperatorError, match="Did you mean 'orb'"):
        describe_operator(path, "orbb")


def test_what_an_entity_holds(path):
    words = describe_entity(path, "world/points/operator")
    assert re.search(r"sfmkit:parallax_deg +300 +2 \.\. 12 +stage 7", words)
    assert (
        "below it: density, note, operator, parallax, photograph, uncertainty"
        in describe_entity(path, "/world/points")
    )
    assert "always" in describe_entity(path, "/report")
    with pytest.raises(RecordingError, match="Did you mean /world/points/operator"):
        describe_entity(path, "/world/point/operators")


def test_what_changed_between_two(path, tmp_path):
    assert "the same" in diff_recordings(path, path).splitlines()[0]
    assert (
        f"{POINTS} points have the same pixels in both, 0 are gone, 0 are new"
        in diff_recordings(path, path)
    )
    cloud = RESULT.cloud
    fewer = replace(
        cloud,
        xyz=cloud.xyz[:200] * 1.01,
        rgb=cloud.rgb[:200],
        operator_id=cloud.operator_id[:200],
        operator_mask=cloud.operator_mask[:200],
        reprojection_error=cloud.reprojection_error[:200],
        parallax=cloud.parallax[:200],
        match=cloud.match[:200],
        covariance=None,
    )
    from sfmkit.pipeline.account import make_account

    corr, view = RESULT.correspondences, RESULT.two_view
    c, s = np.cos(np.radians(0.5)), np.sin(np.radians(0.5))
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ view.R.numpy()
    turned = replace(view, R=view.R.new_tensor(R))
    other = replace(
        RESULT,
        cloud=fewer,
        two_view=turned,
        seed=7,
        account=make_account(corr, view.inliers, fewer),
    )
    save_recording(tmp_path / "b.rrd", other)
    words = diff_recordings(path, tmp_path / "b.rrd")
    assert re.search(r"seed +0 +7", words)
    assert "The rotations differ by 0.5000 deg" in words
    assert re.search(r"all +425 +340 +300 +200 \(-100\)", words)
    moved = float(np.median(np.linalg.norm(0.01 * cloud.xyz[:200].numpy(), axis=1)))
    assert "200 points have the same pixels in both, 100 are gone, 0 are new." in words
    said = float(re.search(r"moved by (\S+) baselines", words)[1])
    assert said == pytest.approx(moved, rel=1e-3)


def test_recordings_of_different_photographs_are_not_compared(path, tmp_path):
    other = make_result(size_wh=(640, 480))
    save_recording(tmp_path / "b.rrd", other)
    with pytest.raises(RecordingError, match=r"320 x 240.*640 x 480.*same photographs"):
        diff_recordings(path, tmp_path / "b.rrd")


def test_the_overview_rounds_the_errors(tmp_path):
    errors = {"rotation_deg": 0.003148852862381044, "translation_deg": 0.1234567}
    save_recording(tmp_path / "a.rrd", replace(RESULT, errors=errors))
    words = describe_recording(tmp_path / "a.rrd")
    assert "rotation 0.003, translation direction 0.123 deg" in words


@pytest.mark.parametrize("n", [-1, POINTS, 10**9])
def test_a_point_out_of_range(path, n):
    with pytest.raises(RecordingError, match=f"points 0 to {POINTS - 1}"):
        describe_point(path, n)


def test_a_recording_without_a_cloud(tmp_path):
    save_recording(tmp_path / "a.rrd", replace(RESULT, cloud=None))
    with pytest.raises(RecordingError, match=r"no cloud; its verdict is: general"):
        describe_point(tmp_path / "a.rrd", 0)


def test_several_reconstructions_in_one_file_are_distinguished(tmp_path):
    from sfmkit.recording.log import log_reconstruction

    rec = rr.RecordingStream("sfmkit", recording_id="two", send_properties=False)
    rec.save(tmp_path / "two.rrd")
    log_reconstruction(rec, RESULT, "first")
    log_reconstruction(rec, make_result(points=60), "second")
    rec.flush()
    rec.disconnect()
    words = describe_recording(tmp_path / "two.rrd")
    assert "two.rrd, /first" in words
    assert "two.rrd, /second" in words
    assert "of 60" in describe_point(tmp_path / "two.rrd", 3, "/second")
    with pytest.raises(RecordingError, match="it has some under /first, /second"):
        describe_point(tmp_path / "two.rrd", 3)


@pytest.mark.parametrize("share", [0.0, 0.00001, 0.01, 0.5, 0.9, 0.99, 0.9999])
def test_a_file_that_is_cut_off(path, tmp_path, share):
    data = path.read_bytes()
    (tmp_path / "cut.rrd").write_bytes(data[: int(share * len(data))])
    with pytest.raises(RecordingError, match=r"cut off|empty"):
        read_recording(tmp_path / "cut.rrd")


def test_files_that_are_not_recordings(tmp_path):
    (tmp_path / "text.rrd").write_text("hello, this is not a recording\n")
    (tmp_path / "short.rrd").write_bytes(b"RR")
    for name, words in (
        ("text.rrd", "not a recording"),
        ("short.rrd", "not a recording"),
        ("none.rrd", "there is no file"),
        (".", "cannot be read"),
    ):
        with pytest.raises(RecordingError, match=words):
            read_recording(tmp_path / name)


def test_a_recording_of_a_newer_viewer(path, tmp_path):
    data = bytearray(path.read_bytes())
    assert tuple(data[4:6]) == rr.__version_info__[:2]
    data[5] += 7
    (tmp_path / "newer.rrd").write_bytes(data)
    major, minor = rr.__version_info__[:2]
    with pytest.raises(
        RecordingError,
        match=rf"written by Rerun {major}\.{minor + 7}, this is Rerun {major}\.{minor}",
    ):
        read_recording(tmp_path / "newer.rrd")


def test_a_recording_of_another_schema(path, tmp_path, monkeypatch):
    monkeypatch.setattr("sfmkit.recording.read.SCHEMA", 99)
    with pytest.raises(RecordingError, match=r"follows schema 2 .* reads schema 99"):
        describe_recording(path)


def test_a_recording_of_something_else(tmp_path):
    rec = rr.RecordingStream("other", recording_id="x", send_properties=False)
    rec.save(tmp_path / "other.rrd")
    rec.log("a/b", rr.Points3D([[1, 2, 3]]))
    rec.flush()
    rec.disconnect()
    with pytest.raises(RecordingError, match="not written by sfmkit"):
        describe_recording(tmp_path / "other.rrd")
    assert "Points3D:positions" in describe_entity(tmp_path / "other.rrd", "/a/b")


def test_damaged_bytes_never_end_in_anything_but_an_error_of_ours(path, tmp_path):
    rng = random.Random(0)
    data = path.read_bytes()
    refused = 0
    for _ in range(6):
        bad = bytearray(data)
        for _ in range(20):
            bad[rng.randrange(8, len(bad))] ^= 1 << rng.randrange(8)
        (tmp_path / "bad.rrd").write_bytes(bad)
        try:
            describe_recording(tmp_path / "bad.rrd")
        except SfmError:
            refused += 1
    assert refused  # most flips land in pixels, some in the structure


def test_a_panic_in_the_reader_is_an_error(path, tmp_path, monkeypatch):
    """Some damaged files make Rerun's reader abort its process; which ones depends on Rerun."""
    from sfmkit.recording import _reader

    script = tmp_path / "reader.py"
    monkeypatch.setattr(_reader, "__file__", str(script))
    script.write_text("import os; os.abort()")
    for command in ([], ["--diff", str(path)]):
        result = CliRunner().invoke(main, ["inspect", str(path), *command])
        assert result.exit_code == 2
        assert "cut off or damaged" in result.stderr
    for command in ([], ["--web"]):
        assert CliRunner().invoke(main, ["view", str(path), *command]).exit_code == 2
    with pytest.raises(RecordingError, match="damaged"):
        merge_recordings(tmp_path / "merged.rrd", [path])
    script.write_text("import no_such_module")
    with pytest.raises(RuntimeError, match="no_such_module"):  # not the fault of the file
        read_recording(path)


def test_the_commands(path, tmp_path):
    run = CliRunner().invoke
    assert run(inspect, [str(path), "--point", "4"]).output.startswith("point 4 of 300")
    assert run(inspect, [str(path), "--operator", "surf"]).output.startswith("surf in ")
    assert run(inspect, [str(path), "--entity", "/world"]).output.startswith("/world")
    assert "the same" in run(inspect, [str(path), "--diff", str(path)]).output
    assert "verdict" in run(inspect, [str(path)]).output
    both = run(inspect, [str(path), "--point", "4", "--operator", "surf"])
    assert isinstance(both.exception, SfmError)
    assert "at a time" in str(both.exception)


def test_no_display_is_said_and_the_way_out_named(path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(subprocess, "call", lambda *_: pytest.fail("no window must be tried"))
    failed = CliRunner().invoke(view, [str(path)])
    assert isinstance(failed.exception, viewer.ViewerError)
    assert f"sfmkit view --web {path}" in str(failed.exception)


def test_the_viewer_is_served_on_the_loopback_interface_only(path):
    from urllib.request import urlopen

    with viewer.serve(path) as server:
        page = urlopen(f"http://127.0.0.1:{server.web_port}/", timeout=10).read().decode()
        assert "rerun" in page.lower()
        if Path("/proc/net/tcp").exists():
            rows = [
                line.split()[1:4] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
            ]
            bound = {
                int(a.split(":")[1], 16): a.split(":")[0] for a, _, state in rows if state == "0A"
            }
            assert {bound[server.web_port], bound[server.data_port]} == {"0100007F"}
    assert not viewer.listens(server.web_port)
    assert not viewer.listens(server.data_port)


def test_the_viewer_is_not_started_for_other_files(tmp_path):
    (tmp_path / "text.rrd").write_text("hello, this is not a recording\n")
    for show in (viewer.open_window, lambda p: viewer.serve(p).__enter__()):
        with pytest.raises(RecordingError):
            show(tmp_path / "text.rrd")
