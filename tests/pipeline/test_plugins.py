"""Plug-ins of an installed package in reconstructions, in Python and on the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import click
import cv2
import jsonschema
import numpy as np
import pytest
import torch

import sfmkit
from sfmkit import reconstruct, register_estimator, register_matcher, register_operator
from sfmkit.cli import parsing
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.errors import InputError, OperatorError
from sfmkit.estimation import ESTIMATOR_PLUGINS, RobustModel, run_estimator
from sfmkit.features import OPERATOR_PLUGINS, detect
from sfmkit.matching import MATCHER_PLUGINS, choose_matchers, match, run_matcher
from sfmkit.options import DEFAULT, MatchOptions
from sfmkit.pipeline.report import make_report, schema
from sfmkit.types import Features, Matches, Verdict

MODULE = '''
import cv2, numpy as np, torch
from sfmkit import Features, Matches, RobustModel
from sfmkit.estimation.opencv import estimate as by_opencv

def corners(image, *, count=1500):
    """SIFT keypoints of the brightest channel."""
    keypoints, descriptors = cv2.SIFT_create(count).detectAndCompute(image.max(axis=2), None)
    column = lambda name: np.array([getattr(k, name) for k in keypoints], np.float32)
    xy = np.array([k.pt for k in keypoints], np.float32).reshape(-1, 2)
    return Features(xy, column("size"), np.deg2rad(column("angle")), column("response"),
                    descriptors, "l2", "anything", (image.shape[1], image.shape[0]))

def both_ways(features1, features2, *, worst=0.9):
    """Ratio test by OpenCV."""
    found = cv2.BFMatcher().knnMatch(features1.descriptors, features2.descriptors, k=2)
    rows = [(a.queryIdx, a.trainIdx, a.distance, a.distance / b.distance)
            for a, b in found if a.distance < worst * b.distance]
    i, j, distance, ratio = np.array(rows).T
    return Matches(i.astype(np.int64), j.astype(np.int64), distance.astype(np.float32),
                   ratio.astype(np.float32))

def estimate(x1, x2, K1, K2, *, threshold_px, seed, scale=1.0):
    return by_opencv(x1, x2, K1, K2, threshold_px=scale * threshold_px, seed=seed)
'''
ENTRY_POINTS = """[sfmkit.operators]
made-up-corners = made_up_plugins:corners
[sfmkit.matchers]
made-up-matcher = made_up_plugins:both_ways
[sfmkit.estimators]
made-up-estimator = made_up_plugins:estimate
"""
QUICK = replace(DEFAULT, detect=replace(DEFAULT.detect, budget=1500, max_size=800))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Make a folder with an installed package: a module and the metadata that pip writes."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "made_up_plugins.py").write_text(MODULE)
    info = folder / "made_up_plugins-1.5.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: made-up-plugins\nVersion: 1.5\n")
    (info / "top_level.txt").write_text("made_up_plugins\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


@pytest.fixture
def installed(site, monkeypatch):
    registries = (OPERATOR_PLUGINS, MATCHER_PLUGINS, ESTIMATOR_PLUGINS)
    monkeypatch.syspath_prepend(str(site))
    for registry in registries:
        registry.__dict__.pop("_entry_points", None)
    yield
    for registry in registries:
        registry.__dict__.pop("_entry_points", None)


def test_entry_points_and_import_paths_in_python(installed):
    image1, image2, truth = demo_pair()
    result = reconstruct(
        image1,
        image2,
        truth,
        ("made-up-corners", "made_up_plugins:corners", "orb"),
        matchers={"made-up-corners": "made-up-matcher"},
        options=replace(
            QUICK,
            estimate=replace(QUICK.estimate, backend="made-up-estimator", overrides={"scale": 0.5}),
        ),
    )
    assert result.two_view.verdict is Verdict.GENERAL
    report = make_report(result)
    report["timings_s"]["write"] = 0.0  # added when the files are written
    jsonschema.validate(report, schema())
    assert report["options"]["estimate"]["overrides"] == {"scale": 0.5}
    a, b = (result.features[n][0] for n in ("made-up-corners", "made_up_plugins:corners"))
    assert a.operator == "made-up-corners"
    np.testing.assert_array_equal(a.keypoints, b.keypoints)
    f1, f2 = result.features["made-up-corners"]
    assert len(match(f1, f2)) != len(result.matches["made-up-corners"])
    assert (result.matches["made-up-corners"].ratio < 0.9).all()
    assert len(result.matches["orb"]) == len(match(*result.features["orb"]))
    used = result.plugins
    assert used["operators"]["orb"].startswith("sfmkit ")
    assert used["operators"]["made-up-corners"].startswith("made-up-plugins 1.5 corners sha256:")
    assert set(used["matchers"]) == {"nearest", "made-up-matcher"}
    assert "made-up-plugins 1.5" in used["estimators"]["made-up-estimator"]


def test_the_command_line_accepts_all_kinds_of_plug_ins(site, tmp_path):
    image1, image2, truth = (str(path) for path in demo_pair())
    root = os.path.dirname(os.path.dirname(sfmkit.__file__))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "sfmkit.cli", "reconstruct", image1, image2]
    command += ["--intrinsics", truth, "--operators", "orb,made_up_plugins:corners"]
    command += ["--matcher", "made_up_plugins:corners=made_up_plugins:both_ways"]
    command += ["--matcher", "orb=nearest", "--backend", "made_up_plugins:estimate"]
    command += ["--device", "cpu", "--threshold", "1.5", "--budget", "1500", "--max-size", "800"]
    command += ["--out", str(out), "--json"]
    environment = os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{root}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["options"]["estimate"]["threshold_px"] == 1.5
    assert report["options"]["estimate"]["backend"] == "made_up_plugins:estimate"
    assert report["options"]["match"]["matchers"]["orb"] == "nearest"
    assert report["options"]["detect"]["budget"] == 1500
    assert set(report["operators"]) == {"orb", "made_up_plugins:corners", "multi"}
    assert "sha256" in report["plugins"]["matchers"]["made_up_plugins:both_ways"]
    assert (out / "recording.rrd").stat().st_size > 0


def test_the_digest_changes_with_the_source(site, installed):
    before = OPERATOR_PLUGINS.provenance("made-up-corners")
    path = site / "made_up_plugins.py"
    text = path.read_text()
    path.write_text(text + "\n# changed\n")
    try:
        assert OPERATOR_PLUGINS.provenance("made-up-corners") != before
    finally:
        path.write_text(text)
    assert OPERATOR_PLUGINS.provenance("made-up-corners") == before


# -- faults


IMAGE = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)


def features(n=5, size_wh=(80, 60), at=10.0):
    ones = np.ones(n, np.float32)
    xy = np.full((n, 2), at, np.float32)
    return Features(xy, ones, ones, ones, np.eye(n, 8, dtype=np.float32), "l2", "x", size_wh)


def broken(*_args, **_options):
    raise ZeroDivisionError("no luck")


def nan_features(image):
    return features(at=np.nan)


@pytest.mark.parametrize(
    "operator, reason",
    [
        (broken, "ZeroDivisionError: no luck"),
        (nan_features, "NaN"),
        (lambda image: None, "must be Features"),
        (lambda image: features(size_wh=(60, 80)), "size_wh"),
        (lambda image: features(at=500.0), "outside the image"),
    ],
)
def test_the_error_of_a_wrong_operator_names_it(operator, reason):
    register_operator("wrong-one", operator)
    try:
        with pytest.raises(OperatorError, match=f"'wrong-one'.*{reason}"):
            detect(IMAGE, "wrong-one")
    finally:
        OPERATOR_PLUGINS.unregister("wrong-one")


def matches(*pairs):
    i, j = np.array(pairs, np.int64).T
    return Matches(i, j, np.zeros(len(i), np.float32), np.zeros(len(i), np.float32))


def test_matchers_of_the_command_line_and_of_python_are_chosen_alike():
    def chosen(*values):
        options = choose_matchers(MatchOptions(), parsing.matchers(None, None, values))
        return options.matcher, dict(options.matchers)

    assert chosen() == (MatchOptions().matcher, {})
    assert chosen("a") == ("a", {})
    assert chosen("surf=b", "orb=c") == (MatchOptions().matcher, {"surf": "b", "orb": "c"})
    assert chosen("a", "surf=b") == ("a", {"surf": "b"})
    for values in (("a", "b"), ("surf=a", "surf=b"), ("surf=",), ("surf=a=b",)):
        with pytest.raises(click.BadParameter, match="OPERATOR=MATCHER"):
            chosen(*values)


@pytest.mark.parametrize(
    "matcher, reason",
    [
        (broken, "ZeroDivisionError: no luck"),
        (lambda a, b: [], "must be Matches"),
        (lambda a, b: matches((0, 5)), "index2 points outside the 5"),
        (lambda a, b: matches((-1, 2)), "index1 points outside the 5"),
        (lambda a, b: matches((1, 2), (1, 2)), "more than once"),
        (lambda a, b: Matches(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1)), "dtype"),
    ],
)
def test_the_error_of_a_wrong_matcher_names_it(matcher, reason):
    register_matcher("wrong-one", matcher)
    try:
        with pytest.raises(InputError, match=f"'wrong-one'.*{reason}"):
            run_matcher(features(), features(), MatchOptions(matcher="wrong-one"))
    finally:
        MATCHER_PLUGINS.unregister("wrong-one")


YES = torch.ones(9, dtype=torch.bool)
EYE = torch.eye(3, dtype=torch.float64)


@pytest.mark.parametrize(
    "estimator, reason",
    [
        (broken, "ZeroDivisionError: no luck"),
        (lambda *a: EYE, "must be a RobustModel"),
        (lambda *a: RobustModel(EYE, YES[:3], 1.0, 0), r"inliers must be .* \(9,\)"),
        (lambda *a: RobustModel(EYE[:2], YES, 1.0, 0), r"shape \(3, 3\)"),
        (lambda *a: RobustModel(EYE * torch.nan, YES, 1.0, 0), "NaN"),
    ],
)
def test_the_error_of_a_wrong_estimator_names_it(estimator, reason):
    register_estimator("wrong-one", estimator)
    x = torch.rand(9, 2, dtype=torch.float64)
    try:
        with pytest.raises(InputError, match=f"'wrong-one'.*{reason}"):
            run_estimator("wrong-one", x, x, EYE, EYE)
    finally:
        ESTIMATOR_PLUGINS.unregister("wrong-one")


def test_an_estimator_of_essential_matrices_is_not_called_for_other_models():
    register_estimator("only-e", lambda x1, x2, K1, K2: RobustModel.failed(len(x1)))
    x = torch.rand(9, 2, dtype=torch.float64)
    try:
        assert run_estimator("only-e", x, x, EYE, EYE).model is None
        with pytest.raises(InputError, match=r"'only-e' .*essential matrices only"):
            run_estimator("only-e", x, x, EYE, EYE, model="fundamental")
        with pytest.raises(InputError, match="'only-e' has no methods"):
            run_estimator("only-e", x, x, EYE, EYE, method="fast")
    finally:
        ESTIMATOR_PLUGINS.unregister("only-e")


def test_an_estimator_gets_its_own_options():
    def estimate(x1, x2, K1, K2, *, seed, least=8):
        return RobustModel(EYE, torch.full((len(x1),), len(x1) >= least), least, 0)

    register_estimator("has-options", estimate)
    x = torch.rand(9, 2, dtype=torch.float64)
    try:
        assert run_estimator("has-options", x, x, EYE, EYE).score == 8
        found = run_estimator("has-options", x, x, EYE, EYE, overrides={"least": 10})
        assert found.score == 10
        assert not found.inliers.any()
        options = replace(DEFAULT.estimate, backend="has-options", overrides={"least": 10})
        assert options.with_backend("has-options") is options
        assert not options.with_backend("torch").overrides
        for wrong, reason in (
            ({"lest": 10}, "'has-options' has no option 'lest'"),
            ({"seed": 1}, "'seed' is a parameter of every estimator"),
            ({"ratio": None}, "'ratio' is a parameter of every estimator"),
        ):
            with pytest.raises(InputError, match=reason):
                run_estimator("has-options", x, x, EYE, EYE, overrides=wrong)
            wrong_options = replace(DEFAULT, estimate=replace(options, overrides=wrong))
            with pytest.raises(InputError, match=reason):
                reconstruct("no-image.png", "no-image.png", options=wrong_options)
    finally:
        ESTIMATOR_PLUGINS.unregister("has-options")


@pytest.mark.parametrize(
    "settings, message",
    [
        (
            {"operators": ("orb", "nowhere.to:be_found")},
            "cannot load operator 'nowhere.to:be_found'",
        ),
        ({"matchers": "flann"}, "unknown matcher 'flann'"),
        ({"matchers": {"surf": "nearest"}}, "not used: surf"),
        ({"device": "cuda:99"}, "device 'cuda:99' cannot be used"),
        ({"device": "gpu"}, "device 'gpu' cannot be used"),
        (
            {"options": replace(QUICK, estimate=replace(QUICK.estimate, backend="cv2:nothing"))},
            "cannot load estimator 'cv2:nothing'",
        ),
        ({"operators": ("cv2:__version__",)}, "not callable"),
    ],
)
def test_wrong_names_are_rejected_before_the_work_starts(settings, message, monkeypatch):
    monkeypatch.setattr(cv2, "cvtColor", broken)  # no image is read
    with pytest.raises(InputError, match=message):
        reconstruct("no-image.png", "no-image.png", **{"operators": ("orb",), **settings})


def test_budget_mask_and_size_are_applied_to_a_plug_in():
    def grid(image):
        h, w = image.shape[:2]
        xy = np.mgrid[0:w:4, 0:h:4].reshape(2, -1).T.astype(np.float32)
        ones = np.ones(len(xy), np.float32)
        descriptors = np.tile(ones[:, None], (1, 4))
        return Features(xy, ones, ones, ones, descriptors, "l2", "grid", (w, h))

    register_operator("grid", grid)
    try:
        mask = np.zeros((60, 80), np.uint8)
        mask[:, 40:] = 1
        found = detect(IMAGE, "grid", mask=mask, budget=30, max_size=40)
        assert 0 < len(found) <= 30
        assert found.keypoints[:, 0].min() >= 39.5
        assert found.size_wh == (80, 60)
        assert found.operator == "grid"
        np.testing.assert_allclose(found.scales, 2)
        affine = detect(IMAGE, "affine-grid", tilts=1)
        assert affine.operator == "affine-grid"
        assert len(affine) > len(detect(IMAGE, "grid"))
    finally:
        OPERATOR_PLUGINS.unregister("grid")


def test_built_in_plug_ins_are_in_the_same_registries():
    assert {"surf", "orb", "fast-brief", "xfeat"} <= set(OPERATOR_PLUGINS)
    assert "nearest" in MATCHER_PLUGINS
    assert set(ESTIMATOR_PLUGINS) >= {"torch", "opencv", "poselib", "pycolmap"}
    with pytest.raises(InputError, match="already another"):
        register_operator("surf", broken)
    with pytest.raises(InputError, match="must be callable"):
        register_matcher("name", 3)
    with pytest.raises(OperatorError, match="Did you mean 'surf'"):
        detect(IMAGE, "surff")
