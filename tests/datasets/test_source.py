"""What a text after ``--data`` names."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from PIL import Image

from sfmkit.datasets import DATASETS, Pair, find_source, pairs, register_dataset
from sfmkit.datasets.colmap import colmap
from sfmkit.errors import InputError


def my_pairs(root, sequences=None):
    image = np.zeros((8, 8), np.uint8)
    for name in sequences or ("a", "b"):
        yield Pair("mine", name, str(root), image, image)


@pytest.fixture
def images(tmp_path):
    for k in (9, 10, 11):
        Image.new("RGB", (100, 80)).save(tmp_path / f"im{k}.png")
    return tmp_path


def test_a_registered_function_and_an_import_path_are_data_sets(tmp_path, monkeypatch):
    register_dataset("mine", my_pairs)
    try:
        assert [p.sequence for p in pairs("mine")] == ["a", "b"]
        assert [p.name for p in pairs("mine:b", tmp_path)] == [str(tmp_path)]
    finally:
        DATASETS.unregister("mine")
    with pytest.raises(InputError, match="unknown data set 'mine'"):
        find_source("mine")
    (tmp_path / "plugged_in_pairs.py").write_text(
        "def read(root, sequences=None):\n    return [sequences]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    source = find_source("plugged_in_pairs:read:a+b")
    assert source.sequences == ("a", "b")
    with pytest.raises(InputError, match="yields a tuple, not a Pair"):
        source.pairs()
    sys.modules.pop("plugged_in_pairs")
    with pytest.raises(InputError, match="cannot load data set 'no_such_module:read'"):
        find_source("no_such_module:read")


def test_a_folder_of_photographs_in_natural_order(images):
    assert [p.name for p in pairs(images)] == ["im9-im10", "im10-im11"]
    assert [p.name for p in pairs(f"{images}:all")] == ["im9-im10", "im9-im11", "im10-im11"]
    with pytest.raises(InputError, match="'consecutive' or 'all', not 'some'"):
        list(pairs(f"{images}:some"))


def model(folder, names, cameras="1 PINHOLE 100 80 90 91 50 40\n", head="# a comment\n\n"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text("\ufeff" + cameras, encoding="utf-8")
    lines = "".join(f"{i} 1 0 0 0 {i} 0 0 1 {name}\n\n" for i, name in enumerate(names))
    (folder / "images.txt").write_text("\ufeff" + head + lines, encoding="utf-8")
    return folder


def test_a_colmap_model_is_found_with_its_images(images):
    model(images / "p/sparse/0", ["im11.png", "im 10.png", "im9.png"])
    (images / "p/images").mkdir()
    for name in ("im9.png", "im11.png"):
        (images / name).rename(images / "p/images" / name)
    (images / "im10.png").rename(images / "p/images/im 10.png")
    found = list(pairs(images / "p"))
    assert [p.name for p in found] == [
        "im9-im11",
        "im11-im 10",
    ]
    assert all(p.R is not None and p.camera1.K[0, 2] == 49.5 for p in found)
    assert len(list(pairs(f"{images / 'p'}:all"))) == 3


def test_an_unused_camera_of_an_unknown_model_does_not_matter(images):
    cameras = "1 FULL_OPENCV 100 80 90 91 50 40 .1 .2 .3 .4 .5 0 0 0\n2 FOV 100 80 90 91 50 40 .1\n"
    found = list(colmap(model(images / "m", ["im9.png", "im10.png"], cameras), images=images))
    np.testing.assert_array_equal(found[0].camera1.distortion[:5], [0.1, 0.2, 0.3, 0.4, 0.5])


@pytest.mark.parametrize(
    "names, cameras, message",
    [
        (["../im9.png", "im10.png"], None, "line 3: .*leads out"),
        (["/etc/passwd", "im10.png"], None, "leads out"),
        (["im9.png", "im10.png"], "1 PINHOLE 100 80 90 91 50\n", "has 4 parameters, not 3"),
        (["im9.png", "im10.png"], "2 PINHOLE 100 80 90 91 50 40\n", "there is no camera 1"),
        (["im9.png", "im10.png"], "1 PINHOLE 100 x 90 91 50 40\n", "cameras.txt, line 1"),
        (["im9.png", "im9.png"], None, "listed twice"),
        (["im9.png", "im99.png"], None, "im99.png, which is not in"),
        (["im9.png"], None, "holds 1 photographs"),
    ],
)
def test_malformed_models_are_refused(images, names, cameras, message):
    folder = model(images / "m", names, *([cameras] if cameras else []))
    with pytest.raises(InputError, match=message):
        list(colmap(folder, images=images))
