"""Model files: STL, STEP and 3MF, and limits on their sizes."""

from __future__ import annotations

from decompose.geometry.formats.file_limits import check_limits
from decompose.geometry.formats.step import read_step
from decompose.geometry.formats.stl import (
    count_stored_faces,
    parse_triangles,
    round_triangles,
    separate_touching_surfaces,
    write_stl,
)
from decompose.geometry.formats.threemf import read_3mf

__all__ = [
    "check_limits",
    "count_stored_faces",
    "parse_triangles",
    "read_3mf",
    "read_step",
    "round_triangles",
    "separate_touching_surfaces",
    "write_stl",
]
