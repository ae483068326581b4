"""The figures of the benchmark of many views."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sfmkit.errors import InputError
from sfmkit.evaluation.maps import SCENES, bench_map, pose_errors_of
from sfmkit.evaluation.maps_tables import maps_result


def cameras(n=6, seed=0):
    """Name -> R and t of cameras at random places, m."""
    rng = np.random.default_rng(seed)
    found = {}
    for k in range(n):
        R = Rotation.random(rng=rng).as_matrix()
        found[f"{k}.jpg"] = (R, -R @ rng.uniform(-5, 5, 3))
    return found


def test_a_model_in_another_frame_and_scale_has_no_error():
    truth = cameras()
    S, s, shift = Rotation.from_rotvec([0.3, -1, 0.5]).as_matrix(), 0.2, np.array([4.0, -2, 9])
    # X' = s S X + shift; the camera sees the same, so R' = R S^T, and its centre moves along
    moved = {}
    for name, (R, t) in truth.items():
        centre = s * S @ (-R.T @ t) + shift
        moved[name] = (R @ S.T, -R @ S.T @ centre)
    errors = pose_errors_of(moved, truth)
    assert max(errors.values()) < 1e-5


def test_a_turned_camera_has_the_error_of_its_turn():
    truth = cameras()
    turn = Rotation.from_rotvec([0, np.radians(0.5), 0]).as_matrix()
    found = dict(truth)
    R, t = truth["2.jpg"]
    found["2.jpg"] = (turn @ R, turn @ t)  # at the same place
    errors = pose_errors_of(found, truth)
    assert errors["rotation_worst_deg"] == pytest.approx(0.5, abs=1e-6)
    assert errors["rotation_deg"] == pytest.approx(0, abs=1e-5)
    assert errors["position_worst_mm"] < 1e-5


def test_the_rotation_that_all_cameras_share_is_separated_from_the_rest():
    """Cameras at the right places, turned by 0.4 degrees in the world, one of them by 0.1 more."""
    truth = cameras()
    turn = Rotation.from_rotvec(np.radians([0.0, 0.24, 0.32])).as_matrix()
    found = {}
    for name, (R, t) in truth.items():
        own = Rotation.from_rotvec([np.radians(0.1 if name == "0.jpg" else 0), 0, 0]).as_matrix()
        turned = own @ R @ turn
        found[name] = (turned, -turned @ (-R.T @ t))
    errors = pose_errors_of(found, truth)
    assert errors["rotation_deg"] == pytest.approx(0.4, abs=1e-4)
    assert errors["rotation_common_deg"] == pytest.approx(0.4, abs=0.02)
    assert errors["rotation_rest_deg"] == pytest.approx(0.1 / 6, abs=1e-3)  # the mean's part
    assert errors["position_worst_mm"] < 1e-5


def test_two_cameras_have_no_error_to_speak_of():
    truth = cameras()
    assert pose_errors_of({"0.jpg": truth["0.jpg"], "1.jpg": truth["1.jpg"]}, truth) == {}
    assert pose_errors_of({}, truth) == {}


def test_rows_become_one_table_per_scene():
    row = {"scene": "temple ring", "recipe": "fused", "registered": 3, "photographs": 16}
    full = {"points": 900, "track_length": 3.5, "error_px": 0.4, "pairs_cpu_s": 12.0, "map_s": 1.0}
    result = maps_result(
        [row | full, row | {"scene": "drone", "registered": 0}], "sfmkit bench map"
    )
    assert [table.name for table in result.tables] == ["temple-ring", "drone"]
    assert "3 of 16" in result.tables[0].markdown()


def test_an_unknown_scene_is_refused_before_the_work(tmp_path):
    pytest.importorskip("pycolmap")
    with pytest.raises(InputError, match="unknown scene 'moon'; the scenes are fountain"):
        bench_map(tmp_path / "o", scenes=("moon",))
    assert not (tmp_path / "o").exists()


def test_the_scenes_have_the_truth_of_their_photographs(data_dir):
    counts = {"fountain": 11, "temple": 16, "drone": 0}
    for name, make in SCENES.items():
        scene = make(data_dir)
        assert len(scene.truth) == counts[name]
        assert all((scene.folder / photograph).is_file() for photograph in scene.truth)
