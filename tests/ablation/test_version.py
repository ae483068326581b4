"""Cache keys: every module that a stage imports is part of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import sfmkit
from sfmkit.ablation.version import STAGES, dependencies, imports_of

ROOT = Path(sfmkit.__file__).parent


def test_every_module_that_a_stage_imports_is_in_its_key():
    """Against what the interpreter loads, in a process of its own."""
    code = (
        "import sys, importlib\n"
        "for package in sys.argv[1:]:\n"
        "    importlib.import_module('sfmkit.' + package)\n"
        "    files = [getattr(m, '__file__', None) for n, m in list(sys.modules.items())\n"
        "             if n.startswith('sfmkit.')]\n"
        "    print(*filter(None, files), sep='|')"
    )
    packages = {STAGES[stage][0]: stage for stage in ("matches", "features", "estimates")}
    done = subprocess.run(
        [sys.executable, "-c", code, *packages], capture_output=True, text=True, check=True
    )
    known: set[Path] = set()
    for line, stage in zip(done.stdout.splitlines(), packages.values(), strict=True):
        known |= set(dependencies(stage)[0])
        loaded = {Path(file) for file in line.split("|")}
        assert len(loaded) > 10
        assert loaded <= known


def test_what_the_calls_of_the_stages_import_is_in_a_key():
    own, _ = imports_of(ROOT / "ablation" / "stages.py")
    files = {f.relative_to(ROOT) for stage in STAGES for f in dependencies(stage)[0]}
    known = {file.parts[0].removesuffix(".py") for file in files}
    assert {"features", "matching", "estimation", "pipeline"} <= own <= known


@pytest.mark.parametrize(
    "stage, libraries",
    [
        ("features", {"cv2", "kornia", "numpy", "torch"}),
        ("matches", {"numpy", "torch"}),
        ("estimates", {"cv2", "kornia", "poselib", "pycolmap", "scipy", "torch"}),
    ],
)
def test_the_libraries_of_a_stage_are_in_its_key(stage, libraries):
    pytest.importorskip("poselib")
    pytest.importorskip("pycolmap")
    assert libraries <= set(dependencies(stage)[1])


def test_plots_are_in_no_key():
    for stage in STAGES:
        tops = {file.relative_to(ROOT).parts[0] for file in dependencies(stage)[0]}
        assert not tops & {"viz", "recording", "notebook", "cli", "reports"}


def test_imports_under_type_checking_do_not_count():
    own, others = imports_of(ROOT / "__init__.py")
    assert "pipeline" not in own
    assert not others
