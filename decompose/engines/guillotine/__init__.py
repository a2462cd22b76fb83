"""The engine `guillotine`: the partition by recursive axis cuts that ends soonest."""

from __future__ import annotations

from decompose.engines.guillotine.class_search import class_tables, cut_by_guillotine
from decompose.engines.guillotine.curve import (
    ASSEMBLE_S,
    CLEAR_S,
    CurvePoint,
    find_fewest_in_time,
    find_knee,
    makespan_curve,
)
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.engines.guillotine.plane_shift import shift_box_planes
from decompose.engines.guillotine.printer_classes import classify_printers

__all__ = [
    "ASSEMBLE_S",
    "CLEAR_S",
    "CurvePoint",
    "Partitioner",
    "class_tables",
    "classify_printers",
    "cut_by_guillotine",
    "find_fewest_in_time",
    "find_knee",
    "makespan_curve",
    "shift_box_planes",
]
