"""A folder from photographs to the table of its pairs."""

from __future__ import annotations

import json

import numpy as np
import PIL.Image
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from click.testing import CliRunner
from photograph_folder import SIZE, K, scene
from small_sweep import InlineEngine

from sfmkit.ablation import worker
from sfmkit.ablation.engines import LocalEngine
from sfmkit.cli import main
from sfmkit.errors import InputError
from sfmkit.mapping import Workshop, match_folder, read_collection
from sfmkit.mapping.retrieval import similarities
from sfmkit.matching import fuse
from sfmkit.types import Matches


@pytest.fixture(scope="module", autouse=True)
def no_processes():
    """Work in this process: starting workers takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sfmkit.ablation.engine_choice.LocalEngine", InlineEngine)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = scene(tmp_path_factory.mktemp("photographs") / "p")
    (made / "broken.jpg").write_text("not an image")
    return made


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def matched(folder, cache):
    workshop = Workshop.of(cache, workers=1)
    return match_folder(folder, intrinsics=K, operators=("orb", "fast-brief"), workshop=workshop)


def test_every_pair_has_a_row_with_the_counts_of_its_operators(matched):
    rows = matched.table.to_pylist()
    assert [(r["image1"], r["image2"]) for r in rows] == [
        ("0.png", "1.png"),
        ("0.png", "2.png"),
        ("1.png", "2.png"),
    ]
    assert matched.unreadable.keys() == {"broken.jpg"}
    for row in rows:
        assert row["verdict"] == "general"
        assert row["matches"] == row["matches_orb"] + row["matches_fast-brief"]
        R = np.array([row[f"R{i}{j}"] for i in (1, 2, 3) for j in (1, 2, 3)]).reshape(3, 3)
        angle = np.degrees(np.arccos((np.trace(R) - 1) / 2))
        assert angle < 0.5  # the camera only moves sideways
        assert abs(row["t1"]) > 0.99
        assert row["sigma_rotation_deg"] > 0


def test_the_stored_matches_are_those_of_the_fusion(matched):
    """Inliers and leaders refer to the matches before fusion, as `fuse` merges them."""
    entry = matched.geometry(0)
    operators = matched.plan.recipe.operators
    features = {o: (matched.features(0, o), matched.features(1, o)) for o in operators}
    a, raw = entry.arrays, {}
    for k, name in enumerate(operators):
        rows = a["operator"] == k
        n = int(rows.sum())
        raw[name] = (
            *features[name],
            Matches(
                a["index1"][rows].astype(np.int64),
                a["index2"][rows].astype(np.int64),
                np.zeros(n, np.float32),
                a["ratio"][rows],
            ),
        )
    fused = fuse(raw)
    kept = a["leader"] == np.arange(len(a["leader"]))
    assert kept.sum() == len(fused) == entry.meta["correspondences"]
    assert np.array_equal(a["index1"][kept], fused.index1.numpy())
    assert (a["inlier"] & kept).sum() == entry.meta["inliers"]
    assert np.array_equal(a["inlier"], a["inlier"][a["leader"]])


def test_the_same_call_takes_everything_from_the_cache(folder, cache, matched, monkeypatch):
    def no_engine(*_args):
        raise AssertionError("a worker was started")

    monkeypatch.setattr("sfmkit.ablation.engine_choice.LocalEngine", no_engine)
    workshop = Workshop.of(cache, workers=1)
    again = match_folder(folder, intrinsics=K, operators=("orb", "fast-brief"), workshop=workshop)
    assert again.table == matched.table


def test_shards_together_are_the_whole(folder, cache, matched):
    workshop = Workshop.of(cache, workers=1)
    parts = [
        match_folder(
            folder,
            intrinsics=K,
            operators=("orb", "fast-brief"),
            shard=(k, 2),
            workshop=workshop,
        )
        for k in (1, 2)
    ]
    assert pa.concat_tables([p.table for p in parts]) == matched.table
    with pytest.raises(InputError, match="3 pairs cannot be split into 4 shards"):
        matched.plan.part((1, 4))


def test_masked_keypoints_are_not_matched(folder, cache, tmp_path):
    mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    mask[:, 200:] = 255
    for k in range(3):
        PIL.Image.fromarray(mask).save(tmp_path / f"{k}.png")
    workshop = Workshop.of(cache, workers=1)
    found = match_folder(
        folder, intrinsics=K, operators=("orb",), masks=tmp_path, workshop=workshop
    )
    a = found.geometry(0).arrays
    for index, which in ((0, "index1"), (1, "index2")):
        assert (found.features(index, "orb").keypoints[a[which], 0] > 199).all()
    PIL.Image.fromarray(mask[:-1]).save(tmp_path / "0.png")
    found = match_folder(
        folder, intrinsics=K, operators=("orb",), masks=tmp_path, workshop=workshop
    )
    assert found.verdicts["failed"] == 2
    assert "a mask has 320 x 239 pixels" in found.table["failure"][0].as_py()


def test_the_command_writes_the_table_and_refuses_an_existing_folder(folder, tmp_path, monkeypatch):
    out = tmp_path / "o"
    command = ["pairs", str(folder), "--intrinsics", K, "--operators", "orb,fast-brief"]
    command += ["--cache", str(tmp_path / "c"), "--out", str(out), "--workers", "1"]
    monkeypatch.setattr("sfmkit.ablation.engine_choice.LocalEngine", LocalEngine)
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    assert "3 photographs, 3 pairs: 3 general" in done.output
    assert "1 files were skipped" in done.output
    assert {p.name for p in out.iterdir()} == {
        "pairs.parquet",
        "pairs.csv",
        "pairs.json",
        "graph.png",
    }
    table = pyarrow.csv.read_csv(out / "pairs.csv")
    assert len(set(table.column_names)) == len(table.column_names)
    assert table["inliers"].to_pylist() == (
        pyarrow.parquet.read_table(out / "pairs.parquet")["inliers"].to_pylist()
    )
    report = json.loads((out / "pairs.json").read_text())
    assert report["connected_parts"] == [3]
    again = CliRunner().invoke(main, command)
    assert again.exit_code == 2
    assert "exists" in again.output


def test_two_cameras_of_different_sizes_in_two_subfolders(folder, cache, tmp_path):
    """The second photograph is half as large, with half the focal length: equal rays."""
    (tmp_path / "p/left").mkdir(parents=True)
    (tmp_path / "p/right").mkdir()
    (tmp_path / "p/left/0.png").write_bytes((folder / "0.png").read_bytes())
    half = PIL.Image.open(folder / "1.png").resize((160, 120), PIL.Image.Resampling.BOX)
    half.save(tmp_path / "p/right/1.png")
    intrinsics = {"left": K, "right": "150,150,79.5,59.5"}
    workshop = Workshop.of(cache, workers=1)
    found = match_folder(
        tmp_path / "p", intrinsics=intrinsics, operators=("surf", "orb"), workshop=workshop
    )
    assert [c.size_wh for c in found.plan.cameras.cameras] == [(320, 240), (160, 120)]
    (row,) = found.table.to_pylist()
    assert row["verdict"] == "general"
    R = np.array([row[f"R{i}{j}"] for i in (1, 2, 3) for j in (1, 2, 3)]).reshape(3, 3)
    assert np.degrees(np.arccos((np.trace(R) - 1) / 2)) < 1.5
    assert abs(row["t1"]) > 0.95


@pytest.mark.parametrize("copies", [0, 2])
def test_the_command_refuses_a_folder_with_one_photograph(folder, tmp_path, copies):
    (tmp_path / "p").mkdir()
    for k in range(1 + copies):
        (tmp_path / f"p/{k}.png").write_bytes((folder / "0.png").read_bytes())
    (tmp_path / "p/broken.jpg").write_bytes(b"not an image")
    done = CliRunner().invoke(
        main, ["pairs", str(tmp_path / "p"), "--out", str(tmp_path / "o"), "--quiet"]
    )
    assert done.exit_code == 2
    assert "holds 1 usable photographs and a pair takes two" in done.output
    assert "broken.jpg" in done.output
    assert not (tmp_path / "o").exists()


def test_a_photograph_that_cannot_be_decoded_fails_its_pairs_only(folder, cache, tmp_path):
    for k in range(3):
        (tmp_path / f"{k}.png").write_bytes((folder / f"{k}.png").read_bytes())
    data = (tmp_path / "1.png").read_bytes()
    (tmp_path / "1.png").write_bytes(data[: len(data) // 2])
    workshop = Workshop.of(cache, workers=1)
    found = match_folder(tmp_path, intrinsics=K, operators=("orb", "fast-brief"), workshop=workshop)
    assert found.verdicts == {"general": 1, "failed": 2}
    assert found.unreadable.keys() == {"1.png"}


def test_photographs_of_one_place_are_the_most_similar(folder, tmp_path, data_dir):
    """Two sequences, mixed: every photograph is most similar to one of its own sequence."""
    from sfmkit import detect, read_image

    files = [data_dir / f"oxford/{s}/img{k}.png" for k in (1, 2, 3) for s in ("graf", "wall")]
    found = [detect(read_image(f), "sift", budget=500, max_size=480) for f in files]
    similarity = similarities(lambda k: found[k], len(found))
    np.fill_diagonal(similarity, -1)
    assert all(k % 2 == int(similarity[k].argmax()) % 2 for k in range(len(found)))
    assert len(read_collection(folder)) == 3


def test_an_interrupted_run_resumes_with_what_is_missing(folder, tmp_path, monkeypatch):
    worker._kept.clear()  # what the tests before have in memory
    engines = []

    def engine(*arguments):
        engines.append(InlineEngine(*arguments))
        return engines[-1]

    monkeypatch.setattr("sfmkit.ablation.engine_choice.LocalEngine", engine)

    def stop_after_the_first_pair(state):
        if state.stage == "pairs" and state.done:
            raise KeyboardInterrupt

    common = {"intrinsics": K, "operators": ("orb",)}
    cache = tmp_path / "cache"
    workshop = Workshop.of(cache, workers=1, progress=stop_after_the_first_pair)
    with pytest.raises(KeyboardInterrupt):
        match_folder(folder, **common, workshop=workshop)
    found = match_folder(folder, **common, workshop=Workshop.of(cache, workers=1))
    before, after = ([t.key for t, _ in e.done] for e in engines)
    assert len(found) == 3
    assert before
    assert not set(before) & set(after)
    assert len(before) + len(after) == 3 + 3  # detections and pairs
