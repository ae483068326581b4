"""The report of an ablation: scores, answers in words, tables, plots, and the page in a real
browser."""

from __future__ import annotations

import csv
import io
import json
import random
import re
import shutil
import subprocess

import numpy as np
import pytest
from chromium import open_browser
from click.testing import CliRunner
from made_up_sweep import OPERATORS, made_up_rows, made_up_sweep

from sfmkit.ablation.report.contributions import contributions
from sfmkit.ablation.report.findings import analyse, answers, overall
from sfmkit.ablation.report.page import Section, ablation_page
from sfmkit.ablation.report.scores import score
from sfmkit.ablation.report.tables import tables
from sfmkit.ablation.report.write import write_report
from sfmkit.cli import main
from sfmkit.errors import InputError
from sfmkit.metrics import error_auc
from sfmkit.reports.latex import escape, latex_table
from sfmkit.reports.result import Column, ResultTable, read_result


@pytest.fixture(scope="module")
def rows():
    return made_up_rows()


@pytest.fixture(scope="module")
def findings(rows):
    return analyse(score(rows).blocks[0])


@pytest.fixture(scope="module")
def report(tmp_path_factory, rows):
    poses = made_up_rows(dataset="strecha <10>", pairs=10, unit="deg", gain=0.3, seed=2)
    return write_report(made_up_sweep(tmp_path_factory.mktemp("sweep") / "out", rows + poses))


def test_scores_are_those_of_all_pairs_and_seeds_and_failures_count(rows, findings):
    s = findings.scores
    assert s.errors.shape == (20, 7, 3)
    for c, setup in enumerate(s.setups):
        errors = [r["error"] for r in rows if tuple(r["operators"]) == setup.operators]
        expected = error_auc(errors, s.measure.thresholds)
        np.testing.assert_allclose(
            [findings.auc[t].value[c] for t in s.measure.thresholds], expected
        )
        assert findings.mean.value[c] == pytest.approx(np.mean(np.minimum(errors, 100)))
        assert findings.median.value[c] == pytest.approx(np.median(errors))
        assert s.failures[c] == (6 if setup.operators == ("orb",) else 0)


def test_the_threshold_is_chosen_and_a_saturated_one_is_said(rows):
    (block,) = score(rows, threshold_px=0.4).blocks
    assert block.measure.thresholds == (0.4, 1, 3, 5, 10)
    c = block.labels.index("surf")
    errors = [r["error"] for r in rows if r["operators"] == ["surf"]]
    expected = np.mean(np.clip(1 - np.array(errors) / 0.4, 0, None))
    assert block.quality[:, c].mean() == pytest.approx(expected)
    assert "area under the curve up to 0.4 px" in " ".join(answers(analyse(block)))
    for bad in (0, 100, float("nan")):
        with pytest.raises(InputError, match="threshold must be above 0"):
            score(rows, threshold_px=bad)
    easy = [r | {"error": r["error"] / 1000} for r in rows if r["operators"] != ["orb"]]
    text = " ".join(answers(analyse(score(easy).blocks[0])))
    assert "(--threshold-px) separates them better" in text


def test_the_table_of_scenes_has_the_mean_of_their_pairs(findings):
    (table,) = [t for t in tables(findings) if t.name == "oxford-scenes"]
    heads = [c.name for c in table.columns]
    assert [row[0] for row in table.rows] == [f"scene{k}" for k in range(4)]
    s = findings.scores
    for k, row in enumerate(table.rows):
        mine = s.quality[5 * k : 5 * k + 5]
        assert row[1] == 5
        assert row[heads.index("its AUC")] == pytest.approx(mine.mean(0).max())
        assert row[heads.index("surf")] == pytest.approx(mine[:, s.labels.index("surf")].mean())


def test_every_cell_of_a_csv_file_is_a_number_or_a_text_under_a_unique_head(report):
    for file in report.page.parent.glob("*.csv"):
        head, *lines = csv.reader(io.StringIO(file.read_text()))
        assert len(set(head)) == len(head), file
        assert not any(re.search(r"\d to [\d-]", cell) for line in lines for cell in line), file
    lines = csv.DictReader(io.StringIO((report.page.parent / "oxford-setups.csv").read_text()))
    for line in lines:
        low, high = (float(line[f"95 % of AUC 5 px, {end}"]) for end in ("low", "high"))
        assert low <= float(line["AUC 5 px"]) <= high


