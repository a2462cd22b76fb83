"""Shift of a partition's planes, so that the slowest part ends as soon as possible."""

from __future__ import annotations

from decompose.engines.guillotine.plane_shift.face_limits import FaceStop, MoveRules
from decompose.engines.guillotine.plane_shift.plane_moves import grow_boxes, refine_needed_cells
from decompose.engines.guillotine.plane_shift.plane_shift import (
    estimate_shift_s,
    shift_box_planes,
    shift_planes,
)

__all__ = [
    "FaceStop",
    "MoveRules",
    "estimate_shift_s",
    "grow_boxes",
    "refine_needed_cells",
    "shift_box_planes",
    "shift_planes",
]
