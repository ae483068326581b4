"""All frozen types can be pickled and copied."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
import torch
from made_up_result import make_result

from sfmkit.options import PRESETS, DetectOptions, Options
from sfmkit.types import FrozenMapping

RESULT = make_result(points=20, outliers=5, lonely=3)
TYPES = {
    "Features": next(iter(RESULT.features.values())),
    "Matches": next(iter(RESULT.matches.values())),
    "Correspondences": RESULT.correspondences,
    "TwoView": RESULT.two_view,
    "PointCloud": RESULT.cloud,
    "Camera": RESULT.two_view.camera1,
    "Reconstruction": RESULT,
    "Options": Options(detect=DetectOptions(overrides={"surf": {"hessian_threshold": 100}})),
    "PRESETS": PRESETS,
}


def assert_same(a, b):
    assert type(a) is type(b)
    if is_dataclass(a):
        for f in fields(a):
            assert_same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, Mapping):
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b):
            assert_same(one, other)
    elif isinstance(a, torch.Tensor):
        assert torch.equal(a, b)
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b)
    else:
        assert a == b


@pytest.mark.parametrize(
    "make", [lambda v: pickle.loads(pickle.dumps(v)), copy.copy, copy.deepcopy]
)
@pytest.mark.parametrize("name", TYPES)
def test_a_copy_equals_the_original(name, make):
    assert_same(make(TYPES[name]), TYPES[name])


def test_a_frozen_mapping_is_an_immutable_copy():
    source = {"a": 1}
    frozen = FrozenMapping(source)
    source["a"] = 2
    assert frozen == {"a": 1}
    assert dict(frozen) == {"a": 1}
    with pytest.raises(TypeError):
        frozen["a"] = 3
    with pytest.raises(AttributeError):
        frozen._items = {}
