"""What the commands that take a cloud share."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..types import PointCloud


def read_cloud(path: Path) -> PointCloud:
    """The cloud of a PLY file; what had to be left out is said in a line."""
    from ..io.ply import read_ply

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        cloud = read_ply(path)
    for warning in said:
        click.echo(f"warning: {warning.message}", err=True)
    return cloud
