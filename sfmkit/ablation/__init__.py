"""Ablations: every combination of operators on every pair, cached, resumable, also on a cluster.

>>> from sfmkit.ablation import ablate
>>> table = ablate("planes", ["surf", "orb", "sift"], seeds=3, out="out/ablation")
"""

from .folder import read_sweep
from .plan import make_plan
from .run import SweepState, ablate
from .table import AblationTable, read_table

__all__ = ["AblationTable", "SweepState", "ablate", "make_plan", "read_sweep", "read_table"]
