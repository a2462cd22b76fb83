"""The assembly as a GLB file: every part where it belongs, one colour and one name each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from decompose.export.picture import part_colours

if TYPE_CHECKING:
    from decompose.results import Part

# glTF 2.0, 3.6 "Coordinate system and units": metres, y up.
METRES_Y_UP = np.array([[1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, -1e-3, 0, 0], [0, 0, 0, 1]])


def write_glb(parts: Sequence[Part], path: Path) -> None:
    """Write the parts in the model's frame, with its z up and in metres, as the format has it.

    Parameters
    ----------
    parts
        In the model's frame, in mm.
    path
        Of the file, glTF 2.0 binary.
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
