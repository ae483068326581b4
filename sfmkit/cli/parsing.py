"""Values of command-line options."""

from __future__ import annotations

import math
import re
from typing import Any

import click

__all__ = ["POSITIVE", "SEED", "Finite", "matchers", "names", "parse_shard", "size_in_bytes"]

SEED = click.IntRange(0, 2**31 - 1)  # range of all back ends; OpenCV takes a C int

_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}


class Finite(click.FloatRange):
    """A number in a range; infinity and NaN are refused."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


POSITIVE = Finite(min=0, min_open=True)


def names(
    _ctx: click.Context, _param: click.Parameter, value: str | None
) -> tuple[str, ...] | None:
    """Split ``"a, b"`` into ``("a", "b")``; None if the option was not given."""
    if value is None:
        return None
    return tuple(part.strip() for part in value.split(",") if part.strip())


def size_in_bytes(_ctx: click.Context, _param: click.Parameter, value: str) -> int:
    """Convert ``"8GB"`` to 8,000,000,000."""
    found = re.fullmatch(r"\s*([0-9.]+)\s*([KMGT]?)B?\s*", value.upper())
    try:
        size = round(float(found[1]) * _UNITS[found[2]]) if found else 0
    except (ValueError, OverflowError):
        size = 0
    if not 0 < size < 2**63:
        raise click.BadParameter(f"{value!r} is not a size; write, for instance, 8GB or 500MB")
    return size


def matchers(
    _ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> str | dict[str, str] | None:
    """Convert ``("lightglue",)`` to text and ``("a", "surf=b")`` to ``{"*": "a", "surf": "b"}``.

    None if the option was not given.
    """
    chosen: dict[str, str] = {}
    for value in values:
        operator, matcher = _two_names(value) if "=" in value else ("*", value.strip())
        if chosen.setdefault(operator, matcher) != matcher:
            whose = "all operators" if operator == "*" else operator
            raise click.BadParameter(
                f"two matchers for {whose}: {chosen[operator]}, {matcher}; "
                "write OPERATOR=MATCHER for one operator"
            )
    return chosen["*"] if [*chosen] == ["*"] else chosen or None


def _two_names(value: str) -> tuple[str, str]:
    operator, _, matcher = (part.strip() for part in value.partition("="))
    if not operator or not matcher or "=" in matcher:
        raise click.BadParameter(f"{value!r} is not of the form OPERATOR=MATCHER")
    return operator, matcher


def parse_shard(
    _ctx: click.Context, _param: click.Parameter, value: str | None
) -> tuple[int, int] | None:
    """Convert ``"2/4"`` to ``(2, 4)``."""
    if value is None:
        return None
    found = re.fullmatch(r"\s*([0-9]{1,6})\s*/\s*([0-9]{1,6})\s*", value)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise click.BadParameter(f"{value!r} is not I/N with 1 <= I <= N, such as 2/4")
    return int(found[1]), int(found[2])


def entity_prefix(_ctx: click.Context, _param: click.Parameter, value: str) -> str:
    """Convert ``"a/b/"`` to ``"/a/b"``, and the root to an empty text."""
    return f"/{value.strip('/')}" if value.strip("/") else ""


PREFIX = click.option(
    "--prefix",
    default="",
    metavar="PATH",
    callback=entity_prefix,
    help="Entity path under which the reconstruction was logged; default: the root.",
)
