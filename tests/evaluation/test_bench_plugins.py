"""A matcher and an estimator of an installed package in the benchmarks of the paper."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from importlib import import_module
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from click.testing import CliRunner
from plugins import MODULE, on_path
from small_sweep import HEIGHT, WIDTH, pairs

import sfmkit.evaluation.maps as maps
import sfmkit.evaluation.oxford as oxford
from sfmkit.cli.bench import bench
from sfmkit.errors import InputError
from sfmkit.evaluation import bench_fountain, bench_map, bench_oxford, bench_uav

MATCHER, BACKEND = "example-matcher", "example-estimator"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """Shifted crops of one texture, as each of the data sets: oxford, strecha and uav."""
    root = tmp_path_factory.mktemp("data")
    shifted = pairs(root / "crops", homographies=3, two_views=0)
    graf, strecha, uav = (root / name for name in ("oxford/graf", "strecha/fountain-P11", "uav/s"))
    for folder in (graf, strecha / "images", strecha / "gt_dense_cameras", uav):
        folder.mkdir(parents=True)
    exif = PIL.Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 36  # FocalLengthIn35mmFilm
    for k in range(6):
        pair = shifted[max(k - 1, 0) % 3]
        image = PIL.Image.open(pair.image2 if k else pair.image1)
        image.save(graf / f"img{k + 1}.png")
        np.savetxt(graf / f"H1to{k + 1}p", pair.H)
        if k < 3:
            image.save(uav / f"{k}.jpg", exif=exif, quality=95)
            image.save(strecha / "images" / f"{k}.png")
            centre = [*-pair.H[:2, 2], 0] if k else [0, 0, 0]
            lines = [[200, 0, 99.5], [0, 200, 79.5], [0, 0, 1], [0, 0, 0], *np.eye(3).tolist()]
            lines += [centre, [WIDTH, HEIGHT]]
            text = "\n".join(" ".join(map(str, line)) for line in lines)
            (strecha / "gt_dense_cameras" / f"{k}.png.camera").write_text(text + "\n")
    return root


@pytest.fixture
def calls(site, monkeypatch):
    """The installed package; the numbers of matches that its estimator was called with."""
    seen = []
    with on_path(site):
        module = import_module(f"{MODULE}.estimation")
        estimate = module.estimate

        @wraps(estimate)
        def counted(x1, *args, **keywords):
            seen.append(len(x1))
            return estimate(x1, *args, **keywords)

        monkeypatch.setattr(module, "estimate", counted)
        yield seen


def settings_of(out: Path) -> dict:
    return json.loads((out / "rows.jsonl").read_text().splitlines()[0])["settings"]


def run(*command: str) -> None:
    done = CliRunner().invoke(bench, command, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert (
        f"--matcher orb={MATCHER}"
        in json.loads((Path(command[command.index("--out") + 1]) / "result.json").read_text())[
            "command"
        ]
    )


def common(name: str, data: Path, out: Path) -> list[str]:
    command = [name, "--data", str(data), "--out", str(out), "--operators", "orb"]
    return [*command, "--matcher", f"orb={MATCHER}"]


def test_oxford(calls, data, tmp_path, monkeypatch):
    run(*common("oxford", data, tmp_path), "--seeds", "1", "--workers", "1")
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()[1:]]
    found = [row for row in rows if row["kind"] == "features"]
    assert len(found) == 5
    # the matcher of the package has one match for each feature of image 1
    assert all(row["matches"] == row["keypoints"][0] > 100 for row in found)
    assert "sha256:" in settings_of(tmp_path)["plugins"]["matchers"][MATCHER]
    settings = {"data": data, "operators": ["orb"], "seeds": 1}
    with pytest.raises(InputError, match="was made with"):
        bench_oxford(tmp_path, **settings)
    loaded = []
    monkeypatch.setattr(oxford, "load_plugins", lambda plugins: loaded.append(plugins))
    monkeypatch.setattr(oxford, "process_pool", ThreadPoolExecutor)
    path = f"{MODULE}.features:one_way"
    again = bench_oxford(tmp_path / "2", **settings, matchers={"orb": path}, workers=2)
    counts = sorted(row["matches"] for row in again if row["kind"] == "features")
    assert counts == sorted(row["matches"] for row in found)
    assert {(p.kind, p.path) for plugins in loaded for p in plugins} == {("matcher", path)}


def test_fountain(calls, data, tmp_path):
    command = [*common("fountain", data, tmp_path), "--backend", BACKEND, "--scenes", ""]
    run(*command, "--presets", "default", "--seeds", "1")
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()[1:]]
    assert [row["matches"] for row in rows] == [row["keypoints"][0] for row in rows]
    assert len(calls) == len(rows) == 2
    assert "sha256:" in settings_of(tmp_path)["plugins"]["estimators"][BACKEND]
    settings = {
        "data": data,
        "operators": ["orb"],
        "scenes": (),
        "presets": ["default"],
        "seeds": 1,
    }
    for other in ({}, {"matchers": {"orb": MATCHER}}, {"backend": BACKEND}):
        with pytest.raises(InputError, match="was made with"):
            bench_fountain(tmp_path, **settings, **other)
    out = tmp_path / "none"
    with pytest.raises(InputError, match=f"'{BACKEND}' .*essential matrices only"):
        bench_fountain(out, **settings | {"presets": ["default", "paper"]}, backend=BACKEND)
    with pytest.raises(InputError, match="not used: surf"):
        bench_fountain(out, **settings, matchers={"surf": MATCHER})
    assert not out.exists()


def test_uav(calls, data, tmp_path):
    command = [*common("uav", data, tmp_path), "--backend", BACKEND, "--presets", "default"]
    run(*command, "--no-colmap")
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()[1:]]
    assert len(calls) == len(rows) == 3
    assert [row["initial"] for row in rows] == calls
    with pytest.raises(InputError, match="was made with"):
        bench_uav(tmp_path, data=data, operators=["orb"], presets=["default"], colmap=False)
    with pytest.raises(InputError, match="unknown estimator 'none'"):
        bench_uav(tmp_path / "none", data=data, operators=["orb"], backend="none")


def test_map(calls, data, tmp_path, monkeypatch):
    pytest.importorskip("pycolmap")
    seen = []

    def keep(matched, database, options):
        seen.append(matched)
        raise KeyboardInterrupt

    monkeypatch.setattr(maps, "map_matched", keep)
    chosen = {"matchers": {"orb": MATCHER}, "backend": BACKEND}
    settings = {"data": data, "operators": ["orb", "fast-brief"], "workers": 1}
    with pytest.raises(KeyboardInterrupt):
        bench_map(tmp_path, **settings, **chosen)
    (matched,) = seen
    assert matched.plan.recipe.options.match.matchers == {"orb": MATCHER}
    features = matched.features(0, "orb")
    meta = matched.geometry(0).meta
    assert meta["operators"]["orb"]["matches"] == len(features)
    used = settings_of(tmp_path)["plugins"]
    assert set(used["matchers"]) == {"nearest", MATCHER}
    assert set(used["estimators"]) == {BACKEND}
    with pytest.raises(InputError, match="was made with"):
        bench_map(tmp_path, **settings)
