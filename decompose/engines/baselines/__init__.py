"""Engines that follow baseline methods from the literature, for comparison with the other engines."""

from __future__ import annotations

from decompose.engines.baselines.cube_skeleton import cut_by_cube_skeleton
from decompose.engines.baselines.symmetry import cut_by_symmetry

__all__ = [
    "cut_by_cube_skeleton",
    "cut_by_symmetry",
]
