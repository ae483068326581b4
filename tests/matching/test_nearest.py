"""Matching compared with brute force in float64 and with OpenCV's cross-check."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sfmkit.errors import InputError
from sfmkit.features import detect
from sfmkit.matching import nearest as matching
from sfmkit.matching.nearest import match
from sfmkit.types import Features, Matches


def features(descriptors, norm="l2", operator="test", laplacian=None) -> Features:
    n = len(descriptors)
    zeros = np.zeros(n, np.float32)
    xy = np.zeros((n, 2), np.float32)
    return Features(xy, zeros, zeros, zeros, descriptors, norm, operator, (640, 480), laplacian)


def unit(rng, n, d=64):
    x = rng.normal(size=(n, d)).astype(np.float32)
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def bits(rng, n, n_bytes=32):
    return rng.integers(0, 256, (n, n_bytes), dtype=np.uint8)


def distances(a, b, norm):
    if norm == "hamming":
        return np.stack([np.unpackbits(row ^ b, axis=1).sum(1) for row in a]).astype(np.float64)
    a, b = a.astype(np.float64), b.astype(np.float64)
    return np.stack([np.sqrt(((row - b) ** 2).sum(1)) for row in a])


def brute_force(a, b, norm, mutual=True):
    """Return index1, index2, distance, ratio; argmin selects the lowest of equal candidates."""
    d = distances(a, b, norm)
    j = d.argmin(1)
    i = np.arange(len(a))
    if mutual:
        i = i[d.argmin(0)[j] == i]
    best = d[i, j[i]]
    if len(b) == 1:
        return i, j[i], best, np.full(len(i), np.nan)
    second = np.sort(d, axis=1)[i, 1]
    return i, j[i], best, np.divide(best, second, out=np.ones(len(i)), where=second > 0)


def opencv(a, b, norm):
    cross_check = cv2.BFMatcher(cv2.NORM_L2 if norm == "l2" else cv2.NORM_HAMMING, crossCheck=True)
    return sorted((m.queryIdx, m.trainIdx, m.distance) for m in cross_check.match(a, b))


def assert_equals(m: Matches, expected):
    i, j, distance, ratio = expected
    np.testing.assert_array_equal(m.index1, i)
    np.testing.assert_array_equal(m.index2, j)
    np.testing.assert_allclose(m.distance, distance, rtol=1e-6)
    np.testing.assert_allclose(m.ratio, ratio, rtol=1e-5)


SIZES = [
    (1, 1),
    (1, 7),
    (7, 1),
    (2, 2),
    (127, 129),
    (128, 128),
    (129, 127),
    (300, 1500),
    (1500, 300),
    (2500, 700),
]


@pytest.mark.parametrize("mutual", [True, False])
@pytest.mark.parametrize("n1,n2", SIZES)
@pytest.mark.parametrize("norm", ["l2", "hamming"])
def test_equals_brute_force(norm, n1, n2, mutual):
    rng = np.random.default_rng(n1 + n2)
    make = unit if norm == "l2" else bits
    a, b = make(rng, n1), make(rng, n2)
    m = match(features(a, norm), features(b, norm), mutual=mutual)
    assert_equals(m, brute_force(a, b, norm, mutual))
    assert m.index1.dtype == m.index2.dtype == np.int64
    assert m.distance.dtype == m.ratio.dtype == np.float32


@pytest.mark.parametrize(
    "norm,width",
    [("l2", 64), ("l2", 128), ("hamming", 16), ("hamming", 32), ("hamming", 61), ("hamming", 64)],
)
def test_equals_opencv(norm, width):
    """Mix noisy copies with other descriptors, so that there are matches and, for bits, ties."""
    rng = np.random.default_rng(width)
    if norm == "l2":
        a = unit(rng, 3000, width)
        b = np.concatenate(
            [a[::2] + rng.normal(0, 0.05, a[::2].shape).astype(np.float32), unit(rng, 1200, width)]
        )
    else:
        a = bits(rng, 3000, width)
        noise = np.packbits(rng.random((1500, 8 * width)) < 0.15, axis=1)
        b = np.concatenate([a[::2] ^ noise, bits(rng, 1200, width)])
    rng.shuffle(b)
    m = match(features(a, norm), features(b, norm))
    expected = opencv(a, b, norm)
    assert [(i, j) for i, j, _ in expected] == list(zip(m.index1, m.index2))
    np.testing.assert_allclose(m.distance, [d for *_, d in expected], atol=1e-5)
    assert len(m) > 1000


@settings(max_examples=150, deadline=None)
@given(
    norm=st.sampled_from(["l2", "hamming"]),
    n1=st.integers(1, 40),
    n2=st.integers(1, 40),
    levels=st.integers(1, 4),
    seed=st.integers(0, 10**6),
    mutual=st.booleans(),
)
def test_ties_go_to_the_lowest_row(norm, n1, n2, levels, seed, mutual):
    """With few values and few columns, nearly every nearest neighbour is a tie."""
    rng = np.random.default_rng(seed)
    dtype = np.float32 if norm == "l2" else np.uint8
    a, b = (rng.integers(0, levels, (n, 2)).astype(dtype) for n in (n1, n2))
    assert_equals(
        match(features(a, norm), features(b, norm), mutual=mutual), brute_force(a, b, norm, mutual)
    )


@pytest.mark.parametrize("scale,offset", [(1.0, 0.0), (1e-3, 0.0), (100.0, 0.0), (1.0, 50.0)])
def test_neighbours_that_float32_products_cannot_distinguish(scale, offset):
    """Match clusters whose members differ by 1e-4.

    The formula |a|² + |b|² - 2ab alone would order them at random.
    """
    rng = np.random.default_rng(5)
    centres = unit(rng, 150)
    cluster = lambda: np.repeat(centres, 8, axis=0) + rng.normal(0, 1e-4, (1200, 64))  # noqa: E731
    a, b = ((scale * cluster() + offset).astype(np.float32) for _ in range(2))
    m = match(features(a), features(b))
    assert_equals(m, brute_force(a, b, "l2"))
    d2 = -2 * (a - a.mean()) @ (b - a.mean()).T + ((b - a.mean()) ** 2).sum(1)
    assert (d2.argmin(1) != distances(a, b, "l2").argmin(1)).any(), (
        "the plain way gets this right: the test is too easy"
    )


def test_more_equal_descriptors_than_are_compared_exactly():
    a = np.full((700, 5), 0.3, np.float32)
    m = match(features(a), features(a[:400]))
    assert (m.index1.tolist(), m.index2.tolist(), m.distance.tolist(), m.ratio.tolist()) == (
        [0],
        [0],
        [0.0],
        [1.0],
    )
    assert match(features(a), features(a[:400]), mutual=False).index2.tolist() == [0] * 700


@pytest.mark.parametrize("norm", ["l2", "hamming"])
def test_strips_parts_and_threads_change_nothing(norm, monkeypatch):
    rng = np.random.default_rng(1)
    a, b = (
        rng.integers(0, 4, (n, 3)).astype(np.float32 if norm == "l2" else np.uint8)
        for n in (900, 700)
    )
    if norm == "l2":
        a, b = a / 3, b / 3  # not whole numbers: ties within rounding
    expected = brute_force(a, b, norm)
    threads = torch.get_num_threads()
    for n_threads, strip, part in [(1, 1, 64), (2, 1, 96), (3, 1, 1000), (2, 1 << 20, 200)]:
        monkeypatch.setitem(matching._STRIP, "cpu", strip)
        monkeypatch.setattr(matching, "_PART", part)
        torch.set_num_threads(n_threads)
        try:
            assert_equals(match(features(a, norm), features(b, norm)), expected)
            assert torch.get_num_threads() == n_threads
        finally:
            torch.set_num_threads(threads)


@pytest.mark.parametrize(
    ("norm", "name", "value"),
    [
        ("l2", "_has_onednn", False),
        ("hamming", "_fastest_sign_dtype", torch.int8),
        ("hamming", "_fastest_sign_dtype", torch.float32),
    ],
)
def test_every_kind_of_processor_finds_the_same_matches(norm, name, value, monkeypatch):
    rng = np.random.default_rng(2)
    make = unit if norm == "l2" else bits
    a, b = make(rng, 1500), make(rng, 1400)
    here = match(features(a, norm), features(b, norm))
    monkeypatch.setattr(matching, name, lambda *args: value)
    there = match(features(a, norm), features(b, norm))
    for name in ("index1", "index2", "distance", "ratio"):
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


def test_ratio_and_distance_limits():
    rng = np.random.default_rng(3)
    a, b = features(unit(rng, 500, 8)), features(unit(rng, 500, 8))
    every = match(a, b)
    strict = match(a, b, max_ratio=0.8, max_distance=0.5)
    keep = (every.ratio < 0.8) & (every.distance <= 0.5)
    assert 0 < keep.sum() < len(every)
    np.testing.assert_array_equal(strict.index1, every.index1[keep])
    np.testing.assert_array_equal(strict.ratio, every.ratio[keep])
    limit = float(every.distance[0])
    assert every.index1[0] in match(a, b, max_distance=limit).index1, "the limit itself is allowed"


def test_a_sole_candidate_has_no_ratio_and_fails_the_ratio_test():
    a, b = features(np.float32([[0, 0], [3, 4]])), features(np.float32([[0, 1]]))
    m = match(a, b)
    assert m.index1.tolist() == [0]
    assert np.isnan(m.ratio).all()
    assert len(match(a, b, max_ratio=1.0)) == 0


def test_only_features_with_equal_laplacian_signs_are_matched():
    rng = np.random.default_rng(4)
    d1, d2 = unit(rng, 600, 16), unit(rng, 500, 16)
    s1, s2 = (rng.choice(np.int8([-1, 1]), n) for n in (600, 500))
    m = match(features(d1, laplacian=s1), features(d2, laplacian=s2))
    expected = {}
    for sign in (-1, 1):
        r1, r2 = np.flatnonzero(s1 == sign), np.flatnonzero(s2 == sign)
        i, j, distance, ratio = brute_force(d1[r1], d2[r2], "l2")
        expected |= {r1[a]: (r2[b], d, q) for a, b, d, q in zip(i, j, distance, ratio)}
    assert m.index1.tolist() == sorted(expected)
    np.testing.assert_array_equal(m.index2, [expected[i][0] for i in m.index1])
    np.testing.assert_allclose(m.ratio, [expected[i][2] for i in m.index1], rtol=1e-5)
    assert (s1[m.index1] == s2[m.index2]).all()
    ungated = match(features(d1, laplacian=s1), features(d2))
    assert_equals(ungated, brute_force(d1, d2, "l2"))


def test_a_sign_that_occurs_in_one_image_only_has_no_matches():
    d = np.eye(2, dtype=np.float32)
    m = match(features(d, laplacian=np.int8([1, 1])), features(d, laplacian=np.int8([-1, 1])))
    assert (m.index1.tolist(), m.index2.tolist()) == ([1], [1])
    assert (
        len(match(features(d, laplacian=np.int8([1, 1])), features(d, laplacian=np.int8([-1, -1]))))
        == 0
    )


@pytest.mark.parametrize("n1,n2", [(0, 5), (5, 0), (0, 0)])
@pytest.mark.parametrize("norm", ["l2", "hamming"])
def test_without_features_there_are_no_matches(norm, n1, n2):
    dtype = np.float32 if norm == "l2" else np.uint8
    sign = lambda n: np.ones(n, np.int8)  # noqa: E731
    for laplacian in (lambda n: None, sign):
        m = match(
            features(np.zeros((n1, 4), dtype), norm, laplacian=laplacian(n1)),
            features(np.zeros((n2, 4), dtype), norm, laplacian=laplacian(n2)),
        )
        assert len(m) == 0


def test_features_that_are_not_comparable_are_rejected():
    a = features(np.zeros((3, 8), np.float32))
    with pytest.raises(InputError, match="different operator"):
        match(a, features(np.zeros((3, 8), np.float32), operator="other"))
    with pytest.raises(InputError, match="different norm"):
        match(a, features(np.zeros((3, 8), np.uint8), "hamming"))
    with pytest.raises(InputError, match="8 and 4 columns"):
        match(a, features(np.zeros((3, 4), np.float32)))
    with pytest.raises(InputError, match="max_ratio"):
        match(a, a, max_ratio=80.0)
    with pytest.raises(InputError, match="max_distance"):
        match(a, a, max_distance=-1.0)
    with pytest.raises(InputError, match="max_distance"):
        match(a, a, max_distance=float("nan"))


@pytest.mark.data
@pytest.mark.parametrize(
    "operator,options",
    [("surf", {"hessian_threshold": 400}), ("orb", {"nfeatures": 5000}), ("sift", {})],
)
def test_equals_opencv_on_photographs(operator, options, data_dir):
    images = [
        cv2.imread(str(data_dir / "oxford" / "graf" / f"img{k}.png"), cv2.IMREAD_GRAYSCALE)
        for k in (1, 2)
    ]
    # OpenCV's matcher does not use the Laplacian.
    a, b = (
        dataclasses.replace(detect(image, operator, **options), laplacian=None) for image in images
    )
    m = match(a, b)
    expected = opencv(a.descriptors, b.descriptors, a.norm)
    assert [(i, j) for i, j, _ in expected] == list(zip(m.index1, m.index2))
    assert len(m) > 500


@pytest.mark.cuda
@pytest.mark.parametrize("norm", ["l2", "hamming"])
def test_cuda_finds_the_same(norm):
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    rng = np.random.default_rng(6)
    make = unit if norm == "l2" else bits
    a, b = features(make(rng, 3000), norm), features(make(rng, 2500), norm)
    on_cpu, on_gpu = match(a, b), match(a, b, device="cuda")
    for name in ("index1", "index2", "distance", "ratio"):
        np.testing.assert_array_equal(getattr(on_cpu, name), getattr(on_gpu, name))


_MEMORY = """
import resource, sys
import numpy as np
from sfmkit.matching.nearest import match
from sfmkit.types import Features
norm, n = sys.argv[1], int(sys.argv[2])
rng = np.random.default_rng(0)
def features(n):
    if norm == "l2":
        d = rng.normal(size=(n, 64)).astype(np.float32)
    else:
        d = rng.integers(0, 256, (n, 64), dtype=np.uint8)
    z = np.zeros(n, np.float32)
    return Features(np.zeros((n, 2), np.float32), z, z, z, d, norm, "test", (640, 480))
match(features(300), features(300))
a, b = features(n), features(n)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
match(a, b)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


@pytest.mark.slow
@pytest.mark.parametrize("norm", ["l2", "hamming"])
def test_80_thousand_by_80_thousand_stay_below_1_gib(norm):
    run = [sys.executable, "-c", _MEMORY, norm, "80000"]
    extra_mib = float(subprocess.run(run, check=True, capture_output=True, text=True).stdout)
    assert extra_mib < 1024, f"{extra_mib:.0f} MiB"
