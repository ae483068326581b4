"""``sfmkit inspect`` and ``sfmkit view``: recordings as text and in the viewer."""

from __future__ import annotations

from math import isfinite
from pathlib import Path

import click

from ..errors import InputError
from .parsing import PREFIX

__all__ = ["inspect", "view"]

RECORDING = click.Path(path_type=Path)


@click.command()
@click.argument("recording", type=RECORDING)
@click.option(
    "--point",
    type=click.IntRange(0, 2**63 - 1),
    metavar="N",
    help="Print the origin of point N of the cloud.",
)
@click.option(
    "--pixel",
    metavar="X,Y",
    help="Print the keypoints near a pixel of image 1 (or --image), and what became of each.",
)
@click.option(
    "--image", type=click.IntRange(1, 2), default=None, help="Image of --pixel.  [default: 1]"
)
@click.option(
    "--match",
    type=click.IntRange(0, 2**63 - 1),
    metavar="N",
    help="Print how fused match N was found and what became of it.",
)
@click.option(
    "--rejected",
    is_flag=True,
    help="Print why keypoints and matches were rejected, with examples; --operator selects one.",
)
@click.option("--operator", metavar="NAME", help="Print the statistics of one operator.")
@click.option(
    "--entity", metavar="PATH", help="Print the contents of an entity, e.g. /world/points/operator."
)
@click.option(
    "--diff",
    type=RECORDING,
    metavar="OTHER",
    help="Print the differences between RECORDING and OTHER.",
)
@PREFIX
def inspect(
    recording: Path,
    point: int | None,
    pixel: str | None,
    image: int | None,
    match: int | None,
    rejected: bool,
    operator: str | None,
    entity: str | None,
    diff: Path | None,
    prefix: str,
) -> None:
    """Print the contents of a recording (.rrd).

    Without an option, these are verdict, pose, statistics per operator and times.
    """
    alone = None if rejected else operator
    asked = (point, pixel, match, rejected or None, alone, entity, diff)
    if sum(question is not None for question in asked) > 1:
        raise InputError(
            "use one of --point, --pixel, --match, --rejected, --operator, --entity and --diff at "
            "a time"
        )
    if image is not None and pixel is None:
        raise InputError("--image needs --pixel X,Y")
    x, y = _pixel(pixel) if pixel is not None else (0.0, 0.0)
    from ..recording import inspection

    if point is not None:
        answer = inspection.describe_point(recording, point, prefix)
    elif pixel is not None:
        answer = inspection.describe_pixel(recording, x, y, image or 1, prefix)
    elif match is not None:
        answer = inspection.describe_match(recording, match, prefix)
    elif rejected:
        answer = inspection.describe_rejected(recording, operator, prefix)
    elif operator is not None:
        answer = inspection.describe_operator(recording, operator, prefix)
    elif entity is not None:
        answer = inspection.describe_entity(recording, entity)
    elif diff is not None:
        answer = inspection.diff_recordings(recording, diff, prefix)
    else:
        answer = inspection.describe_recording(recording)
    click.echo(answer)


def _pixel(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--pixel takes two numbers X,Y, not {text!r}") from None
    if not (isfinite(x) and isfinite(y)):
        raise InputError(f"--pixel takes finite numbers, not {text!r}")
    return x, y


@click.command()
@click.argument("recording", type=RECORDING)
@click.option(
    "--web",
    is_flag=True,
    help="Serve the viewer to a browser on this machine; no display is needed.",
)
def view(recording: Path, web: bool) -> None:
    """Open a recording (.rrd) in the Rerun viewer of this environment.

    The viewer listens on 127.0.0.1 only.
    """
    from ..recording import viewer

    if not web:
        viewer.open_window(recording)
        return
    with viewer.serve(recording) as server:
        click.echo(f"{server.url}\nPress Ctrl-C to stop the server.")
        click.echo(
            f"From another machine: ssh -L {server.web_port}:127.0.0.1:{server.web_port} "
            f"-L {server.data_port}:127.0.0.1:{server.data_port} HOST",
            err=True,
        )
        server.wait()
