"""What a benchmark hands over: written, read back, and refused where it is damaged."""

from __future__ import annotations

import csv
import json

import pytest
from PIL import Image

from sfmkit.errors import InputError
from sfmkit.reports.result import (
    Column,
    Result,
    ResultFigure,
    ResultTable,
    read_result,
    write_result,
)

COLUMNS = (
    Column("operator"),
    Column("points", ","),
    Column("loss, %", "+.1f"),
    Column("paper", ".2f", paper=True),
)


def made_up(rows=(("surf", 12_670, -1.25, 24.89), ("a|b", None, float("nan"), "none"))) -> Result:
    table = ResultTable("table-6", "Table 6", COLUMNS, tuple(rows), "A note.")
    figure = ResultFigure("Figure 11", "cloud.png", "four clouds")
    return Result(
        "fountain",
        "Fountain",
        "sfmkit bench fountain",
        (table,),
        (figure,),
        (0, 1),
        ("Mind the gap.",),
    )


@pytest.fixture
def folder(tmp_path):
    Image.new("RGB", (4, 3)).save(tmp_path / "cloud.png")
    return tmp_path


def test_what_is_written_is_read_back(folder):
    result = made_up()
    write_result(folder, result)
    again = read_result(folder)
    assert again.tables[0].shown() == [["surf", "12,670", "−1.2", "24.89"], ["a|b", "", "", "none"]]
    assert again.tables[0].columns == COLUMNS
    for name in ("name", "title", "command", "figures", "seeds", "notes", "machine", "versions"):
        assert getattr(again, name) == getattr(result, name), name
    assert {"processor", "cores"} <= again.machine.keys()
    assert {"sfmkit", "torch"} <= again.versions.keys()


def test_tables_are_csv_and_markdown_too(folder):
    write_result(folder, made_up())
    rows = list(csv.reader((folder / "table-6.csv").open()))
    assert rows[:2] == [
        ["operator", "points", "loss, %", "paper"],
        ["surf", "12670", "-1.25", "24.89"],
    ]
    lines = (folder / "table-6.md").read_text().splitlines()
    assert lines[2:6] == [
        "| operator | points | loss, % | paper |",
        "| :-- | --: | --: | --: |",
        "| surf | 12,670 | −1.2 | 24.89 |",
        "| a\\|b |  |  | none |",
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.clear(), "not a result of version 2, but None"),
        (lambda d: d.update(version=1), "version 2, but 1"),
        (lambda d: d.pop("tables"), "damaged"),
        (lambda d: d["tables"][0]["rows"][0].append("more"), "damaged"),
        (lambda d: d["tables"][0]["columns"][0].pop("spec"), "damaged"),
        (lambda d: d["figures"][0].update(file="../../secret.png"), "damaged"),
        (lambda d: d["figures"][0].update(file="gone.png"), "gone.png, which is missing"),
        (lambda d: d.update(machine=[1]), "damaged"),
        (lambda d: d.update(title=7), "damaged"),
    ],
)
def test_a_damaged_result_is_refused(folder, change, message):
    write_result(folder, made_up())
    file = folder / "result.json"
    data = json.loads(file.read_text())
    change(data)
    file.write_text(json.dumps(data))
    with pytest.raises(InputError, match=message):
        read_result(folder)


def test_no_result_and_no_json(tmp_path):
    with pytest.raises(InputError, match=r"holds no result\.json"):
        read_result(tmp_path)
    (tmp_path / "result.json").write_bytes(b"\xff{")
    with pytest.raises(InputError, match="cannot be read"):
        read_result(tmp_path)


def test_tables_and_figures_that_cannot_be(folder):
    with pytest.raises(InputError, match="a row of 3 cells"):
        made_up([("a", 1, 2.0)])
    with pytest.raises(InputError, match="neither text nor a number"):
        made_up([("a", [1], 2.0, 3.0)])
    with pytest.raises(InputError, match="small letters"):
        ResultTable("../x", "", COLUMNS, ())
    with pytest.raises(InputError, match="one name"):
        Result("a", "", "", made_up().tables * 2)
    (folder / "cloud.png").unlink()
    with pytest.raises(InputError, match="was not drawn"):
        write_result(folder, made_up())
    assert not (folder / "result.json").exists()
