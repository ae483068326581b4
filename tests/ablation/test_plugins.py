"""Plug-ins of an installed package, of an importable module and of this process, in sweeps."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from plugins import MODULE, install, on_path, write_example
from small_sweep import pairs

from sfmkit.ablation import ablate, make_plan, read_sweep
from sfmkit.ablation.plugins import ESTIMATOR, PlugIn, load_plugins
from sfmkit.ablation.tasks import PairTask, estimate_key
from sfmkit.errors import InputError
from sfmkit.estimation import ESTIMATOR_PLUGINS, register_estimator
from sfmkit.features import OPERATOR_PLUGINS, register_operator
from sfmkit.features.weights import WEIGHTS
from sfmkit.options import EstimateOptions, FuseOptions, Options
from sfmkit.types import Camera

NAMED = {
    "operators": ["example-corners", "orb"],
    "matchers": {"example-corners": "example-matcher"},
    "backend": "example-estimator",
}
CORNERS = f"{MODULE}.features:corners"
IMPORTED = {
    "operators": [CORNERS, "orb"],
    "matchers": {CORNERS: f"{MODULE}.features:one_way"},
    "backend": f"{MODULE}.estimation:estimate",
}


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    return install(tmp_path_factory.mktemp("plugins"))


@pytest.fixture
def plugged(site):
    with on_path(site):
        yield site


@pytest.fixture
def root(tmp_path) -> Path:
    return write_example(tmp_path / "images")


def estimates(table) -> list:
    rows = sorted(table, key=lambda r: (r["pair"], r["sequence"], r["n_operators"], r["operators"]))
    return [(r["sequence"], r["status"], r["inliers"], r["R"], r["t"]) for r in rows]


def test_the_options_of_an_estimator_are_part_of_the_cache_keys():
    camera = Camera(np.array([[200.0, 0, 99.5], [0, 200, 79.5], [0, 0, 1]]), (200, 160))
    keys, variants = [], []
    for own in ({}, {"least": 8}, {"least": 9}):
        options = EstimateOptions(backend="example-estimator", overrides=own)
        keys.append(PairTask({}, (camera, camera), (None, None), FuseOptions(), options).key)
        variant = SimpleNamespace(preset="default", options=Options(estimate=options))
        variants.append(estimate_key(False, (camera, camera), variant, {}, (), 0))
    assert len(set(keys)) == len(set(variants)) == 3


@pytest.mark.slow
def test_plugins_of_a_package_run_in_local_workers(plugged, root, tmp_path):
    options = {"root": root, "workers": 1, "cache": tmp_path / "cache", "out": tmp_path / "out"}
    named = ablate("example-pairs", **NAMED, **options)
    assert {r["dataset"] for r in named} == {"example"}
    assert named["status"] == ["ok"] * 6, named["failure"]
    assert {o for r in named for o in r["operators"]} == {"example-corners", "orb"}
    assert all("example-estimator" in r["vary"] for r in named)
    kinds = {(p["kind"], p["name"]) for p in read_sweep(tmp_path / "out")["plugins"]}
    assert kinds == {
        ("operator", "example-corners"),
        ("matcher", "example-matcher"),
        ("estimator", "example-estimator"),
    }
    options |= {"out": tmp_path / "out2"}
    imported = ablate(f"{MODULE}.data:read_pairs", **IMPORTED, **options)
    assert imported["status"] == ["ok"] * 6, imported["failure"]
    plain = ablate("example-pairs", NAMED["operators"], **options | {"out": tmp_path / "out3"})
    assert estimates(plain) != estimates(named)


@pytest.mark.slow
@pytest.mark.cluster
def test_plugins_run_on_a_cluster(plugged, root, tmp_path, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setenv("PYTHONPATH", f"{plugged}:{Path(__file__).parents[2]}")
    local = ablate("example-pairs", **NAMED, root=root, workers=1, cache=tmp_path / "cache1")
    with LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        remote = ablate(
            "example-pairs",
            **NAMED,
            root=root,
            cache=tmp_path / "cache2",
            scheduler=cluster.scheduler_address,
        )
    assert remote["status"] == ["ok"] * 6, remote["failure"]
    assert estimates(remote) == estimates(local)


def test_a_change_of_the_source_changes_the_keys(tmp_path):
    data = pairs(tmp_path / "images", 0, 1)

    def keys() -> dict[str, set[str]]:
        plan = make_plan(data, **NAMED)
        return {
            "features": set(plan.detections),
            "matches": set(plan.matchings),
            "estimates": {job.key for unit in plan.units for job in unit.jobs},
        }

    site = install(tmp_path)
    with on_path(site):
        before = keys()
        assert keys() == before
        file = site / MODULE / "features.py"
        file.write_text(file.read_text().replace("count: int = 300", "count: int = 301"))
        after = keys()
    assert len(before["features"] & after["features"]) == 2  # those of orb
    assert len(before["features"] - after["features"]) == 2
    assert len(before["matches"] & after["matches"]) == 1
    assert not before["estimates"] & after["estimates"]


@pytest.mark.parametrize("operator", ["aliked", "affine-aliked"])
def test_other_weights_change_the_keys(tmp_path, monkeypatch, operator):
    """Planning reads the weights' bytes only, so any files will do."""
    data = pairs(tmp_path / "images", 1, 0)
    folders = {name: tmp_path / name for name in ("first", "second")}
    for folder in folders.values():
        folder.mkdir()
        for file in WEIGHTS.values():
            (folder / file.kornia_name).write_bytes(b"the same")

    def keys(folder: Path) -> tuple[set[str], set[str]]:
        monkeypatch.setenv("SFMKIT_WEIGHTS", str(folder))
        plan = make_plan(data, [operator], matchers="lightglue")
        return set(plan.detections), set(plan.matchings)

    first = keys(folders["first"])
    assert keys(folders["second"]) == first
    (folders["second"] / WEIGHTS["lightglue-aliked"].kornia_name).write_bytes(b"another")
    features, matches = keys(folders["second"])
    assert features == first[0]
    assert not matches & first[1]
    (folders["second"] / WEIGHTS["aliked-n16"].kornia_name).write_bytes(b"another")
    assert not keys(folders["second"])[0] & first[0]


