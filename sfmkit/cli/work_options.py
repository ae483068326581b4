"""Options that say who does the work and where results are stored."""

from __future__ import annotations

import click

from .parsing import size_in_bytes

__all__ = ["CACHE", "CACHE_SIZE", "SCHEDULER", "WAIT", "WORKERS"]

WORKERS = click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    metavar="N",
    help="Local processes, one thread each; default: one per core.",
)
SCHEDULER = click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="Run on this Dask cluster in place of local processes.",
)
WAIT = click.option(
    "--wait",
    type=click.FloatRange(min=0),
    default=600.0,
    show_default=True,
    metavar="SECONDS",
    help="How long to wait for a worker of the cluster, e.g. in the queue of a batch system.",
)
CACHE = click.option(
    "--cache",
    metavar="FOLDER|URL",
    help="Folder, or a URL such as s3://bucket/cache; default: SFMKIT_CACHE, or the user's cache.",
)
CACHE_SIZE = click.option(
    "--cache-size",
    default="8GB",
    show_default=True,
    callback=size_in_bytes,
    help="Largest size of the cache.",
)
