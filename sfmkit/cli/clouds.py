"""Helpers of the commands that read a cloud."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..types import PointCloud


def read_cloud(path: Path) -> PointCloud:
    """Read the cloud of a PLY file and print its warnings, one per line."""
    from ..io.ply import read_ply

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        cloud = read_ply(path)
    for warning in said:
        click.echo(f"warning: {warning.message}", err=True)
    return cloud
