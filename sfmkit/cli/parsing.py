"""Values of command-line options."""

from __future__ import annotations

import re

import click

_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}


def names(
    _ctx: click.Context, _param: click.Parameter, value: str | None
) -> tuple[str, ...] | None:
    """``"a, b"`` as ``("a", "b")``; an option that was not given stays None."""
    return (
        None if value is None else tuple(part.strip() for part in value.split(",") if part.strip())
    )


def size_in_bytes(_ctx: click.Context, _param: click.Parameter, value: str) -> int:
    """``"8GB"`` as 8,000,000,000."""
    found = re.fullmatch(r"\s*([0-9.]+)\s*([KMGT]?)B?\s*", value.upper())
    try:
        size = round(float(found[1]) * _UNITS[found[2]]) if found else 0
    except ValueError:
        size = 0
    if size <= 0:
        raise click.BadParameter(f"{value!r} is no size; write, for instance, 8GB or 500MB")
    return size
