"""Rows: errors against closed forms, and the columns that the documentation promises."""

from __future__ import annotations

import math
import random
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from sfmkit.ablation.sources import PlannedPair
from sfmkit.ablation.table import VOLATILE, AblationTable, make_row, read_table, table_of
from sfmkit.ablation.table_file import (
    SCHEMA,
    content_digest,
    read_shard,
    write_table,
    write_tables,
)
from sfmkit.ablation.tasks import EstimateTask, ImageRef, Job
from sfmkit.ablation.variants import Variant
from sfmkit.errors import InputError

IMAGES = (ImageRef("aa", "a.png", (640, 480)), ImageRef("bb", "b.png", (640, 480)))
JOB = Job(("surf", "orb"), 7, "key")


def unit(homography: bool) -> EstimateTask:
    return EstimateTask("u", 0, homography, None, Variant("default"), (JOB,), {})


def result(**model) -> dict:
    return {
        "keypoints": [10, 20],
        "matches": 9,
        "correspondences": 8,
        "inliers": 7,
        "guided": None,
        "verdict": "general",
        "reason": "r",
        "H": None,
        "R": None,
        "t": None,
        "peak_mb": 5.0,
        "versions": {"sfmkit": "1"},
        "machine": "m",
        "seconds": {"detect": 1.0, "match": 2.0, "fuse": 0.25, "estimate": 0.5},
        **model,
    }


def test_a_homography_that_shifts_by_3_and_4_pixels_too_much_is_5_pixels_off():
    pair = PlannedPair("d", "s", "1-2", IMAGES, True, H=np.eye(3))
    row = make_row(pair, unit(True), JOB, result(H=[1.0, 0, 3, 0, 1, 4, 0, 0, 1], verdict="planar"))
    assert row["corner_error_px"] == row["error"] == pytest.approx(5)
    assert row["rmse"] == pytest.approx(5 / 3)  # sqrt((9 + 16) / 9)
    assert (row["error_unit"], row["status"], row["combination"], row["seed"]) == (
        "px",
        "ok",
        "surf/orb",
        7,
    )
    assert row["seconds"] == 3.75


def test_a_pose_turned_by_2_degrees_with_a_direction_off_by_3():
    R, t = np.eye(3), np.array([2.0, 0, 0])
    pair = PlannedPair("d", "s", "1-2", IMAGES, False, R=R, t=t)
    turned = Rotation.from_euler("y", 2, degrees=True).as_matrix()
    direction = [math.cos(math.radians(3)), math.sin(math.radians(3)), 0.0]
    row = make_row(pair, unit(False), JOB, result(R=turned.flatten().tolist(), t=direction))
    assert row["rotation_deg"] == pytest.approx(2)
    assert row["translation_deg"] == pytest.approx(3)
    assert row["error"] == row["translation_deg"]
    assert row["error_unit"] == "deg"


def test_no_estimate_is_an_infinite_error_where_the_truth_is_known_and_none_where_it_is_not():
    nothing = result(verdict="too little evidence")
    for homography, truth in ((True, {"H": np.eye(3)}), (False, {"R": np.eye(3), "t": np.ones(3)})):
        row = make_row(
            PlannedPair("d", "s", "p", IMAGES, homography, **truth), unit(homography), JOB, nothing
        )
        assert (row["status"], row["error"]) == ("no estimate", math.inf)
    row = make_row(PlannedPair("d", "s", "p", IMAGES, False), unit(False), JOB, nothing)
    assert (row["has_truth"], row["error"]) == (False, None)


def test_a_camera_that_only_turned_has_no_direction_to_get_wrong():
    pair = PlannedPair("d", "s", "p", IMAGES, False, R=np.eye(3), t=np.zeros(3))
    row = make_row(
        pair, unit(False), JOB, result(R=np.eye(3).flatten().tolist(), verdict="pure rotation")
    )
    assert row["error"] == pytest.approx(0, abs=1e-6)
    assert row["translation_deg"] is None


def test_a_pure_rotation_where_the_camera_moved_has_an_infinite_error():
    pair = PlannedPair("d", "s", "p", IMAGES, False, R=np.eye(3), t=np.ones(3))
    row = make_row(
        pair, unit(False), JOB, result(R=np.eye(3).flatten().tolist(), verdict="pure rotation")
    )
    assert row["error"] == math.inf


