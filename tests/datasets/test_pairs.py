"""Data sets as pairs: what is read, and what is said when something is missing."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from sfmkit.datasets import Pair, pairs
from sfmkit.datasets.colmap import colmap
from sfmkit.datasets.pair import data_root, image_files, read_homography
from sfmkit.datasets.strecha import strecha
from sfmkit.errors import InputError

EYE = "1 0 0\n0 1 0\n0 0 1\n"


def make_oxford(root, sequences=("graf",), suffix=".png"):
    for name in sequences:
        folder = root / "oxford" / name
        folder.mkdir(parents=True)
        for k in range(1, 7):
            Image.new("RGB", (8, 6), (k, 0, 0)).save(folder / f"img{k}{suffix}")
        for k in range(2, 7):
            (folder / f"H1to{k}p").write_text(f"2 0 {2 * k}\n0 2 0\n0 0 2\n")
    return root


def test_oxford_pairs_come_with_homographies_scaled_to_one(tmp_path):
    make_oxford(tmp_path, ("wall", "bark"), ".ppm")
    found = list(pairs("oxford", tmp_path))
    assert [str(p) for p in found] == [
        f"oxford/{s} 1-{k}" for s in ("bark", "wall") for k in range(2, 7)
    ]
    np.testing.assert_array_equal(found[3].H, [[1, 0, 5], [0, 1, 0], [0, 0, 1]])
    assert found[3].image2.name == "img5.ppm"
    assert not found[3].H.flags.writeable
    assert len(list(pairs("oxford", tmp_path / "oxford", sequences=["wall"]))) == 5


def test_environment_variable_points_to_local_copies(tmp_path, monkeypatch):
    make_oxford(tmp_path)
    monkeypatch.setenv("SFMKIT_DATA", str(tmp_path))
    assert len(list(pairs("oxford"))) == 5


def test_missing_data_set_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setenv("SFMKIT_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(InputError, match=r"data fetch hpatches.*--data.*SFMKIT_DATA"):
        list(pairs("hpatches"))
    with pytest.raises(InputError, match="no folder"):
        data_root("oxford", tmp_path / "nowhere")


def test_incomplete_sequences_are_named(tmp_path):
    make_oxford(tmp_path)
    with pytest.raises(InputError, match=r"unknown sequence 'grafo'\. Did you mean 'graf'"):
        list(pairs("oxford", tmp_path, sequences=["grafo"]))
    with pytest.raises(InputError, match="'wall' is missing"):
        list(pairs("oxford", tmp_path, sequences=["wall"]))
    (tmp_path / "oxford/graf/img4.png").unlink()
    with pytest.raises(InputError, match="no image img4"):
        list(pairs("oxford", tmp_path))
    (tmp_path / "oxford/graf/H1to3p").unlink()
    with pytest.raises(InputError, match="no homography file"):
        list(pairs("oxford", tmp_path))
    with pytest.raises(InputError, match="unknown data set"):
        pairs("oxfrod")


@pytest.mark.parametrize(
    "text, message",
    [
        ("1 0 0 0 1 0 0 0", "holds 8 numbers"),
        ("1 0 0 0 1 0 0 0 x", "not a number"),
        ("1 0 0 0 1 0 0 0 nan", "not hold a homography"),
        ("1 0 0 0 1 0 0 0 0", "not hold a homography"),
        ("1 2 3 2 4 6 0 0 1", "singular"),
        ("", "holds 0 numbers"),
    ],
)
def test_bad_homography_files(tmp_path, text, message):
    (tmp_path / "H").write_text(text)
    with pytest.raises(InputError, match=message):
        read_homography(tmp_path / "H")


def test_binary_homography_file(tmp_path):
    (tmp_path / "H").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError):
        read_homography(tmp_path / "H")


def test_hpatches_folders(tmp_path):
    for name in ("v_wall", "i_night"):
        folder = tmp_path / "hpatches" / name
        folder.mkdir(parents=True)
        for k in range(1, 7):
            Image.new("RGB", (8, 6)).save(folder / f"{k}.ppm")
            (folder / f"H_1_{k}").write_text(EYE)
    assert [p.sequence for p in pairs("hpatches", tmp_path)] == ["i_night"] * 5 + ["v_wall"] * 5


def test_uav_photographs_follow_their_numbers(tmp_path):
    folder = tmp_path / "uav" / "flight"
    folder.mkdir(parents=True)
    for k in (9, 10, 8):
        Image.new("RGB", (8, 6)).save(folder / f"DJI_{k}.JPG", "JPEG")
    assert [p.name for p in pairs("uav", tmp_path)] == ["DJI_8-DJI_9", "DJI_9-DJI_10"]
    assert [f.name for f in image_files(folder)] == ["DJI_8.JPG", "DJI_9.JPG", "DJI_10.JPG"]
    (folder / "DJI_9.JPG").unlink()
    (folder / "DJI_10.JPG").unlink()
    with pytest.raises(InputError, match="holds 1 photographs"):
        list(pairs("uav", tmp_path))


def test_colmap_model_moves_half_a_pixel_and_chains_poses(tmp_path):
    for name in "ab":
        Image.new("RGB", (100, 80)).save(tmp_path / f"{name}.png")
    (tmp_path / "cameras.txt").write_text(
        "# a comment\n1 OPENCV 100 80 90 91 50 40 .1 .2 .3 .4\n2 SIMPLE_PINHOLE 100 80 70 50 40\n"
    )
    s = np.sqrt(0.5)
    (tmp_path / "images.txt").write_text(
        f"# a comment\n7 {s} 0 0 {s} 1 2 3 2 b.png\n1 2 -1\n8 1 0 0 0 1 0 0 1 a.png\n\n"
    )
    (pair,) = colmap(tmp_path, images=tmp_path)
    assert pair.name == "a-b"
    np.testing.assert_array_equal(pair.camera1.K, [[90, 0, 49.5], [0, 91, 39.5], [0, 0, 1]])
    np.testing.assert_array_equal(pair.camera1.distortion, [0.1, 0.2, 0.3, 0.4, 0])
    np.testing.assert_allclose(
        pair.R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15
    )  # a quarter turn about z
    np.testing.assert_allclose(
        pair.t, [1, 1, 3], atol=1e-15
    )  # X2 = Rz X + (1, 2, 3) with X = X1 - (1, 0, 0)
    (tmp_path / "cameras.txt").write_text(
        "1 OPENCV 100 80 90 91 50 40 .1 .2 .3 .4\n2 FOV 100 80 90 91 50 40 .1\n"
    )
    with pytest.raises(InputError, match="FOV"):
        list(colmap(tmp_path, images=tmp_path))


def colmap_model(tmp_path, *names):
    lines = [f"{k} 1 0 0 0 {k} 0 0 1 {name}\n\n" for k, name in enumerate(names)]
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 8 6 9 9 4 3\n")
    (tmp_path / "images.txt").write_text("".join(lines))
    return tmp_path


def test_colmap_pairs_follow_the_natural_order_of_names(tmp_path):
    names = ["im10.png", "im9.png", "im11 b.png"]
    for name in names:
        Image.new("RGB", (8, 6)).save(tmp_path / name)
    found = list(colmap(colmap_model(tmp_path, *names), images=tmp_path))
    assert [p.name for p in found] == ["im9-im10", "im10-im11 b"]


def test_colmap_images_stay_in_their_folder(tmp_path):
    Image.new("RGB", (8, 6)).save(tmp_path / "a.png")
    (tmp_path / "images").mkdir()
    Image.new("RGB", (8, 6)).save(tmp_path / "images" / "b.png")
    model = colmap_model(tmp_path, "../a.png", "b.png")
    with pytest.raises(InputError, match=r"'\.\./a\.png' leads out of"):
        next(colmap(model, images=tmp_path / "images"))


def test_pairs_check_their_truth():
    image = np.zeros((4, 4), np.uint8)
    with pytest.raises(InputError, match="H must"):
        Pair("a", "b", "c", image, image, H=np.eye(2))
    with pytest.raises(InputError, match="not a rotation"):
        Pair("a", "b", "c", image, image, R=2 * np.eye(3), t=np.zeros(3))
    with pytest.raises(InputError, match="together"):
        Pair("a", "b", "c", image, image, R=np.eye(3))


def test_synthetic_pairs_carry_pose():
    (pair,) = pairs("synthetic", sequences=["plane"], size_wh=(64, 48), supersample=1)
    assert pair.camera1.size_wh == (64, 48)
    assert pair.R.shape == (3, 3)


def test_rendered_planes_carry_homographies():
    pair = next(pairs("planes", size_wh=(48, 32)))
    assert pair.dataset == "planes"
    assert pair.H.shape == (3, 3)


@pytest.mark.data
def test_shared_oxford_and_strecha(data_dir):
    assert len(list(pairs("oxford", data_dir))) == 40
    first = next(iter(pairs("strecha", data_dir)))
    assert first.name == "0000-0001"
    assert abs(np.linalg.det(first.R) - 1) < 1e-5


def test_pairs_of_a_sequence_more_than_half_its_length_apart(tmp_path):
    """A step of 2 in three photographs leaves one pair, a step of 3 none."""
    sequence = tmp_path / "strecha" / "wall"
    (sequence / "images").mkdir(parents=True)
    (sequence / "gt_dense_cameras").mkdir()
    for k in range(3):
        Image.new("RGB", (8, 6)).save(sequence / "images" / f"{k}.png")
        rows = [
            [9, 0, 3.5],
            [0, 9, 2.5],
            [0, 0, 1],
            [0, 0, 0],
            *np.eye(3).tolist(),
            [k, 0, 0],
            [8, 6],
        ]
        text = "\n".join(" ".join(map(str, row)) for row in rows)
        (sequence / "gt_dense_cameras" / f"{k}.png.camera").write_text(text)
    (pair,) = strecha(tmp_path, ["wall"], step=2)
    assert pair.name == "0-2"
    np.testing.assert_array_equal(pair.t, [-2, 0, 0])
    with pytest.raises(InputError, match="pairs 3 apart take 4"):
        list(strecha(tmp_path, ["wall"], step=3))