def test_shards_and_other_sweeps_make_one_report(tmp_path, rows):
    poses = made_up_rows(dataset="strecha", pairs=10, unit="deg", seed=2)
    parts = {"1": rows[:210], "2": rows[210:], "3": poses}
    folders = [str(made_up_sweep(tmp_path / name, part)) for name, part in parts.items()]

    def run(*arguments):
        return CliRunner().invoke(main, ["ablate", "report", *arguments, "--quiet"])

    done = run(*folders)
    assert done.exit_code == 2
    assert "--out FOLDER" in done.output
    done = run(*folders, "--out", str(tmp_path / "all"))
    assert done.exit_code == 0, done.output
    whole = write_report(made_up_sweep(tmp_path / "whole", rows + poses))
    for file in whole.page.parent.glob("*.csv"):
        assert (tmp_path / "all" / file.name).read_text() == file.read_text()
    assert "is there twice" in run(*folders, folders[0], "--out", str(tmp_path / "x")).output


def test_the_order_of_the_rows_does_not_matter(rows):
    shuffled = random.Random(0).sample(rows, len(rows))
    first, second = (analyse(score(r).blocks[0]) for r in (rows, shuffled))
    assert answers(first) == answers(second)
    assert [t.csv() for t in tables(first)] == [t.csv() for t in tables(second)]


def test_runs_that_broke_are_the_worst_and_rows_without_a_truth_are_said(rows):
    broken = [dict(r) for r in rows]
    for r in broken:
        if r["operators"] == ["surf"] and r["sequence"] == "scene0":
            r |= {"error": None, "status": "failed", "seconds": None}
    broken += [r | {"dataset": "uav", "has_truth": False, "error": None} for r in rows[:21]]
    ablation = score(broken)
    assert ablation.without_truth == {"uav": 21}
    (block,) = ablation.blocks
    surf = [s.operators for s in block.setups].index(("surf",))
    assert block.failures[surf] == 15 == block.broken[:, surf].sum()
    assert block.quality[:5, surf].tolist() == [0] * 5
    findings = analyse(block)
    assert np.isfinite(findings.seconds.value).all()  # of the pairs that all have a time for
    assert any("15 of all 420 runs failed" in a for a in answers(findings))


def test_incomplete_and_truthless_sweeps_are_refused_with_what_to_do(rows):
    with pytest.raises(
        InputError, match=r"1 of 420 rows are missing, e.g. scene0 1-2, surf, seed 0; finish"
    ):
        score(rows[1:])
    with pytest.raises(InputError, match="is there twice"):
        score([*rows, rows[0]])
    with pytest.raises(InputError, match="no row of this sweep has a true geometry"):
        score([r | {"has_truth": False} for r in rows])


def test_the_best_is_found_and_so_are_its_differences(findings):
    assert findings.scores.label(findings.best) == "surf/orb/fast-brief"
    assert all(d.real and d.value > 0 for d in findings.questions)
    assert len(findings.questions) == 4  # the runner-up and three operators alone
    text = " ".join(answers(findings))
    assert "Best: surf/orb/fast-brief" in text
    assert "the difference is real" in text
    assert "It is better than every other of the 7 setups." in text
    assert "Does fusing help? All 3 operators together reach" in text
    assert findings.scores.label(findings.fusion.second) == "surf"
    (c,) = findings.contributions
    assert c.operators[int(np.argmax(c.shapley.value))] == "surf"
    everything = findings.scores.quality[:, findings.best].mean()
    assert c.shapley.value.sum() == pytest.approx(everything)
    assert (c.without.value > 0).all()


