"""Options of operators are accepted at both ends of their bounds and rejected beyond them."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from sfmkit.errors import InputError
from sfmkit.features import detect
from sfmkit.features.bounds import BOUNDS, bounds_of
from sfmkit.features.plugins import OPERATOR_PLUGINS
from sfmkit.features.tables import DESCRIPTORS, DETECTORS, find_spec

# every detector and every descriptor once
OPERATORS = [
    *("surf", "orb", "fast-brief", "agast+brief", "harris-brief", "gftt-brief", "sift", "akaze"),
    *("kaze", "brisk", "star+brief", "mser+brief", "affine-orb", "rootsift"),
    *(f"fast+{name}" for name in ("orb", "brisk", "freak", "latch", "beblid", "teblid")),
    *(f"fast+{name}" for name in ("boost", "daisy", "vgg", "sift", "surf")),
]
QUICK = ["gftt-brief", "star+brief"]
IMAGE = np.zeros((20, 20), np.uint8)


def cases(name: str) -> list[tuple[str, str, float]]:
    """(operator, option, value) at both ends of every option that is a number."""
    spec = find_spec(name.removeprefix("affine-"))
    found = []
    for option, default in OPERATOR_PLUGINS.options(name).items():
        if isinstance(default, bool):
            continue
        for value in bounds_of(spec.detector, spec.descriptor, option):
            found.append((name, option, type(default)(value)))
    return found


# Runs every case in a child of its own, forked before any thread exists, and prints those that end
# by a signal, need more than the limit, or raise anything but the refusal of a value by OpenCV.
CHILDREN = """
import ast, os, signal, sys, time
import cv2, numpy as np, torch
from sfmkit.errors import SfmError
from sfmkit.features import detect
cv2.setNumThreads(1); torch.set_num_threads(1)
noise = np.random.default_rng(0).integers(0, 255, (480, 640), np.uint8)
large = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
for name, option, value in ast.literal_eval(sys.stdin.read()):
    # the image at which the time limit holds, one at which arrays are long, and a tiny one
    for image, budget in ((large[:130, :180], 300), (large, 300), (large[:9, :11], None)):
        if image is large and option not in ("minDistance", "suppressNonmaxSize", "blockSize"):
            continue
        child = os.fork()
        if child == 0:
            status = 0
            signal.alarm(30)
            try:
                detect(image, name, budget=budget, **{option: value})
            except SfmError as error:
                status = 0 if "OpenCV could not run" in str(error) else 3
            except BaseException as error:
                print(repr(error), flush=True)
                status = 4
            os._exit(status)
        _, status = os.waitpid(child, 0)
        if status:
            print(name, option, value, image.shape, os.waitstatus_to_exitcode(status), flush=True)
"""


def failures(tried: list[tuple[str, str, float]]) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CHILDREN],
        input=repr(tried),
        capture_output=True,
        text=True,
        check=True,
        timeout=280,
    )
    return done.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in OPERATORS],
)
def test_the_bounds_neither_crash_nor_hang(name):
    assert failures(cases(name)) == ""


def test_every_part_and_every_number_has_bounds():
    assert set(BOUNDS) <= set(DETECTORS) | set(DESCRIPTORS)
    for name in OPERATORS:
        spec = find_spec(name.removeprefix("affine-"))
        for option, default in OPERATOR_PLUGINS.options(name).items():
            if not isinstance(default, bool):
                low, high = bounds_of(spec.detector, spec.descriptor, option)
                assert low <= default <= high < math.inf, (name, option)


@pytest.mark.parametrize("name", OPERATORS)
def test_values_beyond_the_bounds_are_rejected_before_the_work(name):
    spec = find_spec(name.removeprefix("affine-"))
    for option, default in OPERATOR_PLUGINS.options(name).items():
        if isinstance(default, bool):
            continue
        low, high = bounds_of(spec.detector, spec.descriptor, option)
        whole = isinstance(default, int)
        below, above = (low - 1, high + 1) if whole else (low * 0.99 - 1e-15, high * 1.01)
        for value in (below, above, math.nan, math.inf, -math.inf, -1, 2**63, True, "3", None):
            with pytest.raises(InputError, match=f"'{option}'"):
                detect(IMAGE, name, **{option: value})


def test_values_that_made_opencv_crash_or_hang_are_rejected():
    for name, option, value in (
        ("gftt-brief", "minDistance", 2**31 - 1),
        ("harris-brief", "minDistance", 2**31 - 1),
        ("kaze", "nOctaves", 16),
        ("star+brief", "suppressNonmaxSize", 1001),
    ):
        with pytest.raises(InputError, match=f"'{option}' .* from .* to "):
            detect(IMAGE, name, **{option: value})
