"""``sfmkit ablate``: every combination of operators on every pair."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .ablate_merge import merge
from .ablate_report import report
from .parsing import matchers, names, parse_shard
from .progress import resumable
from .work_options import CACHE, CACHE_SIZE, SCHEDULER, WAIT, WORKERS


@click.group(invoke_without_command=True, subcommand_metavar="[COMMAND ...]")
@click.option(
    "--data",
    metavar="A,B",
    callback=names,
    help="Data sets (oxford,strecha,uav,synthetic,planes,...; sequences: oxford:graf+wall), pair "
    "lists, folders, COLMAP models or import paths.",
)
@click.option(
    "--operators", default="surf,orb,fast-brief", show_default=True, callback=names, metavar="A,B"
)
@click.option(
    "--combos",
    default="all",
    show_default=True,
    metavar="all|pairs|leave-one-out|LIST",
    help="Which combinations; a list is surf/orb,sift.",
)
@click.option("--seeds", type=click.IntRange(1, 10_000), default=1, show_default=True, metavar="N")
@click.option(
    "--preset",
    default="default",
    show_default=True,
    callback=names,
    metavar="A,B",
    help="default, dense or paper; several: each of them.",
)
@click.option(
    "--vary",
    multiple=True,
    metavar="NAME=V1,V2",
    help="Values of a setting: of a stage (budget, max_ratio, matcher, backend, threshold_px, ...) "
    "or of an operator (surf.hessian_threshold, or hessian for short). May be repeated: every "
    "combination is run.",
)
@click.option(
    "--matcher",
    "matchers",
    multiple=True,
    callback=matchers,
    metavar="[OPERATOR=]NAME",
    help="Matcher of all operators or of one, by name or import path; may be repeated for several.",
)
@click.option(
    "--backend",
    metavar="NAME",
    help="Robust estimator, by name or import path.  [default: the preset's]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/ablation"),
    show_default=True,
    help="Folder of the sweep.",
)
@click.option(
    "--dry-run", is_flag=True, help="Print what would be done and how long it takes, roughly."
)
@WORKERS
@SCHEDULER
@click.option(
    "--ship",
    type=click.Choice(["path", "bytes"]),
    default="path",
    show_default=True,
    help="The cluster's workers see the same files, or images travel to them and arrays back.",
)
@WAIT
@CACHE
@CACHE_SIZE
@click.option(
    "--root",
    type=click.Path(path_type=Path),
    help="Folder of the data sets; default: SFMKIT_DATA, or what was fetched.",
)
@click.option(
    "--shard",
    callback=parse_shard,
    metavar="I/N",
    help="Only part I of N of the pairs; merge the folders of all parts by `sfmkit ablate merge`.",
)
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.pass_context
def ablate(ctx: click.Context, **options: Any) -> None:
    """Run every combination of operators on every pair of the data sets.

    The result is one table, OUT/ablation.parquet. Detections, matchings and estimates are cached;
    run the same command again to resume an interrupted sweep.

    \b
    sfmkit ablate --data oxford,strecha --operators surf,orb,fast-brief,sift,akaze --seeds 3
    --dry-run
    """
    if ctx.invoked_subcommand is None:
        run(**options)


ablate.add_command(report)
ablate.add_command(merge)


def run(
    data: tuple[str, ...] | None,
    operators: tuple[str, ...],
    combos: str,
    seeds: int,
    preset: tuple[str, ...],
    vary: tuple[str, ...],
    matchers: str | dict[str, str] | None,
    backend: str | None,
    out: Path,
    dry_run: bool,
    workers: int | None,
    scheduler: str | None,
    ship: Any,
    wait: float,
    cache: str | None,
    cache_size: int,
    root: Path | None,
    shard: tuple[int, int] | None,
    quiet: bool,
) -> None:
    from ..errors import InputError

    if not data:
        raise InputError(
            "name the data sets, e.g. --data oxford,strecha; `sfmkit ablate --help` shows all "
            "options"
        )
    from rich.console import Console

    from ..ablation import ablate as start
    from ..ablation.variants import parse_vary
    from ..ablation.watching import bar

    settings = parse_vary(vary)
    if dry_run:
        sweep = {
            "combos": combos,
            "seeds": seeds,
            "presets": preset,
            "vary": settings,
            "matchers": matchers,
            "backend": backend,
            "root": root,
            "shard": shard,
        }
        print_plan(data, operators, sweep, cache, workers)
        return
    with resumable(), bar(enabled=not quiet, console=Console(stderr=True)) as watch:
        table = start(
            data,
            operators,
            combos=combos,
            seeds=seeds,
            preset=preset,
            vary=settings,
            matchers=matchers,
            backend=backend,
            out=out,
            root=root,
            workers=workers,
            scheduler=scheduler,
            ship=ship,
            wait=wait,
            cache=cache,
            cache_limit=cache_size,
            shard=shard,
            progress=watch,
        )
    if not quiet:
        from ..ablation.watching import print_overview

        print_overview(table)
        following = "sfmkit ablate merge" if shard else f"sfmkit ablate report {out}"
        click.echo(f"{len(table):,} rows in {table.path}; next: {following}")


def print_plan(
    data: tuple[str, ...],
    operators: tuple[str, ...],
    sweep: dict[str, Any],
    cache: str | None,
    workers: int | None,
) -> None:
    """Print what a sweep would do, for ``--dry-run``."""
    import os

    from rich.console import Console
    from rich.table import Table

    from ..ablation import make_plan
    from ..ablation.cache import Cache, default_cache
    from ..ablation.watching import duration
    from .progress import progress

    store = Cache(cache or default_cache())
    with progress(enabled=True) as say:
        plan = make_plan(data, operators, **sweep, cache=store, say=say)
        counts = plan.count(store)
    table = Table(
        "",
        "in all",
        "in the cache",
        "to do",
        title=f"{len(plan.pairs)} pairs, {len(plan.combinations)} combinations",
    )
    for column in table.columns[1:]:
        column.justify = "right"
    for what, kind, n in (
        ("detections", "features", counts.detections),
        ("matchings", "matches", counts.matchings),
        ("estimates", "estimates", counts.estimates),
    ):
        have = counts.cached[kind]
        table.add_row(what, f"{n:,}", f"{have:,}", f"{n - have:,}")
    Console().print(table)
    n = workers or os.cpu_count() or 1
    failing = sum(1 for pair in plan.pairs if pair.failure)
    if failing:
        click.echo(
            f"{failing} pairs cannot be run: {next(p.failure for p in plan.pairs if p.failure)}"
        )
    click.echo(
        f"{counts.rows:,} rows; about {duration(counts.seconds / n)} on {n} workers "
        "(within a factor of two)"
    )
