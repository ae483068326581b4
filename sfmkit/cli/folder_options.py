"""The options that ``sfmkit pairs`` and ``sfmkit map`` share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from .parsing import POSITIVE, SEED, matchers, names
from .work_options import CACHE, CACHE_SIZE, SCHEDULER, WAIT, WORKERS

if TYPE_CHECKING:
    from ..mapping import MatchedFolder
    from ..mapping.planning import FolderPlan

__all__ = ["folder_options", "match", "print_pairs"]

F = TypeVar("F", bound=Callable)


def intrinsics(
    _ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> dict[str, str] | None:
    """``("K.txt", "left=L.txt")`` as ``{"": "K.txt", "left": "L.txt"}``."""
    found: dict[str, str] = {}
    for value in values:
        subfolder, equals, text = value.partition("=")
        subfolder, text = (subfolder.strip().strip("/"), text) if equals else ("", value)
        if subfolder in found:
            raise click.BadParameter(f"two intrinsics for {subfolder or 'all photographs'}")
        found[subfolder] = text
    return found or None


_OPTIONS = (
    click.argument("folder", type=click.Path(path_type=Path)),
    click.option(
        "--intrinsics",
        multiple=True,
        callback=intrinsics,
        metavar="[SUBFOLDER=]K",
        help="K of all photographs, or of those of a subfolder: a file, fx,fy,cx,cy[,k1,...] or "
        "24mm/36mm. Repeatable. Default: EXIF.",
    ),
    click.option(
        "--operators",
        default="surf,orb,fast-brief",
        show_default=True,
        callback=names,
        help="Operators, comma-separated: names, detector+descriptor, or import paths.",
    ),
    click.option(
        "--matcher",
        "chosen_matchers",
        multiple=True,
        callback=matchers,
        metavar="[OPERATOR=]MATCHER",
        help="Matcher of all operators, or of one. Repeatable.",
    ),
    click.option(
        "--preset",
        type=click.Choice(["default", "dense", "paper"]),
        default="default",
        show_default=True,
    ),
    click.option("--backend", metavar="NAME", help="Robust estimator.  [default: the preset's]"),
    click.option(
        "--threshold", type=POSITIVE, metavar="PX", help="Inlier distance to the epipolar line."
    ),
    click.option(
        "--budget",
        type=click.IntRange(1, 10_000_000),
        metavar="N",
        help="Keypoints per operator and photograph.  [default preset: 40000]",
    ),
    click.option(
        "--max-size",
        type=click.IntRange(16, 100_000),
        metavar="PX",
        help="Detect on photographs reduced to this longest side.",
    ),
    click.option(
        "--pairs",
        "rules",
        default="auto",
        show_default=True,
        metavar="RULES",
        help="all, sequential:W, gps:K, similar:K, or several joined by +. auto: all up to 40 "
        "photographs.",
    ),
    click.option(
        "--descriptor",
        default="sift",
        show_default=True,
        metavar="OPERATOR",
        help="Operator whose features decide how similar photographs are.",
    ),
    click.option(
        "--masks",
        type=click.Path(path_type=Path),
        help="Folder of masks, black where keypoints are not used: a.jpg.png or a.png for a.jpg.",
    ),
    click.option("--seed", type=SEED, default=0, show_default=True),
    WORKERS,
    SCHEDULER,
    WAIT,
    CACHE,
    CACHE_SIZE,
    click.option("--overwrite", is_flag=True, help="Replace the folder --out if it exists."),
    click.option("--quiet", is_flag=True, help="Print nothing but errors."),
)


def folder_options(command: F) -> F:
    """Add the argument FOLDER and the shared options to a command."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def match(
    watch: Any,
    shard: tuple[int, int] | None = None,
    check: Callable[[FolderPlan], None] | None = None,
    **given: Any,
) -> MatchedFolder:
    """Match a folder as the options say.

    Args:
        watch: Called with the progress.
        shard: Part of the pairs.
        check: Called with the plan before the work.
        given: The values of the options.
    """
    from ..mapping import Workshop, match_folder
    from ..options import adjust_preset

    workshop = Workshop.of(
        given["cache"],
        given["cache_size"],
        given["workers"],
        given["scheduler"],
        given["wait"],
        watch,
    )
    return match_folder(
        given["folder"],
        intrinsics=given["intrinsics"],
        operators=given["operators"],
        matchers=given["chosen_matchers"],
        options=adjust_preset(
            given["preset"],
            backend=given["backend"],
            threshold_px=given["threshold"],
            budget=given["budget"],
            max_size=given["max_size"],
        ),
        pairs=given["rules"],
        descriptor=given["descriptor"],
        masks=given["masks"],
        seed=given["seed"],
        shard=shard,
        check=check,
        workshop=workshop,
    )


def print_pairs(report: dict[str, Any]) -> None:
    """Print what was found in a folder."""
    found = ", ".join(f"{n:,} {verdict}" for verdict, n in report["verdicts"].items())
    click.echo(f"{report['photographs']:,} photographs, {report['pairs']:,} pairs: {found}")
    if report["skipped"]:
        click.echo(f"{len(report['skipped']):,} files were skipped:")
        for name, reason in list(report["skipped"].items())[:5]:
            click.echo(f"  {name}: {reason}")
    for warning in report["warnings"][:5]:
        click.echo(f"warning: {warning}")
    parts = report["connected_parts"]
    if len(parts) > 1:
        click.echo(
            f"the pairs connect {parts[0]:,} photographs; {sum(parts[1:]):,} are in "
            f"{len(parts) - 1:,} other parts"
        )
