"""Functions of planning that run in worker processes; their modules load numpy, meshes and Cura there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from farm.compute import Deferred
from farm.planning.task_files import (
    list_cut_files,
    list_decompose_files,
    list_relevel_files,
    list_slice_files,
)

if TYPE_CHECKING:
    from farm.planning.inspection.inspect_submission import inspect_submission
    from farm.planning.inspection.own_gcode import plan_gcode
    from farm.planning.parts.decompose_job import decompose_job, warm
    from farm.planning.parts.relevel_parts import relevel_parts
    from farm.planning.parts.slice_part import slice_part
    from farm.planning.replanning.cut_part import cut_part
else:
    inspect_submission = Deferred("farm.planning.inspection.inspect_submission:inspect_submission")
    decompose_job = Deferred("farm.planning.parts.decompose_job:decompose_job", list_decompose_files)
    relevel_parts = Deferred("farm.planning.parts.relevel_parts:relevel_parts", list_relevel_files)
    warm = Deferred("farm.planning.parts.decompose_job:warm")
    plan_gcode = Deferred("farm.planning.inspection.own_gcode:plan_gcode")
    slice_part = Deferred("farm.planning.parts.slice_part:slice_part", list_slice_files)
    cut_part = Deferred("farm.planning.replanning.cut_part:cut_part", list_cut_files)

__all__ = [
    "cut_part",
    "decompose_job",
    "inspect_submission",
    "plan_gcode",
    "relevel_parts",
    "slice_part",
    "warm",
]
