"""Fusion compared with a sequential implementation of its rule, and its properties."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sfmkit.errors import InputError
from sfmkit.matching.fusion import fuse
from sfmkit.types import Correspondences, Features, Matches

SIZE = (3000, 2000)


def operator(x1, x2, ratio=None, name="test", size_wh=SIZE) -> tuple[Features, Features, Matches]:
    """Return features and matches in which row k of `x1` is matched to row k of `x2`."""
    x1, x2 = (np.asarray(x, np.float32).reshape(-1, 2) for x in (x1, x2))
    n = len(x1)
    ratio = np.full(n, np.nan, np.float32) if ratio is None else np.asarray(ratio, np.float32)
    zeros = np.zeros(n, np.float32)

    def side(x):
        return Features(x, zeros, zeros, zeros, np.zeros((n, 4), np.float32), "l2", name, size_wh)

    return (
        side(x1),
        side(x2),
        Matches(np.arange(n), np.arange(n), np.arange(n, dtype=np.float32), ratio),
    )


def rows(matches):
    """Return every input correspondence: position (4,), ratio, name of the operator, row."""
    return [
        (np.r_[f1.keypoints[i], f2.keypoints[j]].astype(np.float64), float(r), name, int(i), int(j))
        for name, (f1, f2, m) in matches.items()
        for i, j, r in zip(m.index1, m.index2, m.ratio)
    ]


def coincide(p, q, radius):
    d = p - q
    return max(d[0] ** 2 + d[1] ** 2, d[2] ** 2 + d[3] ** 2) <= radius**2


def sequential(matches, radius):
    """Return {(operator, row): operators that it represents} by a sequential search.

    In the order of quality, each match absorbs those that coincide with it and are still free.
    """
    items = sorted(
        rows(matches), key=lambda r: (np.isnan(r[1]), 0 if np.isnan(r[1]) else r[1], *r[2:])
    )
    kept, taken = {}, set()
    for a, (p, _, name, i, _) in enumerate(items):
        if a in taken:
            continue
        kept[name, i] = {name}
        for b in range(a + 1, len(items)):
            if b not in taken and coincide(p, items[b][0], radius):
                taken.add(b)
                kept[name, i].add(items[b][2])
    return kept


def found_by(c: Correspondences):
    return {
        (c.operators[o], i): {name for k, name in enumerate(c.operators) if mask >> k & 1}
        for o, i, mask in zip(c.operator_id.tolist(), c.index1.tolist(), c.operator_mask.tolist())
    }


@st.composite
def crowded(draw):
    """Draw one to four operators on a small patch with a coarse grid.

    Coincidences, equal ratios and chains are therefore frequent.
    """
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    extent, step = draw(st.sampled_from([3, 8, 20])), draw(st.sampled_from([1.0, 0.25, 1e-3]))
    matches = {}
    for name in draw(st.permutations(["orb", "surf", "fast", "akaze"]))[: draw(st.integers(1, 4))]:
        n = draw(st.integers(0, 25))
        x1 = np.round(rng.uniform(0, extent, (n, 2)) / step) * step
        x2 = x1 + rng.choice([0, 0, 0, 0.5, 5], (n, 1))
        ratio = rng.choice([0.2, 0.5, 0.5, 0.9, np.nan], n)
        matches[name] = operator(x1, x2, ratio, name)
    return matches, draw(st.sampled_from([0.0, 0.5, 1.0, 1.5, 4.0]))


@settings(max_examples=200, deadline=None)
@given(crowded())
def test_fusion_agrees_with_the_sequential_rule(case):
    matches, radius = case
    assert found_by(fuse(matches, merge_radius=radius)) == sequential(matches, radius)


@settings(max_examples=100, deadline=None)
@given(crowded())
def test_fusion_has_its_documented_properties(case):
    matches, radius = case
    c = fuse(matches, merge_radius=radius)
    kept = torch.hstack([c.x1, c.x2]).numpy()
    for p, q in itertools.combinations(kept, 2):
        assert not coincide(p, q, radius), "two that are kept coincide"
    represented = dict.fromkeys(matches, 0)
    for p, _, name, *_ in rows(matches):
        bit = 1 << c.operators.index(name)
        near = [int(m) for q, m in zip(kept, c.operator_mask) if coincide(p, q, radius)]
        assert any(m & bit for m in near), (
            "a match is not represented within the radius by one that remembers its operator"
        )
        represented[name] += 1
    for k, name in enumerate(c.operators):
        count = c.counts[name]
        f1, f2, m = matches[name]
        assert count.keypoints == (len(f1), len(f2))
        assert count.matches == len(m) == represented[name]
        assert count.matches - count.merged == int((c.operator_id == k).sum())
    for k, name in enumerate(c.operators):
        mine = (c.operator_id == k).numpy()
        i, j = c.index1.numpy()[mine], c.index2.numpy()[mine]
        f1, f2, m = matches[name]
        np.testing.assert_array_equal(c.x1.numpy()[mine], f1.keypoints[i])
        np.testing.assert_array_equal(c.x2.numpy()[mine], f2.keypoints[j])
        np.testing.assert_array_equal(
            c.distance.numpy()[mine], m.distance[i]
        )  # match k joins rows k
        np.testing.assert_array_equal(c.ratio.numpy()[mine], m.ratio[i])


@settings(max_examples=60, deadline=None)
@given(crowded(), st.randoms(use_true_random=False))
def test_the_order_of_the_operators_does_not_matter(case, random):
    matches, radius = case
    names = list(matches)
    random.shuffle(names)
    shuffled = fuse({name: matches[name] for name in names}, merge_radius=radius)
    assert shuffled.operators == tuple(names)
    assert found_by(shuffled) == found_by(fuse(matches, merge_radius=radius))


@settings(max_examples=60, deadline=None)
@given(crowded())
def test_fusing_again_changes_nothing(case):
    matches, radius = case
    c = fuse(matches, merge_radius=radius)
    again = {}
    for k, name in enumerate(c.operators):
        mine = c.operator_id == k
        again[name] = operator(c.x1[mine], c.x2[mine], c.ratio[mine], name)
    d = fuse(again, merge_radius=radius)
    np.testing.assert_array_equal(d.x1, c.x1)
    np.testing.assert_array_equal(d.x2, c.x2)
    assert all(count.merged == 0 for count in d.counts.values())


@settings(max_examples=30, deadline=None)
@given(crowded())
def test_without_a_radius_it_concatenates(case):
    matches, _ = case
    c = fuse(matches, merge_radius=None)
    items = rows(matches)
    assert len(c) == len(items)
    np.testing.assert_array_equal(
        torch.hstack([c.x1, c.x2]), np.array([p for p, *_ in items]).reshape(-1, 4)
    )
    assert [c.operators[k] for k in c.operator_id] == [name for _, _, name, *_ in items]
    assert (c.operator_mask == 1 << c.operator_id).all()
    assert all(count.merged == 0 for count in c.counts.values())


def test_the_most_distinctive_is_kept():
    matches = {
        "surf": operator([[10, 10]], [[20, 20]], [0.8]),
        "orb": operator([[10.5, 10]], [[20, 20.5]], [0.3]),
        "fast": operator([[10, 10.4]], [[20, 20]]),
    }
    c = fuse(matches)
    assert c.x1.tolist() == [[10.5, 10.0]]
    assert (c.operator_id.tolist(), c.operator_mask.tolist()) == ([1], [0b111])
    assert [c.counts[name].merged for name in matches] == [1, 0, 1]


def test_the_radius_applies_to_both_images_and_conflicts_are_kept():
    matches = {
        "a": operator([[10, 10], [50, 50]], [[20, 20], [60, 60]], [0.5, 0.5]),
        "b": operator([[10, 10], [51, 50]], [[21.01, 20], [60, 59]], [0.6, 0.6]),
    }
    c = fuse(matches, merge_radius=1.0)
    assert c.operator_mask.tolist() == [0b01, 0b11, 0b10]
    diagonal = {"a": operator([[0, 0]], [[0, 0]]), "b": operator([[0.8, 0.8]], [[0, 0]])}
    assert len(fuse(diagonal, merge_radius=1.0)) == 2, "the radius is Euclidean, not a box"


def test_chains_are_not_merged_into_one():
    """Single linkage would merge twenty points at distances of 0.9 px into one."""
    x = np.c_[np.arange(20) * 0.9, np.zeros(20)]
    c = fuse({"a": operator(x, x, np.linspace(0.1, 0.9, 20))}, merge_radius=1.0)
    np.testing.assert_allclose(c.x1[:, 0], x[::2, 0], rtol=1e-6)


def test_two_levels_of_one_operator_are_one_correspondence():
    c = fuse({"orb": operator([[5, 5], [5.2, 5.1]], [[7, 7], [7.1, 7]], [0.4, 0.2])})
    assert (c.index1.tolist(), c.operator_mask.tolist(), c.counts["orb"].merged) == ([1], [1], 1)


def test_operators_that_found_nothing_keep_their_bit():
    empty = operator(np.zeros((0, 2)), np.zeros((0, 2)))
    c = fuse({"none": empty, "some": operator([[1, 1]], [[2, 2]])})
    assert (c.operators, c.operator_mask.tolist()) == (("none", "some"), [0b10])
    assert len(fuse({"none": empty})) == 0


def test_matches_that_do_not_belong_together_are_rejected():
    one = operator([[1, 1]], [[2, 2]])
    with pytest.raises(InputError, match="nothing to fuse"):
        fuse({})
    with pytest.raises(InputError, match="different sizes"):
        fuse({"a": one, "b": operator([[1, 1]], [[2, 2]], size_wh=(10, 10))})
    with pytest.raises(InputError, match="outside its 1 features"):
        fuse({"a": (*one[:2], Matches(np.array([1]), np.array([0]), np.zeros(1), np.zeros(1)))})
    for radius in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="merge_radius"):
            fuse({"a": one}, merge_radius=radius)
    with pytest.raises(InputError, match="at most 62"):
        fuse({str(k): one for k in range(63)})


def test_fusion_of_fifty_thousand_matches_is_fast():
    rng = np.random.default_rng(0)
    corners = rng.uniform(0, SIZE, (20_000, 2))
    matches = {}
    for name in ("a", "b", "c"):
        x1 = corners[rng.permutation(len(corners))[:17_000]] + rng.normal(0, 0.3, (17_000, 2))
        matches[name] = operator(
            x1, x1 + rng.normal(0, 0.3, x1.shape), rng.uniform(0, 1, len(x1)), name
        )
    taken = []
    for _ in range(3):
        began = time.process_time()
        c = fuse(matches)
        taken.append(time.process_time() - began)
    assert min(taken) < 0.5
    assert 20_000 < len(c) < 40_000
