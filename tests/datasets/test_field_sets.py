"""Readers of the field's data sets, on tiny sets in the published layouts."""

from __future__ import annotations

import shutil

import h5py
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from sfmkit.datasets import pairs
from sfmkit.datasets.hpatches import sequences_of_hpatches
from sfmkit.errors import InputError

NAMES = ("02928139_3448003521", "03903474_1471484089", "10265353_3838484249")


@pytest.fixture
def tourism(tmp_path):
    """A scene with three photographs, and its cameras by name."""
    folder = tmp_path / "phototourism" / "sacre_coeur" / "set_100"
    for name in ("images", "calibration", "new-vis-pairs"):
        (folder / name).mkdir(parents=True)
    rng = np.random.default_rng(0)
    cameras = {}
    for name in NAMES:
        Image.new("RGB", (64, 48)).save(folder / "images" / f"{name}.jpg")
        K = np.array([[70.0, 0, 32], [0, 71, 24], [0, 0, 1]])
        R = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        t = rng.normal(size=3)
        with h5py.File(folder / "calibration" / f"calibration_{name}.h5", "w") as file:
            file["K"], file["R"], file["T"] = K, R, t
        cameras[name] = K, R, t
    listed = [f"{NAMES[2]}-{NAMES[0]}", f"{NAMES[2]}-{NAMES[1]}"]
    np.save(folder / "new-vis-pairs" / "keys-th-0.1.npy", listed)
    np.save(folder / "new-vis-pairs" / "keys-th-0.5.npy", listed[:1])
    return tmp_path, cameras


def test_phototourism_poses_relate_the_cameras(tourism):
    root, cameras = tourism
    first, second = pairs("phototourism:sacre_coeur", root)
    assert (first.sequence, first.name) == ("sacre_coeur", f"{NAMES[2]}-{NAMES[0]}")
    assert second.image2.name == f"{NAMES[1]}.jpg"
    (K1, R1, t1), (K2, R2, t2) = cameras[NAMES[2]], cameras[NAMES[0]]
    X = np.array([0.3, -0.2, 1.7])  # in the world
    np.testing.assert_allclose(first.R @ (R1 @ X + t1) + first.t, R2 @ X + t2, atol=1e-12)
    np.testing.assert_array_equal(first.camera1.K, K1)
    np.testing.assert_array_equal(first.camera2.K, K2)
    assert first.camera1.size_wh == (64, 48)
    assert len(list(pairs("phototourism", root, covisibility=0.5))) == 1


def test_damaged_phototourism_is_refused_with_the_file(tourism):
    root, _ = tourism
    folder = root / "phototourism" / "sacre_coeur" / "set_100"
    with pytest.raises(InputError, match=r"no list of pairs .*keys-th-0\.9"):
        list(pairs("phototourism", root, covisibility=0.9))
    keys = folder / "new-vis-pairs" / "keys-th-0.1.npy"
    np.save(keys, np.array([{"pickled": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match=r"keys-th-0\.1\.npy is not a NumPy file of names"):
        list(pairs("phototourism", root))
    np.save(keys, np.arange(3))
    with pytest.raises(InputError, match="array of int64, not a list of names"):
        list(pairs("phototourism", root))
    np.save(keys, [NAMES[0]])
    with pytest.raises(InputError, match="not a pair of names"):
        list(pairs("phototourism", root))
    np.save(keys, [f"{NAMES[0]}-{NAMES[1]}"])
    (folder / "calibration" / f"calibration_{NAMES[1]}.h5").write_bytes(b"no HDF5 file")
    with pytest.raises(InputError, match=rf"calibration_{NAMES[1]}\.h5 is not a calibration"):
        list(pairs("phototourism", root))
    (folder / "images" / f"{NAMES[0]}.jpg").unlink()
    with pytest.raises(InputError, match=f"no image {NAMES[0]}"):
        list(pairs("phototourism", root))


def test_sequences_of_hpatches_can_be_left_out(tmp_path):
    for name in ("i_dome", "v_graffiti", "v_wall", "other"):
        (tmp_path / "hpatches" / name).mkdir(parents=True)
    assert sequences_of_hpatches(tmp_path) == ("i_dome", "v_graffiti", "v_wall")
    assert sequences_of_hpatches(tmp_path, without=["v_wall"]) == ("i_dome", "v_graffiti")
    assert sequences_of_hpatches(tmp_path, ["v_wall", "i_dome"], ["i_dome"]) == ("v_wall",)
    with pytest.raises(InputError, match="no sequence is left"):
        sequences_of_hpatches(tmp_path, ["v_wall"], ["v_wall"])
    with pytest.raises(InputError, match=r"unknown sequence 'v_wal'\. Did you mean 'v_wall'"):
        sequences_of_hpatches(tmp_path, without=["v_wal"])
    shutil.rmtree(tmp_path / "hpatches")
    with pytest.raises(InputError, match="no folder"):
        sequences_of_hpatches(tmp_path)
