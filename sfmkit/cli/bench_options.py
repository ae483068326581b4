"""Options that the benchmarks share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from .parsing import matchers, names, parse_shard

__all__ = [
    "BACKEND",
    "DATA",
    "MATCHER",
    "MAX_SIZE",
    "OPERATORS",
    "OUT",
    "PRESET",
    "PRESETS",
    "ROOT",
    "SEEDS",
    "SHARD",
    "SOURCES",
]

MATCHER = click.option(
    "--matcher",
    "matchers",
    multiple=True,
    callback=matchers,
    metavar="[OPERATOR=]NAME",
    help="Matcher of all operators or of one, by name or import path. Repeatable.",
)
BACKEND = click.option(
    "--backend",
    metavar="NAME",
    help="Robust estimator, by name or import path.  [default: the preset's]",
)
OPERATORS = click.option(
    "--operators",
    default="surf,orb,fast-brief",
    show_default=True,
    callback=names,
    help="Operators, comma-separated: names or import paths package.module:name. Each runs alone, "
    "and all together.",
)
DATA = click.option(
    "--data",
    type=click.Path(path_type=Path),
    help="Folder of the data sets; default: SFMKIT_DATA, or the folder of `sfmkit data fetch`.",
)
SOURCES = click.option(
    "--data",
    "sources",
    metavar="A,B",
    callback=names,
    required=True,
    help="Pair lists, folders, COLMAP models, data sets (sequences: oxford:graf+wall) or import "
    "paths.",
)
ROOT = click.option(
    "--root",
    type=click.Path(path_type=Path),
    help="Folder of the data sets; for a list or a COLMAP model, the folder of its images.",
)
PRESET = click.option(
    "--preset",
    type=click.Choice(["default", "dense", "paper"]),
    default="default",
    show_default=True,
)


def SEEDS(default: int) -> Callable:
    """Make the option --seeds with a default."""
    return click.option(
        "--seeds",
        type=click.IntRange(1, 10_000),
        default=default,
        show_default=True,
        metavar="N",
        help="Every estimate is repeated with seeds 0 to N - 1.",
    )


def PRESETS(default: str) -> Callable:
    """Make the option --presets with a default."""
    return click.option(
        "--presets", default=default, show_default=True, callback=names, help="Presets to compare."
    )


MAX_SIZE = click.option(
    "--max-size",
    type=click.IntRange(16, 100_000),
    metavar="PX",
    help="Detect on images reduced to this longest side.",
)
SHARD = click.option(
    "--shard",
    callback=parse_shard,
    metavar="I/N",
    help="Only part I of N of the pairs. Run the command without it, with the same --out, to "
    "collect all parts.",
)


def OUT(name: str) -> Callable:
    """Make the option --out with a default."""
    return click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=Path("out") / name,
        show_default=True,
        help="Folder to write.",
    )