def test_equal_setups_are_not_called_different_and_the_faster_one_is_named():
    rng = np.random.default_rng(0)
    rows = made_up_rows(("surf", "orb"), fails=("none",))
    hard = {p: rng.gamma(2, 0.5) for p in {(r["sequence"], r["pair"]) for r in rows}}
    for r in rows:
        r["error"] = hard[r["sequence"], r["pair"]] + rng.normal(0, 0.01) ** 2
        r["seconds"] = 0.3 if r["operators"] == ["orb"] else 2.0
    text = " ".join(answers(analyse(score(rows).blocks[0])))
    assert "not shown to be real" in text
    assert "2 of the other 2 setups are not shown to be worse" in text
    assert (
        "orb: 0.30 s a pair where the best takes 2.00 s" in text or "None of them is faster" in text
    )


def test_few_pairs_are_said_to_be_few():
    f = analyse(score(made_up_rows(pairs=4)).blocks[0])
    assert any("so few independent pairs (4)" in a for a in answers(f))
    assert any("however large" in a for a in answers(f))
    one = analyse(score(made_up_rows(pairs=1)).blocks[0])
    assert "nan" not in " ".join(answers(one))
    assert "nan" not in "".join(t.markdown() for t in tables(one))


def test_changed_settings_make_other_setups_and_what_they_do_not_concern_is_shared():
    rows = made_up_rows(("surf", "orb"))
    varied = []
    for r in rows:
        if "surf" in r["operators"]:
            varied += [r | {"vary": json.dumps({"surf.hessian_threshold": v})} for v in (30, 400)]
        else:
            varied.append(r)
    block = score(varied).blocks[0]
    assert len(block.setups) == 5
    assert block.label(0) == "orb (default)" or "hessian_threshold" in block.label(0)
    both = contributions(block)
    assert [c.variant for c in both] == [
        "default, surf.hessian_threshold 30",
        "default, surf.hessian_threshold 400",
    ]
    plain = contributions(score(rows).blocks[0])[0]
    for c in both:
        assert c.missing == ""
        np.testing.assert_allclose(c.shapley.value, plain.shapley.value)
    assert len({t.name for t in tables(analyse(block))}) == len(tables(analyse(block)))


def test_missing_combinations_cost_the_shapley_values_only():
    rows = [r for r in made_up_rows() if r["n_operators"] != 2]
    (c,) = contributions(score(rows).blocks[0])
    assert c.shapley is None
    assert c.alone is not None
    assert re.search(
        "3 of 7 are not in this sweep, e.g. surf/orb: run it with --combos all", c.missing
    )


def test_all_data_sets_are_ranked_together(rows):
    both = score(rows + made_up_rows(dataset="strecha", unit="deg", pairs=10))
    labels, ranking = overall(both)
    assert (ranking.blocks, ranking.unit) == (30, "pair")
    assert labels[ranking.order[0]] == "surf/orb/fast-brief"
    assert overall(score(rows)) is None


def test_latex_is_escaped():
    assert escape("a_b & 5% {x} ~ ^ \\ #1 $2 <3>") == (
        r"a\_b \& 5\% \{x\} \textasciitilde{} \textasciicircum{} \textbackslash{} \#1 \$2 "
        r"\textless{}3\textgreater{}"
    )
    t = ResultTable(
        "a-b",
        "50 % of_it",
        (Column("x_1"), Column("−", ".1f")),
        (("a&b", -1.25), (None, None)),
        "n_1",
    )
    text = latex_table(t)
    assert r"\begin{tabular}{lr}" in text
    assert r"a\&b & $-$1.2 \\" in text
    assert r"\caption{50 \% of\_it. n\_1}" in text
    assert all(rule in text for rule in (r"\toprule", r"\midrule", r"\bottomrule"))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no pdflatex")
def test_latex_compiles(findings, tmp_path):
    body = "\n".join(latex_table(t) for t in tables(findings))
    (tmp_path / "t.tex").write_text(
        "\\documentclass{article}\\usepackage[T1]{fontenc}\\usepackage{textcomp,booktabs}\\begin{document}"
        + body
        + "\\end{document}"
    )
    subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"],
        cwd=tmp_path,
        check=True,
    )


def test_the_report_is_whole_and_reads_back(report):
    names = {f.name for f in report.files}
    result = read_result(report.page.parent)
    for t in result.tables:
        assert {f"{t.name}.csv", f"{t.name}.md", f"{t.name}.tex"} <= names
        lines = list(csv.reader(io.StringIO((report.page.parent / f"{t.name}.csv").read_text())))
        assert len(lines) == len(t.rows) + 1
    html = report.page.read_text()
    assert not re.search(r"(?:src|href)=\"(?!data:|#)", html)  # nothing is fetched
    assert "strecha &lt;10&gt;" in html
    assert "strecha <10>" not in html
    assert html.index("The answers") < html.index("<table")


