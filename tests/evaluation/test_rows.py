"""Rows on disk: complete ones are kept, damaged files are refused."""

from __future__ import annotations

import random

import pytest

from sfmkit.errors import InputError
from sfmkit.evaluation.rows import RowStore, read_rows

ROWS = [{"pair": "1-2", "error": 1.5}, {"pair": "1-3", "error": None}]


def test_an_incomplete_last_line_is_removed(tmp_path):
    store = RowStore(tmp_path / "rows.jsonl", {"seeds": 2})
    assert store.read() == []
    store.append(ROWS)
    with store.path.open("ab") as file:
        file.write(b'{"pair": "1-')
    assert store.read() == ROWS
    store.append(ROWS[:1])
    assert read_rows(store.path) == ({"seeds": 2}, [*ROWS, ROWS[0]])
    with pytest.raises(InputError, match=r"made with .*2.*, not .*3"):
        RowStore(store.path, {"seeds": 3}).read()


@pytest.mark.parametrize(
    "data",
    [b"", b"\n", b"\xff\xfe\0\n", b"[]\n", b'{"settings": 3}\n', b"[" * 10**5 + b"\n", b"3\n"],
)
def test_other_files_are_refused(tmp_path, data):
    (tmp_path / "rows.jsonl").write_bytes(data)
    with pytest.raises(InputError, match=r"damaged|start"):
        read_rows(tmp_path / "rows.jsonl")


def test_damaged_bytes_are_rows_or_an_input_error(tmp_path):
    store = RowStore(tmp_path / "rows.jsonl", {"seeds": 2})
    store.read()
    store.append(ROWS)
    good, rng = store.path.read_bytes(), random.Random(0)
    for _ in range(300):
        data = bytearray(good)
        for _ in range(rng.randint(1, 3)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        store.path.write_bytes(data[: rng.randint(0, len(data))])
        try:
            _, rows = read_rows(store.path)
        except InputError:
            continue
        assert all(isinstance(row, dict) for row in rows)


def test_the_rows_of_shards_are_read_in_order_and_each_writes_its_own_file(tmp_path):
    settings = {"seeds": 2}
    for number in (10, 2, 1):
        store = RowStore(tmp_path / "rows.jsonl", settings, (number, 10))
        store.read()
        store.append([{"pair": f"1-{number}"}])
    with (tmp_path / "rows.2-of-10.jsonl").open("ab") as file:
        file.write(b'{"pair": "1-')  # a shard that is writing
    whole = RowStore(tmp_path / "rows.jsonl", settings)
    assert whole.read() == [{"pair": "1-1"}, {"pair": "1-2"}, {"pair": "1-10"}]
    assert (tmp_path / "rows.2-of-10.jsonl").read_bytes().endswith(b"1-")
    assert len(RowStore(tmp_path / "rows.jsonl", settings, (2, 10)).read()) == 3
    assert (tmp_path / "rows.2-of-10.jsonl").read_bytes().endswith(b"\n")
    with pytest.raises(InputError, match="made with"):
        RowStore(tmp_path / "rows.jsonl", {"seeds": 3}, (3, 10)).read()
