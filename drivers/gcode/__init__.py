"""G-code lines, programs and their timelines. Pure."""

from drivers.gcode.filament_position import MotionState, Point, measure_retraction_mm, read_position
from drivers.gcode.frame import add_frame, add_frames, compute_checksum, remove_frame
from drivers.gcode.program import (
    MAX_LINE_BYTES,
    HeatCommand,
    HeaterName,
    Program,
    ProgramStore,
    read_program,
)
from drivers.gcode.timeline import Feature, Progress

__all__ = [
    "MAX_LINE_BYTES",
    "Feature",
    "HeatCommand",
    "HeaterName",
    "MotionState",
    "Point",
    "Program",
    "ProgramStore",
    "Progress",
    "add_frame",
    "add_frames",
    "compute_checksum",
    "measure_retraction_mm",
    "read_position",
    "read_program",
    "remove_frame",
]
