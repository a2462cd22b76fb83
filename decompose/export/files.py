"""A decomposition as a folder: one STL a part, decomposition.json, a picture and a GLB of the assembly."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from decompose.export.glb import write_glb
from decompose.export.picture import draw_assembly
from decompose.file_names import ASSEMBLY, PICTURE, REPORT
from decompose.geometry import write_stl
from decompose.results import Decomposition, check_stl


def write_decomposition(decomposition: Decomposition, folder: Path) -> Decomposition:
    """Write one binary STL a part, decomposition.json, assembly.png and assembly.glb; read each STL back.

    Returns
    -------
    Decomposition
        The same, with the parts' file names.

    Raises
    ------
    GeometryError
        An STL, read back, is not watertight or has another volume.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for part in decomposition.parts:
        named = replace(part, file=f"{part.id}.stl")
        write_stl(folder / named.file, named.stl_triangles())
        check_stl(folder / named.file, named)
        parts.append(named)
    written = replace(decomposition, parts=tuple(parts))
    text = json.dumps(written.as_dict(), indent=1) + "\n"
    (folder / REPORT).write_text(text, encoding="utf-8")
    draw_assembly(written.parts, folder / PICTURE)
    write_glb(written.parts, folder / ASSEMBLY)
    return written
