"""The command's manners: fast to answer, quiet when told, a report that obeys its schema."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from plyfile import PlyData

from sfmkit.cli import main
from sfmkit.pipeline.report import schema


@pytest.fixture(scope="module")
def demo_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "o"
    result = CliRunner().invoke(main, ["demo", "--out", str(out)])
    assert result.exit_code == 0, result.output
    return out, result


def test_the_demo_knows_its_truth(demo_run):
    out, result = demo_run
    report = json.loads((out / "report.json").read_text())
    jsonschema.validate(report, schema())
    assert report["verdict"]["kind"] == "general"
    assert report["errors"]["rotation_deg"] < 0.05
    assert report["errors"]["translation_deg"] < 0.25
    assert report["operators"]["multi"]["points"] > 3000
    for name in ("surf", "orb", "fast-brief"):
        assert report["operators"][name]["points"] > 100
    for word in ("loss", "surf", "orb", "fast-brief", "error", "report.json", "recording.rrd"):
        assert word in result.stdout


def test_the_files_agree_with_the_report(demo_run):
    out, _ = demo_run
    report = json.loads((out / "report.json").read_text())
    matches = np.load(out / "matches.npz", allow_pickle=False)
    cloud = PlyData.read(out / "cloud.ply")["vertex"]
    assert len(cloud) == report["operators"]["multi"]["points"] == (matches["point"] >= 0).sum()
    assert len(matches["x1"]) == report["operators"]["multi"]["initial"]
    assert matches["inlier"].sum() == report["operators"]["multi"]["inliers"]
    for bit, name in enumerate(matches["operators"]):
        assert ((matches["operator_mask"] >> bit) & 1).sum() == report["operators"][str(name)][
            "initial"
        ]
    # the cloud reprojects onto the matched pixels with the camera of the report
    K = np.array(report["camera"][0]["K"])
    X = np.stack([cloud["x"], cloud["y"], cloud["z"]], 1).astype(float)
    x = X @ K.T
    rows = np.argsort(matches["point"])[-len(X) :]
    assert np.median(np.linalg.norm(x[:, :2] / x[:, 2:] - matches["x1"][rows], axis=1)) < 0.5


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits(demo_run, tmp_path):
    out, _ = demo_run
    assert (
        CliRunner().invoke(main, ["demo", "--out", str(tmp_path / "o"), "--quiet"]).exit_code == 0
    )
    a, b = (json.loads((folder / "report.json").read_text()) for folder in (out, tmp_path / "o"))
    for report in (a, b):
        del report["timings_s"]
    assert a == b
    assert (out / "cloud.ply").read_bytes() == (tmp_path / "o/cloud.ply").read_bytes()


def test_quiet_prints_nothing_and_json_prints_the_report(tmp_path):
    quiet = CliRunner().invoke(main, ["demo", "--out", str(tmp_path / "a"), "--quiet"])
    assert (quiet.stdout, quiet.stderr) == ("", "")
    as_json = CliRunner().invoke(main, ["demo", "--out", str(tmp_path / "b"), "--json"])
    jsonschema.validate(json.loads(as_json.stdout), schema())


def test_operators_lists_what_is_here():
    result = CliRunner().invoke(main, ["operators", "--json"])
    rows = {row["name"]: row for row in json.loads(result.stdout)}
    assert {
        "surf",
        "orb",
        "fast-brief",
        "sift",
        "rootsift",
        "akaze",
        "kaze",
        "brisk",
        "harris-brief",
        "gftt-brief",
        "xfeat",
    } <= set(rows)
    assert rows["surf"]["available"]
    assert "8,165,401" in rows["surf"]["licence"]
    assert CliRunner().invoke(main, ["operators"]).exit_code == 0


def test_matchers_lists_what_is_here():
    result = CliRunner().invoke(main, ["matchers", "--json"])
    rows = {row["name"]: row for row in json.loads(result.stdout)}
    assert rows["nearest"]["available"]
    assert rows["lightglue"]["available"] or "--no-deps" in rows["lightglue"]["reason"]
    assert "aliked" in rows["lightglue"]["operators"]
    assert "aliked" in CliRunner().invoke(main, ["matchers"]).output


def seconds(*command: str) -> float:
    """The fastest of five: what the command costs when nothing else disturbs it."""
    times = []
    for _ in range(5):
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return min(times)


def test_import_and_help_do_not_load_the_heavy_libraries():
    heavy = (
        "import sys; loaded = {'torch', 'cv2', 'kornia', 'rerun', 'matplotlib', 'scipy', 'numpy'} "
        "& set(sys.modules); assert not loaded, sorted(loaded)"
    )
    subprocess.run([sys.executable, "-c", f"import sfmkit; {heavy}"], check=True)
    code = (
        "import sfmkit.cli.main; from click.testing import CliRunner; "
        f"CliRunner().invoke(sfmkit.cli.main, ['--help']); {heavy}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_help_is_within_a_few_times_of_a_bare_interpreter():
    bare = seconds(sys.executable, "-c", "pass")
    assert seconds(sys.executable, "-m", "sfmkit.cli", "--help") < 12 * bare + 0.1


def test_the_public_names_resolve():
    import sfmkit

    for name in sfmkit.__all__:
        assert getattr(sfmkit, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        sfmkit.nonsense  # noqa: B018
