"""Benchmarks: the experiments of the paper, and image pairs of any data set."""

from __future__ import annotations

from .density_by_operator import density_report
from .fountain import bench_fountain
from .maps import bench_map
from .oxford import bench_oxford
from .pairs import bench_pairs
from .uav import bench_uav
from .verdict import bench_verdict

__all__ = [
    "bench_fountain",
    "bench_map",
    "bench_oxford",
    "bench_pairs",
    "bench_uav",
    "bench_verdict",
    "density_report",
]