def test_files_of_a_plugin_change_its_code():
    class Network:
        version = "1"

        def __call__(self, image): ...

        def provenance(self) -> str:
            return f"weights {self.version}"

    network = Network()
    register_operator("network", network)
    try:
        assert OPERATOR_PLUGINS.provenance("network").endswith(" weights 1")
        network.version = "2"
        assert OPERATOR_PLUGINS.provenance("network").endswith(" weights 2")
    finally:
        OPERATOR_PLUGINS.unregister("network")


def test_a_registered_function_works_where_it_can_be_imported(tmp_path, monkeypatch):
    (tmp_path / "my_operator.py").write_text(
        "from sfmkit.features import detect\n\n\n"
        "def find(image):\n    return detect(image, 'orb', nfeatures=200)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import my_operator  # type: ignore[import-not-found]

    register_operator("mine", my_operator.find)
    try:
        data = pairs(tmp_path / "images", 1, 0)
        table = ablate(data, ["mine"], workers=1, cache=tmp_path / "cache")
    finally:
        OPERATOR_PLUGINS.unregister("mine")
        sys.modules.pop("my_operator")
    assert table["status"] == ["ok"], table["failure"]
    assert table["operators"] == [["mine"]]


def test_what_no_worker_could_load_is_refused_when_planning(tmp_path):
    data = pairs(tmp_path / "images", 1, 0)
    register_estimator("closure", lambda x1, x2, K1, K2, *, seed: None)
    try:
        with pytest.raises(InputError, match="'closure' cannot be imported by another process"):
            make_plan(data, ["orb"], backend="closure")
    finally:
        ESTIMATOR_PLUGINS.unregister("closure")
    for wrong in ({"backend": "nonsense"}, {"vary": {"backend": ["torch", "nonsense"]}}):
        with pytest.raises(InputError, match="unknown estimator 'nonsense'"):
            make_plan(data, ["orb"], **wrong)
    with pytest.raises(InputError, match="unknown matcher 'nonsense'"):
        make_plan(data, ["orb"], matchers="nonsense")
    with pytest.raises(InputError, match="threshold_px must be positive"):
        make_plan(data, ["orb"], vary={"threshold_px": ["-1"]})


def test_a_worker_without_the_plugin_or_with_another_version_says_so():
    missing = PlugIn(ESTIMATOR, "no", "no_such_module:no", "x")
    assert "cannot load estimator 'no_such_module:no'" in load_plugins([missing])
    other = PlugIn(ESTIMATOR, "torch", "torch", "sfmkit 0.0.1")
    assert "the sweep was planned with sfmkit 0.0.1" in load_plugins([other])