def test_the_command_prints_the_answers_and_refuses_other_folders(tmp_path):
    folder = made_up_sweep(tmp_path / "out", made_up_rows(("surf", "orb"), pairs=9))
    for _ in range(2):  # a report replaces the one before
        done = CliRunner().invoke(main, ["ablate", "report", str(folder)])
        assert done.exit_code == 0, done.output
    assert "Best: surf/orb" in done.output
    assert (folder / "report" / "report.html").is_file()
    for arguments in ([str(tmp_path)], [str(folder), "--of", "surf"]):
        failed = CliRunner().invoke(main, ["ablate", "report", *arguments])
        assert failed.exit_code == 2
        assert "Traceback" not in failed.output


def test_text_on_the_page_cannot_break_out(tmp_path):
    evil = "<script>alert(1)</script>\"'&"
    t = ResultTable("t", evil, (Column(evil),), ((evil,),), evil)
    html = ablation_page(evil, evil, [Section(evil, (evil,), (t,))], [evil], {evil: evil}, tmp_path)
    assert html.count("<script>") == 1
    assert "alert(1)</script>" not in html


@pytest.mark.browser
def test_a_click_on_a_head_sorts_the_table(report, tmp_path):
    with open_browser() as browser:
        window = browser.new_page(viewport={"width": 1280, "height": 900})
        asked, said = [], []
        window.on("request", lambda r: asked.append(r.url))
        window.on("console", lambda m: said.append(m.text))
        window.on("pageerror", lambda e: said.append(str(e)))
        window.goto(report.page.as_uri())
        table = window.locator("#oxford-setups")
        heads = table.locator("th").all_inner_texts()

        def column(name):
            k = next(i for i, h in enumerate(heads) if h.startswith(name))
            cells = table.locator(f"tbody td:nth-child({k + 1})").all_inner_texts()
            return table.locator("th").nth(k), cells

        names = column("setup")[1]
        assert names[0] == "surf/orb/fast-brief"
        for name in ("s per pair", "AUC 5 px", "no answer", "95 % of median"):
            head, _ = column(name)
            head.get_by_role("button").click()
            assert head.get_attribute("aria-sort") == "descending"
            values = [float(re.match(r"[-\d.]+", c)[0]) for c in column(name)[1]]
            assert values == sorted(values, reverse=True)
            assert sorted(column("setup")[1]) == sorted(names)
        head, _ = column("setup")
        head.get_by_role("button").focus()
        window.keyboard.press("Enter")
        assert head.get_attribute("aria-sort") == "ascending"
        assert column("setup")[1] == sorted(names)
        assert table.locator("th[aria-sort=ascending], th[aria-sort=descending]").count() == 1
        window.keyboard.press("Enter")
        assert column("setup")[1] == sorted(names, reverse=True)
        head, cells = column("on the front")  # empty cells stay last, whichever way
        for _ in range(2):
            head.get_by_role("button").click()
            cells = column("on the front")[1]
            assert cells == sorted(cells, reverse=True)
        for width in (1280, 400):
            window.set_viewport_size({"width": width, "height": 900})
            assert (
                window.evaluate("document.documentElement.scrollWidth") == width
            )  # the page never scrolls sideways
            window.screenshot(path=tmp_path / f"{width}.png")
        window.emulate_media(media="print")
        window.evaluate("dispatchEvent(new Event('beforeprint'))")
        assert window.evaluate("[...document.querySelectorAll('details')].every(d => d.open)")
        assert not said
        assert asked == [report.page.as_uri()]


def test_all_operators_of_a_large_sweep(tmp_path):
    rows = made_up_rows(OPERATORS[:4], pairs=8, seeds=1)
    random.Random(1).shuffle(rows)
    f = analyse(score(rows).blocks[0])
    assert f.scores.operators == OPERATORS[:4]
    assert len(f.every) == 15 * 14 // 2
