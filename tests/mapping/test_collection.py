"""A folder of photographs: what is used, what is left out, which camera and which pairs."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import PIL.Image
import pytest

from sfmkit.errors import CameraError, InputError
from sfmkit.mapping import read_collection
from sfmkit.mapping.choice import (
    choose_pairs,
    default_choice,
    local_positions,
    most_similar,
    nearest_in_space,
    parse_choice,
    sequential_pairs,
)
from sfmkit.mapping.shared_cameras import choose_shared_cameras


def write(path, *, size=(40, 30), seed=0, exif=None):
    """Write a small photograph of noise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), np.uint8)
    PIL.Image.fromarray(pixels).save(path, **({} if exif is None else {"exif": exif}))


def tags(*, orientation=1, latitude=None, longitude=None, focal_35=None):
    """EXIF with an orientation, a position and a focal length."""
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    if latitude is not None:
        gps = {1: "N" if latitude >= 0 else "S", 3: "E" if longitude >= 0 else "W"}
        gps[2], gps[4] = (
            (abs(int(v)), abs(v) % 1 * 60 // 1, round(abs(v) * 60 % 1 * 60, 6))
            for v in (latitude, longitude)
        )
        exif[0x8825] = gps
    if focal_35 is not None:
        exif[0x8769] = {0xA405: focal_35}
    return exif


def test_photographs_come_in_natural_order_with_their_subfolders(tmp_path):
    for k, name in enumerate(("b/im10.png", "b/im9.png", "a/x.png", ".hidden/y.png", "b/.z.png")):
        write(tmp_path / name, seed=k)
    (tmp_path / "notes.txt").write_text("not an image")
    assert read_collection(tmp_path).names == ["a/x.png", "b/im9.png", "b/im10.png"]


def test_copies_and_unreadable_files_are_left_out_with_a_reason(tmp_path):
    for k in range(3):
        write(tmp_path / f"{k}.png", seed=k)
    (tmp_path / "copy.png").write_bytes((tmp_path / "1.png").read_bytes())
    (tmp_path / "text.jpg").write_text("no photograph")
    (tmp_path / "empty.png").write_bytes(b"")
    found = read_collection(tmp_path)
    assert found.names == ["0.png", "1.png", "2.png"]
    assert set(found.skipped) == {"copy.png", "text.jpg", "empty.png"}
    assert found.skipped["copy.png"] == "a copy of 1.png"


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_photographs_are_refused(tmp_path, count):
    for k in range(count):
        write(tmp_path / f"{k}.png")
        (tmp_path / "copy.png").write_bytes((tmp_path / f"{k}.png").read_bytes())
    with pytest.raises(InputError, match=f"holds {count} usable photographs"):
        read_collection(tmp_path)


def test_sizes_are_upright_and_bytes_are_hashed_when_a_photograph_is_used(tmp_path):
    write(tmp_path / "a.jpg", exif=tags(orientation=6))
    write(tmp_path / "b.jpg", seed=1)
    found = read_collection(tmp_path)
    assert [p.size_wh for p in found.photographs] == [(30, 40), (40, 30)]
    assert not found._refs
    assert found.ref(0).size_wh == (30, 40)
    assert len(found._refs) == 1


def test_masks_are_found_by_both_names_and_a_folder_without_any_is_refused(tmp_path):
    for k, name in enumerate(("s/a.jpg", "s/b.jpg", "c.jpg")):
        write(tmp_path / "i" / name, seed=k)
    write(tmp_path / "m/s/a.jpg.png")
    write(tmp_path / "m/s/b.png")
    found = read_collection(tmp_path / "i", masks=tmp_path / "m")
    masks = {p.name: p.mask and p.mask.name for p in found.photographs}
    assert masks == {"s/a.jpg": "a.jpg.png", "s/b.jpg": "b.png", "c.jpg": None}
    with pytest.raises(InputError, match="has no mask"):
        read_collection(tmp_path / "i", masks=tmp_path / "i")


def test_photographs_of_one_origin_share_a_camera(tmp_path):
    for k in range(2):
        write(tmp_path / f"left/{k}.jpg", seed=k, exif=tags(focal_35=26))
        write(tmp_path / f"right/{k}.jpg", seed=10 + k, exif=tags(focal_35=52))
    write(tmp_path / "right/2.jpg", size=(30, 40), seed=20, exif=tags(focal_35=52))
    found = read_collection(tmp_path)
    cameras = choose_shared_cameras(found)
    assert cameras.of_photograph == (0, 0, 1, 1, 2)
    focal = [camera.K[0, 0] for camera in cameras.cameras]
    assert focal[1] == pytest.approx(2 * focal[0])
    assert focal[2] == pytest.approx(focal[1])


def test_given_intrinsics_hold_for_their_subfolder(tmp_path):
    for k, name in enumerate(("left/a.png", "left/b.png", "right/a.png", "c.png")):
        write(tmp_path / name, seed=k)
    found = read_collection(tmp_path)
    cameras = choose_shared_cameras(found, {"": "50,50,19.5,14.5", "right": "60,60,19.5,14.5"})
    by_name = {p.name: cameras[k].K[0, 0] for k, p in enumerate(found.photographs)}
    assert by_name == {"c.png": 50, "left/a.png": 50, "left/b.png": 50, "right/a.png": 60}
    with pytest.raises(InputError, match="'middle', which has no photographs"):
        choose_shared_cameras(found, {"middle": "50,50,19.5,14.5"})
    with pytest.raises(CameraError, match=r"c\.png"):
        choose_shared_cameras(found, "50,50,999,14.5")


def test_sequential_pairs_stay_within_a_subfolder():
    pairs = sequential_pairs(["a", "a", "a", "b", "b"], 2)
    assert sorted(map(tuple, pairs.tolist())) == [(0, 1), (0, 2), (1, 2), (3, 4)]


def test_positions_of_exif_are_metres_and_neighbours_are_the_nearest(tmp_path):
    places = [(41.5, -83.5), (41.5001, -83.5), (41.5, -83.4999), (41.51, -83.5)]
    for k, (latitude, longitude) in enumerate(places):
        exif = tags(latitude=latitude, longitude=longitude)
        write(tmp_path / f"{k}.jpg", seed=k, exif=exif)
    found = read_collection(tmp_path)
    xyz = local_positions(found)
    # one degree of latitude and of longitude at 41.5 degrees on the WGS 84 ellipsoid, m
    assert xyz[1, 1] - xyz[0, 1] == pytest.approx(111_069e-4, rel=1e-3)
    assert xyz[2, 0] - xyz[0, 0] == pytest.approx(83_497e-4, rel=1e-3)
    assert nearest_in_space(xyz, 1).tolist() == [[0, 1], [0, 2], [1, 3]]
    assert str(default_choice(found)[0]) == "all"
    xyz[:] = np.nan
    with pytest.raises(InputError, match="0 photographs have a GPS position"):
        nearest_in_space(xyz, 1)


def test_rules_are_joined_and_the_most_similar_are_chosen(tmp_path):
    for k in range(4):
        write(tmp_path / f"{k}.png", seed=k)
    found = read_collection(tmp_path)
    similarity = np.eye(4)
    similarity[0, 3] = similarity[3, 0] = 0.9
    similarity[1, 2] = similarity[2, 1] = 0.8
    assert most_similar(similarity, 1).tolist() == [[0, 3], [1, 2]]
    rules = parse_choice("sequential:1 + similar:1")
    pairs = choose_pairs(rules, found, lambda: similarity)
    assert pairs.tolist() == [[0, 1], [0, 3], [1, 2], [2, 3]]


@pytest.mark.parametrize("text", ["", "some", "all:3", "gps:0", "sequential:-1", "all,gps"])
def test_unknown_rules_are_refused(text):
    with pytest.raises(InputError):
        parse_choice(text)


def test_two_thousand_photographs_are_planned_without_reading_them(tmp_path):
    """Measured: 0.5 s of processor time and 6.5 MB for 2,000 files, without tracing."""
    from sfmkit.mapping.matched_folder import Workshop, plan_folder
    from sfmkit.mapping.planning import make_recipe

    write(tmp_path / "0.jpg", exif=tags(focal_35=26))
    data = (tmp_path / "0.jpg").read_bytes()
    for k in range(2_000):
        (tmp_path / f"{k}.jpg").write_bytes(data + k.to_bytes(2, "big"))
    recipe, workshop = make_recipe(["orb"]), Workshop.of(tmp_path / "cache")
    tracemalloc.start()
    began = time.process_time()
    try:
        found = read_collection(tmp_path)
        plan = plan_folder(found, recipe, workshop, pairs="sequential:10")
        assert plan.seconds() > 0
        assert time.process_time() - began < 10
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()
    assert len(plan) == 2_000 * 10 - 55
    assert len(plan.cameras.cameras) == 1
