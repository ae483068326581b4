"""Grading: correct answers pass, known mistakes are explained, other answers are rejected."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sfmkit.errors import InputError
from sfmkit.geometry.essential import essential_from_pose
from sfmkit.geometry.fundamental import (
    epipolar_lines,
    fundamental_from_pose,
    signed_sampson_distance,
)
from sfmkit.geometry.triangulation import triangulate
from sfmkit.teaching.checking import check, judge
from sfmkit.teaching.exercises import EXERCISES


def answer(exercise, way):
    """The answer that this method gives: a function or a value."""
    return way if exercise.inputs is not None else way()


@pytest.mark.parametrize("name", EXERCISES)
def test_the_correct_answer_passes_and_known_mistakes_are_explained(name):
    exercise = EXERCISES[name]
    assert judge(name, answer(exercise, exercise.right)).right
    assert exercise.wrong
    for way, why in exercise.wrong:
        judgement = judge(name, answer(exercise, way))
        assert not judgement.right
        assert judgement.message == why


@pytest.mark.parametrize("name", EXERCISES)
def test_other_answers_are_rejected(name):
    for nonsense in (
        ...,
        None,
        "nonsense",
        [1, 2],
        float("nan"),
        lambda *_: ...,
        lambda *_: np.zeros(3),
    ):
        judgement = judge(name, nonsense)
        assert not judgement.right
        assert judgement.message


def test_an_unanswered_exercise_prints_its_question(capsys):
    check("04.4", ...)
    assert "degrees of freedom" in capsys.readouterr().out


def test_an_exception_is_reported_with_the_shapes_of_the_arguments():
    judgement = judge("04.1", lambda F, x: F @ x)
    assert "raised ValueError" in judgement.message
    assert "(3, 3), (2,)" in judgement.message


def test_tensors_are_accepted_and_homogeneous_answers_are_compared_up_to_scale():
    def line(F, x):
        return -7 * epipolar_lines(torch.as_tensor(F), torch.as_tensor(x)[None])[0]

    assert judge("04.1", line).right


def test_the_message_contains_the_number_of_correct_inputs():
    def sometimes(A, k):
        right = EXERCISES["01.2"].right(A, k)
        return right if right > 0 else right + 1

    signs = [EXERCISES["01.2"].right(*arguments) > 0 for arguments in EXERCISES["01.2"].inputs()]
    assert 0 < sum(signs) < len(signs)
    assert f"{sum(signs)} of {len(signs)} inputs" in judge("01.2", sometimes).message


def test_the_reference_answers_agree_with_the_library():
    R, t = (torch.as_tensor(a) for a in EXERCISES["05.1"].inputs()[0])
    for _, K1, K2 in EXERCISES["04.3"].inputs():
        F = fundamental_from_pose(R, t, torch.as_tensor(K1), torch.as_tensor(K2)).numpy()
        np.testing.assert_allclose(
            EXERCISES["04.3"].right(F, K1, K2), essential_from_pose(R, t), atol=1e-9
        )
    for R, t in EXERCISES["05.2"].inputs():
        np.testing.assert_allclose(
            EXERCISES["05.2"].right(R, t),
            essential_from_pose(*map(torch.as_tensor, (R, t))),
            atol=1e-12,
        )
    for c1, d1, c2, d2 in EXERCISES["06.3"].inputs():
        xn1, xn2 = (torch.as_tensor(d[:2] / d[2])[None] for d in (d1, d2))
        X = triangulate(
            xn1, xn2, torch.eye(3, dtype=torch.float64), torch.as_tensor(c1 - c2), method="midpoint"
        )
        np.testing.assert_allclose(EXERCISES["06.3"].right(c1, d1, c2, d2), X[0], rtol=1e-9)


def test_an_unknown_exercise_raises_an_input_error():
    with pytest.raises(InputError, match=r"no exercise '04.11'.*Did you mean '04.1'"):
        check("04.11", 3)


def test_an_orientation_may_differ_by_full_turns():
    def plus_a_turn(patch):
        return EXERCISES["01.4"].right(patch) + 2 * np.pi

    def minus_half_a_turn(patch):
        return EXERCISES["01.4"].right(patch) - np.pi

    assert judge("01.4", plus_a_turn).right
    assert not judge("01.4", minus_half_a_turn).right


def test_the_sampson_exercise_agrees_with_the_library():
    for F, x1, x2 in EXERCISES["10.4"].inputs():
        expected = signed_sampson_distance(*map(torch.as_tensor, (F, x1[None], x2[None])))
        assert EXERCISES["10.4"].right(F, x1, x2) == pytest.approx(abs(float(expected)), rel=1e-9)
