"""A decomposition as a folder: one STL per part, report, picture, GLB and instructions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from decompose.export.instructions import write_instructions
from decompose.export.picture import draw_assembly, part_colours
from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE, REPORT
from decompose.geometry import write_stl
from decompose.results import Decomposition, Part, check_stl

# glTF 2.0, 3.6 "Coordinate system and units": metres, y up.
METRES_Y_UP = np.array([[1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, -1e-3, 0, 0], [0, 0, 0, 1]])


def write_decomposition(decomposition: Decomposition, folder: Path) -> Decomposition:
    """Write one binary STL per part, report, picture, GLB and instructions; read each STL back.

    Returns
    -------
    Decomposition
        The same, with the parts' file names and the assembly.

    Raises
    ------
    GeometryError
        An STL, read back, is not watertight or has another volume.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for part in decomposition.parts:
        stored_part = replace(part, file=f"{part.id}.stl")
        write_stl(folder / stored_part.file, stored_part.stl_triangles())
        check_stl(folder / stored_part.file, stored_part)
        parts.append(stored_part)
    stored = replace(decomposition, parts=tuple(parts)).with_assembly()
    text = json.dumps(stored.as_dict(), indent=1) + "\n"
    (folder / REPORT).write_text(text, encoding="utf-8")
    draw_assembly(stored.parts, folder / PICTURE)
    write_glb(stored.parts, folder / ASSEMBLY)
    write_instructions(stored, folder / INSTRUCTIONS, folder / PICTURE)
    return stored


def write_glb(parts: Sequence[Part], path: Path) -> None:
    """Write the parts as a GLB of the assembly, in metres and with y up, as glTF requires.

    Parameters
    ----------
    parts
        In the model's frame, in mm.
    path
        File to write, glTF 2.0 binary.
    """
    visual: Any = trimesh.visual  # untyped
    scene: Any = trimesh.Scene()
    for part, colour in zip(parts, part_colours(len(parts)), strict=True):
        vertices, faces = part.solid.arrays()
        material = visual.material.PBRMaterial(
            name=part.id, baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.8
        )
        mesh: Any = trimesh.Trimesh(vertices, faces, process=False)
        mesh.unmerge_vertices()  # edges of a part are sharp
        mesh.visual = visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=part.id, geom_name=part.id, transform=METRES_Y_UP)
    path.write_bytes(scene.export(file_type="glb"))
