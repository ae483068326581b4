"""``sfmkit reconstruct``, ``sfmkit demo`` and ``sfmkit operators``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal

import click

from .._utils.writing import check_free
from .exit_status import OK, UNTRUSTWORTHY
from .parsing import POSITIVE, SEED, names
from .parsing import matchers as parse_matchers
from .progress import progress

OPERATORS = "surf,orb,fast-brief"


@click.command()
@click.argument("image1")
@click.argument("image2")
@click.option(
    "--intrinsics",
    help="K of image 1 (and 2): a file, or fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]. Default: EXIF.",
)
@click.option("--intrinsics2", help="K of image 2, if it has another camera.")
@click.option(
    "--operators",
    default=OPERATORS,
    show_default=True,
    callback=names,
    help="Operators, comma-separated: names (see `sfmkit operators`), detector+descriptor, or "
    "import paths package.module:name.",
)
@click.option(
    "--matcher",
    "matchers",
    multiple=True,
    callback=parse_matchers,
    metavar="[OPERATOR=]MATCHER",
    help="Matcher of all operators, or of one; a name or an import path. Repeatable.",
)
@click.option(
    "--preset",
    type=click.Choice(["default", "dense", "paper"]),
    default="default",
    show_default=True,
    help="Best settings, settings for more points in more time, or those of the paper.",
)
@click.option(
    "--backend",
    metavar="NAME",
    help="Robust estimator: torch, opencv, poselib, pycolmap, a plug-in or an import path; "
    "default: the preset's.",
)
@click.option(
    "--threshold", type=POSITIVE, metavar="PX", help="Inlier distance to the epipolar line, pixels."
)
@click.option(
    "--focal",
    type=click.Choice(["estimate", "fixed"]),
    help="Estimate a focal length that is guessed, or about which EXIF disagrees, from the "
    "matches, or keep it.  [default: the preset's]",
)
@click.option(
    "--budget",
    type=click.IntRange(1, 10_000_000),
    metavar="N",
    help="Keypoints per operator and image, spread evenly.  [default preset: 40000, dense: 80000]",
)
@click.option(
    "--max-size",
    type=click.IntRange(16, 100_000),
    metavar="PX",
    help="Detect on images reduced to this longest side.",
)
@click.option(
    "--device",
    metavar="NAME",
    help="Torch device of detection, matching and the robust search, such as cuda.  [default: cpu]",
)
@click.option(
    "--truth", help="True pose to compare with: JSON with R and t, or two .camera files A,B."
)
@click.option("--seed", type=SEED, default=0, show_default=True)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/reconstruction"),
    show_default=True,
    help="Folder to write.",
)
@click.option("--overwrite", is_flag=True, help="Replace the folder if it exists.")
@click.option("--colmap", is_flag=True, help="Also write a COLMAP text model.")
@click.option(
    "--pictures/--no-pictures",
    default=True,
    show_default=True,
    help="Write matches.png and cloud.png.",
)
@click.option(
    "--rrd/--no-rrd",
    default=True,
    show_default=True,
    help="Write recording.rrd for the Rerun viewer.",
)
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def reconstruct(
    image1: str,
    image2: str,
    intrinsics: str | None,
    intrinsics2: str | None,
    operators: tuple[str, ...],
    matchers: str | dict[str, str] | None,
    preset: str,
    backend: str | None,
    threshold: float | None,
    focal: Literal["estimate", "fixed"] | None,
    budget: int | None,
    max_size: int | None,
    device: str | None,
    truth: str | None,
    seed: int,
    out: Path,
    overwrite: bool,
    colmap: bool,
    pictures: bool,
    rrd: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Reconstruct a scene from the photographs IMAGE1 and IMAGE2.

    The command writes report.json, matches.npz, cloud.ply, pictures and recording.rrd to the folder
    --out. Exit status: 0 done, 1 no trustworthy geometry (the report states why), 2 bad input.
    """
    check_free(out, overwrite)
    with progress(enabled=not quiet and not as_json) as say:
        say("start", "loading libraries")
        from ..io.truth import read_truth
        from ..options import adjust_preset
        from ..pipeline.reconstruction import reconstruct as run
        from ..reports.outputs import write_outputs

        pose = None if truth is None else read_truth(truth, Path(image1), Path(image2))
        options = adjust_preset(
            preset,
            backend=backend,
            threshold_px=threshold,
            budget=budget,
            max_size=max_size,
            focal=focal,
        )
        result = run(
            image1,
            image2,
            intrinsics,
            operators,
            camera2=intrinsics2,
            matchers=matchers,
            options=options,
            device=device,
            seed=seed,
            truth=pose,
            progress=say,
        )
        say("write", str(out))
        report = write_outputs(
            result, out, overwrite=overwrite, colmap=colmap, recording=rrd, pictures=pictures
        )
    if as_json:
        import json

        click.echo(json.dumps(report, indent=1))
    elif not quiet:
        from .summary import print_summary

        print_summary(report, out)
    sys.exit(OK if result.trustworthy else UNTRUSTWORTHY)


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    help="Folder to write.",
)
@click.option(
    "--preset",
    type=click.Choice(["default", "dense", "paper"]),
    default="default",
    show_default=True,
)
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
@click.pass_context
def demo(ctx: click.Context, out: Path, **printed: Any) -> None:
    """Reconstruct the bundled pair, whose true pose is known. Replaces the folder --out."""
    from ..datasets.synthetic import demo_pair

    image1, image2, truth = map(str, demo_pair())
    ctx.invoke(
        reconstruct,
        image1=image1,
        image2=image2,
        intrinsics=truth,
        truth=truth,
        operators=tuple(OPERATORS.split(",")),
        matchers=None,
        out=out,
        overwrite=True,
        **printed,
    )


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def operators(as_json: bool) -> None:
    """List the feature operators, their descriptors, and whether they are available here."""
    from ..features import list_operators
    from .summary import print_operators

    rows = list_operators()
    if as_json:
        import json
        from dataclasses import asdict

        click.echo(json.dumps([asdict(row) for row in rows], indent=1))
    else:
        print_operators(rows)
