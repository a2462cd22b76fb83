"""A decomposition as a folder: one STL per part, report, picture, GLB and instructions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from decompose.export.glb import write_glb
from decompose.export.instructions import write_instructions
from decompose.export.picture import draw_assembly
from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE, REPORT
from decompose.geometry import write_stl
from decompose.results import Decomposition, check_stl, connect_parts


def write_decomposition(decomposition: Decomposition, folder: Path) -> Decomposition:
    """Write one binary STL per part, report, picture, GLB and instructions; read each STL back.

    Returns
    -------
    Decomposition
        The same, with the parts' file names, the assembly, pins and marks.

    Raises
    ------
    GeometryError
        An STL, read back, is not watertight or has another volume.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    connected = connect_parts(decomposition.with_assembly())
    for part in connected.parts:
        stored_part = replace(part, file=f"{part.id}.stl")
        write_stl(folder / stored_part.file, stored_part.stl_triangles())
        check_stl(folder / stored_part.file, stored_part)
        parts.append(stored_part)
    stored = replace(connected, parts=tuple(parts))
    text = json.dumps(stored.as_dict(), indent=1) + "\n"
    (folder / REPORT).write_text(text, encoding="utf-8")
    draw_assembly(stored.parts, folder / PICTURE)
    write_glb(stored.parts, folder / ASSEMBLY, stored.assembly.steps)
    write_instructions(stored, folder / INSTRUCTIONS, folder / PICTURE)
    return stored
