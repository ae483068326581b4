"""``sfmkit bench``: the experiments of the paper, and benchmarks on other data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .bench_options import (
    BACKEND,
    DATA,
    MATCHER,
    MAX_SIZE,
    OPERATORS,
    OUT,
    PRESET,
    PRESETS,
    ROOT,
    SEEDS,
    SHARD,
    SOURCES,
)
from .bench_run import command_line, hand_over, parts_bar
from .parsing import names
from .work_options import WORKERS


@click.group()
def bench() -> None:
    """Repeat the experiments of the paper, or evaluate operators on other data."""


@bench.command()
@click.option(
    "--sequences", callback=names, metavar="A,B", help="Names of sequences; default: all eight."
)
@OPERATORS
@MATCHER
@SEEDS(5)
@WORKERS
@SHARD
@OUT("oxford")
@DATA
def oxford(
    sequences: tuple[str, ...] | None,
    operators: tuple[str, ...],
    matchers: str | dict[str, str] | None,
    seeds: int,
    workers: int | None,
    shard: Any,
    out: Path,
    data: Path | None,
) -> None:
    """Estimate the homographies of the Oxford set.

    The results are Tables 2 to 5 and Figures 7 to 10 of the paper. Run the same command again to
    resume an interrupted run.
    """
    from ..evaluation.oxford import bench_oxford
    from ..evaluation.oxford_tables import oxford_result

    with parts_bar("oxford") as report:
        rows = bench_oxford(
            out,
            data=data,
            sequences=sequences,
            operators=operators,
            matchers=matchers,
            seeds=seeds,
            workers=workers,
            shard=shard,
            progress=report,
        )
    hand_over(out, oxford_result(rows, out, command_line()))


@bench.command()
@click.option(
    "--pairs",
    callback=names,
    metavar="A-B,C-D",
    help="Pairs, such as 0000-0001; default: all neighbours.",
)
@OPERATORS
@MATCHER
@BACKEND
@PRESETS("paper,default,dense")
@SEEDS(3)
@MAX_SIZE
@click.option(
    "--scenes",
    default="courtyard,wide,dish",
    show_default=True,
    callback=names,
    help="Names of rendered scenes; '' for none.",
)
@OUT("fountain")
@DATA
def fountain(
    pairs: tuple[str, ...] | None,
    operators: tuple[str, ...],
    matchers: str | dict[str, str] | None,
    backend: str | None,
    presets: tuple[str, ...],
    seeds: int,
    max_size: int | None,
    scenes: tuple[str, ...],
    out: Path,
    data: Path | None,
) -> None:
    """Measure features, pose and cloud on EPFL fountain-P11.

    The results are Table 6 and Figure 11 of the paper, pose errors with respect to the true
    cameras, and errors of the cloud on rendered scenes. Run the same command again to resume an
    interrupted run.
    """
    from ..evaluation.fountain import bench_fountain
    from ..evaluation.fountain_tables import fountain_result

    with parts_bar("fountain") as report:
        rows = bench_fountain(
            out,
            data=data,
            pairs=pairs,
            operators=operators,
            matchers=matchers,
            backend=backend,
            presets=presets,
            seeds=seeds,
            max_size=max_size,
            scenes=scenes,
            progress=report,
        )
    hand_over(out, fountain_result(rows, out, command_line()))


@bench.command()
@click.option(
    "--sequence", metavar="NAME", help="Name of a folder in uav/; default: the first one."
)
@click.option(
    "--step",
    type=click.IntRange(1, 10_000),
    metavar="N",
    help="Distance of the photographs of a wide pair in the sequence.  [default: 4]",
)
@click.option(
    "--box",
    metavar="X0,Y0,X1,Y1",
    help="Target in pixels of the first photograph; default: its middle third.",
)
@OPERATORS
@MATCHER
@BACKEND
@PRESETS("default,dense")
@MAX_SIZE
@click.option(
    "--colmap/--no-colmap",
    default=True,
    show_default=True,
    help="Also run COLMAP (needs the extra peers).",
)
@click.option(
    "--cloud",
    "clouds",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="PLY",
    help="Cloud of the same scene from another program. Repeatable.",
)
@OUT("uav")
@DATA
def uav(
    sequence: str | None,
    step: int | None,
    box: str | None,
    operators: tuple[str, ...],
    matchers: str | dict[str, str] | None,
    backend: str | None,
    presets: tuple[str, ...],
    max_size: int | None,
    colmap: bool,
    clouds: tuple[Path, ...],
    out: Path,
    data: Path | None,
) -> None:
    """Compare drone reconstructions with COLMAP.

    The results are Tables 7 and 8 of the paper. The pairs have a small shift or a wide baseline.
    Clouds of other programs can be compared too. Run the same command again to resume an
    interrupted run.
    """
    from ..evaluation.uav import bench_uav, open_flight, parse_box
    from ..evaluation.uav_tables import uav_result

    with parts_bar("uav") as report:
        rows = bench_uav(
            out,
            data=data,
            sequence=sequence,
            step=step,
            box=box,
            operators=operators,
            matchers=matchers,
            backend=backend,
            presets=presets,
            max_size=max_size,
            colmap=colmap,
            clouds=clouds,
            progress=report,
        )
    flight = open_flight(data, sequence, step)
    hand_over(
        out, uav_result(rows, flight, parse_box(box, flight.camera.size_wh), out, command_line())
    )


@bench.command("pairs")
@SOURCES
@ROOT
@OPERATORS
@MATCHER
@BACKEND
@PRESET
@SEEDS(1)
@MAX_SIZE
@SHARD
@OUT("pairs")
def pairs_of_any_data(sources: tuple[str, ...], out: Path, **settings: Any) -> None:
    """Run operators on the pairs of any data set.

    Each operator runs alone, and all run together.

    Errors are computed for pairs with ground truth.

    Run the same command again to resume an interrupted run.
    """
    run_pairs("pairs", sources, out, **settings)


def run_pairs(name: str, sources: tuple[str, ...], out: Path, **settings: Any) -> None:
    """Run a benchmark of pairs and write its tables."""
    from ..evaluation.pairs import bench_pairs
    from ..evaluation.pairs_tables import pairs_result

    with parts_bar(name) as report:
        rows = bench_pairs(sources, out, progress=report, **settings)
    hand_over(out, pairs_result(rows, command_line(), name))


@bench.command("pose")
@SOURCES
@ROOT
@OPERATORS
@MATCHER
@BACKEND
@PRESET
@SEEDS(1)
@MAX_SIZE
@SHARD
@OUT("pose")
def relative_pose(sources: tuple[str, ...], out: Path, **settings: Any) -> None:
    """Estimate the poses of pairs with true poses.

    For the lists of the SuperGlue and LightGlue evaluations (ScanNet-1500, YFCC100M,
    MegaDepth-1500), for `phototourism`, and for other data with true poses. Run the same command
    again to resume an interrupted run.
    """
    run_pairs("pose", sources, out, truth="pose", **settings)


@bench.command()
@click.option(
    "--sequences", callback=names, metavar="A,B", help="Names of sequences; default: all."
)
@click.option(
    "--without", callback=names, metavar="A,B", help="Names of sequences that are left out."
)
@OPERATORS
@MATCHER
@PRESET
@SEEDS(1)
@MAX_SIZE
@SHARD
@OUT("hpatches")
@DATA
def hpatches(
    sequences: tuple[str, ...] | None,
    without: tuple[str, ...] | None,
    out: Path,
    data: Path | None,
    **settings: Any,
) -> None:
    """Match the sequences of HPatches and estimate their homographies.

    Run the same command again to resume an interrupted run.
    """
    from .._utils.writing import check_folder
    from ..datasets.hpatches import sequences_of_hpatches

    check_folder(out)
    chosen = sequences_of_hpatches(data, sequences, without)
    source = f"hpatches:{'+'.join(chosen)}"
    run_pairs("hpatches", (source,), out, root=data, truth="homography", **settings)


@bench.command("verdict")
@click.option(
    "--groups",
    callback=names,
    metavar="A,B",
    help="Only groups of pairs whose names start with these, such as fountain or 'across scenes'.",
)
@OPERATORS
@WORKERS
@SHARD
@OUT("verdict")
@DATA
def verdict_of_pairs(
    groups: tuple[str, ...] | None,
    operators: tuple[str, ...],
    workers: int | None,
    shard: Any,
    out: Path,
    data: Path | None,
) -> None:
    """Count the right and wrong poses that are accepted.

    PoseLib, pycolmap and OpenCV run for comparison. Pairs without a solution show different scenes,
    disjoint parts, mirror images or repeated texture. Run the same command again to resume an
    interrupted run.
    """
    from ..evaluation.verdict import bench_verdict
    from ..evaluation.verdict_tables import verdict_result

    with parts_bar("verdict") as report:
        rows = bench_verdict(
            out,
            data=data,
            groups=groups,
            operators=operators,
            workers=workers,
            shard=shard,
            progress=report,
        )
    hand_over(out, verdict_result(rows, out, command_line()))


@bench.command("map")
@click.option(
    "--scenes",
    default="fountain,temple,drone",
    show_default=True,
    callback=names,
    metavar="A,B",
)
@OPERATORS
@MATCHER
@BACKEND
@MAX_SIZE
@click.option(
    "--budget",
    type=click.IntRange(1, 10_000_000),
    default=8_192,
    show_default=True,
    metavar="N",
    help="Keypoints per operator and photograph, also of COLMAP's SIFT.",
)
@click.option(
    "--two-view-points", is_flag=True, help="Keep points that are seen in only two photographs."
)
@WORKERS
@OUT("bench-map")
@DATA
def map_of_many_views(
    scenes: tuple[str, ...],
    operators: tuple[str, ...],
    matchers: str | dict[str, str] | None,
    backend: str | None,
    max_size: int | None,
    budget: int,
    two_view_points: bool,
    workers: int | None,
    out: Path,
    data: Path | None,
) -> None:
    """Map many views with each operator and with SIFT.

    The operators run alone and together, and COLMAP's SIFT for comparison, all with COLMAP's
    mapper. Run the same command again to resume an interrupted run.
    """
    from ..evaluation.maps import bench_map
    from ..evaluation.maps_tables import maps_result

    with parts_bar("map") as report:
        rows = bench_map(
            out,
            data=data,
            scenes=scenes,
            operators=operators,
            matchers=matchers,
            backend=backend,
            max_size=max_size,
            budget=budget,
            two_view_points=two_view_points,
            workers=workers,
            progress=report,
        )
    hand_over(out, maps_result(rows, command_line()))
