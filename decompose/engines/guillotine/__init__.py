"""The engine `guillotine`: recursive cuts perpendicular to the axes, for the least makespan."""

from __future__ import annotations

from decompose.engines.guillotine.class_search import cut_by_guillotine, make_class_tables
from decompose.engines.guillotine.curve import (
    ASSEMBLY_S,
    CLEARING_S,
    CurvePoint,
    compute_makespan_curve,
    find_fewest_printers_in_time,
    find_least_total_time,
)
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.engines.guillotine.plane_shift import FaceStop, MoveRules, grow_boxes, shift_box_planes
from decompose.engines.guillotine.printer_classes import classify_printers

__all__ = [
    "ASSEMBLY_S",
    "CLEARING_S",
    "CurvePoint",
    "FaceStop",
    "MoveRules",
    "Partitioner",
    "classify_printers",
    "compute_makespan_curve",
    "cut_by_guillotine",
    "find_fewest_printers_in_time",
    "find_least_total_time",
    "grow_boxes",
    "make_class_tables",
    "shift_box_planes",
]
