"""Parts of a list of pairs."""

from __future__ import annotations

import pytest

from sfmkit._utils.sharding import part_of
from sfmkit.errors import InputError


def test_parts_are_consecutive_and_cover_everything():
    numbers = list(range(10))
    parts = [part_of(numbers, (k, 4)) for k in (1, 2, 3, 4)]
    assert [n for part in parts for n in part] == numbers
    assert {len(part) for part in parts} == {2, 3}
    with pytest.raises(InputError, match="10 pairs cannot be split into 11 shards"):
        part_of(numbers, (1, 11))
    with pytest.raises(InputError, match="1 <= i <= n"):
        part_of(numbers, (0, 2))
