"""The engines: each takes a `Problem` and returns a `Partition` of its model."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from decompose.engines.baselines import cut_by_cube_skeleton, cut_by_symmetry
from decompose.engines.guillotine import cut_by_guillotine
from decompose.engines.parallelobox import apply_paper_settings, cut_by_parallelobox
from decompose.options import Engine
from decompose.problem import Partition, Problem

__all__ = ["ENGINES", "apply_paper_settings"]

ENGINES: Mapping[Engine, Callable[[Problem], Partition]] = {
    Engine.GUILLOTINE: cut_by_guillotine,
    Engine.PARALLELOBOX: cut_by_parallelobox,
    Engine.SYMMETRY: cut_by_symmetry,
    Engine.CUBE_SKELETON: cut_by_cube_skeleton,
}
"""The search of each engine; `Engine.BEST` chooses among them (`decompose.best`)."""
