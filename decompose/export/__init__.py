"""A decomposition as files: STL, JSON, picture and GLB."""

from __future__ import annotations

from decompose.export.files import FindPlace, draw_parts, write_decomposition, write_parts
from decompose.export.glb import write_glb
from decompose.export.picture import draw_assembly

__all__ = [
    "FindPlace",
    "draw_assembly",
    "draw_parts",
    "write_decomposition",
    "write_glb",
    "write_parts",
]
