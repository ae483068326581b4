"""The example plug-in package, installed into a folder of its own."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from small_sweep import pairs

from sfmkit.datasets import DATASETS
from sfmkit.estimation import ESTIMATOR_PLUGINS
from sfmkit.features import OPERATOR_PLUGINS
from sfmkit.matching import MATCHER_PLUGINS

PACKAGE = Path(__file__).parent / "plugin_package"
MODULE = "sfmkit_example_plugins"
REGISTRIES = (DATASETS, ESTIMATOR_PLUGINS, OPERATOR_PLUGINS, MATCHER_PLUGINS)


def install(folder: Path) -> Path:
    """Install the package with pip; returns the folder to add to the search path."""
    source, site = folder / "source", folder / "site"
    shutil.copytree(PACKAGE, source)
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"),
            *("--no-build-isolation", "--disable-pip-version-check"),
            *("--target", str(site), str(source)),
        ],
        check=True,
    )
    return site


@contextmanager
def on_path(site: Path) -> Iterator[None]:
    """Make an installed package available to this process and to the workers that it starts."""
    sys.path.insert(0, str(site))
    _forget()
    try:
        yield
    finally:
        sys.path.remove(str(site))
        for name in [n for n in sys.modules if n.partition(".")[0] == MODULE]:
            del sys.modules[name]
        _forget()


def _forget() -> None:
    """Drop the entry points that the registries remember."""
    for registry in REGISTRIES:
        registry.__dict__.pop("_entry_points", None)


def write_example(folder: Path) -> Path:
    """The data set of the package: two pairs of shifted crops."""
    found = {}
    for pair in pairs(folder, homographies=0, two_views=2):
        assert pair.camera1 is not None
        assert pair.R is not None
        assert pair.t is not None
        found[pair.name] = {
            "image1": Path(pair.image1).name,
            "image2": Path(pair.image2).name,
            "K": pair.camera1.K.tolist(),
            "size_wh": pair.camera1.size_wh,
            "R": pair.R.tolist(),
            "t": pair.t.tolist(),
        }
    (folder / "example.json").write_text(json.dumps(found))
    return folder
