"""The agenda: everything once, after what it needs, and failures take along only what needs
them."""

from __future__ import annotations

import random

import pytest
from small_sweep import OPERATORS, pairs

from sfmkit.ablation.plan import Plan, make_plan
from sfmkit.ablation.scheduling import Agenda, all_needs
from sfmkit.ablation.tasks import DetectTask, EstimateTask, MatchTask


@pytest.fixture
def plan(tmp_path) -> Plan:
    return make_plan(pairs(tmp_path), OPERATORS)


def carry_out(plan: Plan, agenda: Agenda, fails=lambda task: "", seed: int = 0) -> list:
    """Do everything that is asked for, several at once and in any order."""
    for number, unit in enumerate(plan.units):
        agenda.want(unit, number)
    order, running, rng = [], [], random.Random(seed)
    while len(agenda) or running:
        while len(agenda) and len(running) < 3:
            task = agenda.pop()
            done = {t.key for t in order}
            assert all(
                key in done or agenda.is_there(need) or key in agenda.failed
                for key, need in all_needs(task).items()
            )
            running.append(task)
        task = running.pop(rng.randrange(len(running)))
        order.append(task)
        agenda.finished(task, fails(task))
    return order


@pytest.mark.parametrize("seed", range(3))
def test_everything_is_done_once_and_after_what_it_needs(plan, seed):
    order = carry_out(plan, Agenda(lambda t: False, lambda t, r: None), seed=seed)
    keys = [t.key for t in order]
    assert len(set(keys)) == len(keys) == 12 + 9 + len(plan.units)


def test_what_is_there_is_not_done_again(plan):
    order = carry_out(plan, Agenda(lambda t: isinstance(t, DetectTask), lambda t, r: None))
    assert not any(isinstance(t, DetectTask) for t in order)
    assert sum(isinstance(t, MatchTask) for t in order) == 9


def test_features_that_were_evicted_are_made_again_though_the_matches_are_there(plan):
    order = carry_out(plan, Agenda(lambda t: isinstance(t, MatchTask), lambda t, r: None))
    assert sum(isinstance(t, DetectTask) for t in order) == 12


def test_a_failure_takes_along_what_needs_it_and_nothing_else(plan):
    gone: dict[int, dict[str, str]] = {}
    bad = next(
        d
        for d in plan.detections.values()
        if d.setting.operator == "akaze" and d.image.path.endswith("img3.png")
    )

    def give_up(task: EstimateTask, reasons: dict[str, str]) -> None:
        gone[task.pair] = reasons

    order = carry_out(
        plan, Agenda(lambda t: False, give_up), lambda t: "broken" if t.key == bad.key else ""
    )
    assert gone == {1: {"akaze": "broken"}}
    assert not any(isinstance(t, MatchTask) and bad in t.needs for t in order)
    for task in order:
        if isinstance(task, EstimateTask):
            with_it = [j for j in task.jobs if "akaze" in j.combination]
            assert (len(task.jobs), len(with_it)) == ((3, 0) if task.pair == 1 else (7, 4))


def test_when_all_operators_fail_nothing_is_estimated(plan):
    gone = []
    order = carry_out(
        plan, Agenda(lambda t: False, lambda t, r: gone.append(t.pair)), lambda t: "x"
    )
    assert all(isinstance(t, DetectTask) for t in order)
    assert sorted(gone) == [0, 1, 2]


def test_what_has_vanished_is_made_again_first(plan):
    agenda = Agenda(lambda t: False, lambda t, r: None)
    order = carry_out(plan, agenda)
    unit = plan.units[0]
    lost = [next(iter(unit.matches.values()))]
    agenda._there.discard(unit.key)
    agenda.again(unit, 0, lost)
    assert agenda.pop() == lost[0]
    agenda.finished(lost[0])
    assert agenda.pop().key == unit.key
    assert len(order) == 12 + 9 + len(plan.units)
