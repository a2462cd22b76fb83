"""Pictures of parts, for a report."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh

from decompose.export import draw_assembly
from decompose.geometry import Solid
from decompose.results import Part

LONGEST_PX = 220


def draw_part(stl: Path) -> bytes | None:
    """A PNG of a part in its printing pose; None where the file is no STL that can be read."""
    if stl.suffix != ".stl" or not os.access(stl, os.R_OK):
        return None
    mesh = trimesh.load_mesh(stl)
    part = Part("", Solid.from_arrays(mesh.vertices, mesh.faces), np.eye(4), 0.0, "")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "part.png"
        draw_assembly([part], path, LONGEST_PX)
        return path.read_bytes()
