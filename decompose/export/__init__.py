"""Files of a decomposition: STL, JSON, pictures, GLB and instructions."""

from __future__ import annotations

from decompose.export.drawn_parts import simplify_parts
from decompose.export.files import PlaceFinder, draw_parts, write_decomposition, write_parts
from decompose.export.glb import write_glb
from decompose.export.picture import draw_assembly
from decompose.export.step_picture import draw_steps

__all__ = [
    "PlaceFinder",
    "draw_assembly",
    "draw_parts",
    "draw_steps",
    "simplify_parts",
    "write_decomposition",
    "write_glb",
    "write_parts",
]
