"""The description of a sweep: written with a digest, refused when it is damaged."""

from __future__ import annotations

import pytest

from sfmkit.ablation import read_sweep
from sfmkit.ablation.folder import write_sweep
from sfmkit.errors import InputError

CONTENT = {"identity": "x", "pairs": [{"pair": "1-2", "K": [1.5, 2.25]}], "seeds": 1}


def test_what_is_written_is_read(tmp_path):
    write_sweep(tmp_path, CONTENT)
    assert read_sweep(tmp_path) == CONTENT
    with pytest.raises(InputError, match="holds no sweep"):
        read_sweep(tmp_path / "other")


def test_no_flip_of_a_single_bit_changes_what_is_read(tmp_path):
    write_sweep(tmp_path, CONTENT)
    file = tmp_path / "sweep.json"
    good = file.read_bytes()
    for bit in range(8 * len(good)):
        data = bytearray(good)
        data[bit // 8] ^= 1 << bit % 8
        file.write_bytes(data)
        try:
            assert read_sweep(tmp_path) == CONTENT  # white space, for instance
        except InputError:
            continue


@pytest.mark.parametrize(
    "data", [b"\xff\xfe\0", b"[]", b"3", b"{}", b'{"digest": 1}', b"[" * 10**5, b'{"a": ' * 9999]
)
def test_other_files_are_refused(tmp_path, data):
    (tmp_path / "sweep.json").write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_sweep(tmp_path)