def test_a_failed_run_is_a_row_with_its_reason():
    pair = PlannedPair("d", "s", "p", None, True, H=np.eye(3), failure="ImageError: x")
    row = make_row(pair, unit(True), JOB, pair.failure)
    assert (row["status"], row["failure"], row["error"], row["verdict"]) == (
        "failed",
        "ImageError: x",
        None,
        None,
    )


def test_the_table_goes_to_parquet_and_back(tmp_path):
    pair = PlannedPair("d", "s", "1-2", IMAGES, True, H=np.eye(3))
    rows = [
        make_row(pair, unit(True), JOB, r)
        for r in (
            result(H=[1.0, 0, 3, 0, 1, 4, 0, 0, 1]),
            "broke",
            result(verdict="too little evidence"),
        )
    ]
    write_table(table_of(rows), tmp_path / "ablation.parquet")
    table = read_table(tmp_path)
    assert list(table) == rows
    assert table["status"] == ["ok", "failed", "no estimate"]
    assert not set(VOLATILE) & set(table.results().column_names)
    assert pq.read_schema(tmp_path / "ablation.parquet").equals(SCHEMA)
    assert "3 rows" in repr(AblationTable(table.data))


def test_tables_that_are_not_there_or_are_none(tmp_path):
    with pytest.raises(InputError, match="there is no"):
        read_table(tmp_path)
    (tmp_path / "ablation.parquet").write_bytes(b"PAR1 rubbish")
    with pytest.raises(InputError, match="Parquet"):
        read_table(tmp_path)
    with pytest.raises(InputError, match="no column 'errors'"):
        AblationTable(table_of([]))["errors"]


def made_up_table(n: int = 60) -> pa.Table:
    rng = random.Random(1)
    rows = []
    for k in range(n):
        row = dict.fromkeys(SCHEMA.names) | {"pair": str(k), "seed": k, "error": rng.random()}
        H = None if k % 3 == 0 else [rng.random() for _ in range(9)]
        rows.append(row | {"has_truth": k % 2 == 0, "operators": ["orb"] * (k % 3), "H": H})
    return table_of(rows)


def test_no_flip_of_a_single_bit_changes_a_value(tmp_path):
    file, table = tmp_path / "t.parquet", made_up_table()
    write_table(table, file)
    good, rng = file.read_bytes(), random.Random(0)
    for _ in range(400):
        data = bytearray(good)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        file.write_bytes(data)
        try:
            assert read_shard(file) == table
        except InputError:
            continue


def test_a_changed_value_does_not_agree_with_the_digest(tmp_path):
    table = made_up_table()
    column = table.column_names.index("error")
    changed = table.set_column(column, SCHEMA.field("error"), pc.add(table["error"], 1e-9))
    stored = {b"sfmkit.content": content_digest(table)}
    pq.write_table(changed.replace_schema_metadata(stored), tmp_path / "ablation.parquet")
    with pytest.raises(InputError, match="values differ"):
        read_table(tmp_path)


def test_the_digest_does_not_depend_on_the_layout_in_memory():
    table = made_up_table()
    parts = pa.concat_tables([table.slice(0, 7), table.slice(7, 20), table.slice(27)])
    assert parts["H"].num_chunks == 3
    assert content_digest(parts) == content_digest(table)
    assert content_digest(table.slice(1)) != content_digest(table)


def test_parts_are_written_one_after_another_as_row_groups(tmp_path):
    table, file = made_up_table(), tmp_path / "t.parquet"
    parts = (table.slice(start, 25) for start in (0, 25, 50))
    assert write_tables(parts, file) == 60
    assert pq.ParquetFile(file).num_row_groups == 3
    assert read_shard(file) == table


def test_columns_of_other_types_are_refused(tmp_path):
    table = made_up_table()
    other = table.set_column(0, "dataset", pa.array(range(len(table))))
    pq.write_table(other, tmp_path / "ablation.parquet")
    with pytest.raises(InputError, match="other columns"):
        read_table(tmp_path)


def test_every_column_is_documented_and_nothing_else_is():
    page = (Path(__file__).parents[2] / "docs" / "ablation.md").read_text()
    section = page[page.index("## The table") : page.index("## Interruptions")]
    lines = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    named = [name for line in lines for name in re.findall(r"`(\w+)`", line)]
    assert named == SCHEMA.names
