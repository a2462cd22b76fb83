"""GLB file (glTF 2.0 binary) of the assembly, with its steps as an animation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.export.picture import make_part_colours
from decompose.results import Part

GLTF_TRANSFORM = np.array([[1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, -1e-3, 0, 0], [0, 0, 0, 1]])
"""Transform from mm with z up to metres with y up (glTF 2.0, 3.6 "Coordinate system and units")."""
STEP_S, MOVE_S = 1.5, 1.0  # duration of a step in the animation, and of the movement during the step
MIN_MOVE_MM, MIN_MOVE_SHARE = 25.0, 0.3  # minimum movement of a body: in mm, and as a share of its extent
FLOAT_COMPONENT_TYPE = 5126  # glTF 2.0, 3.6.2.2: component type of single precision
MODEL_NODE = "model"


def find_movements_mm(parts: Sequence[Part], steps: Sequence[AssemblyStep]) -> Floats:
    """Choose the movement of the moved body in each step, for pictures and the animation.

    Parameters
    ----------
    parts
        Parts in the model's frame, in mm.
    steps
        Steps of their assembly.

    Returns
    -------
    ndarray
        (steps, 3) vectors in mm from the end of the movement to its start.
    """
    moves_mm = np.zeros((len(steps), 3))
    for row, step in zip(moves_mm, steps, strict=True):
        heights_mm = [parts[number].solid.arrays()[0] @ step.direction for number in step.moved_parts]
        extent_mm = max(h.max() for h in heights_mm) - min(h.min() for h in heights_mm)
        row[:] = max(MIN_MOVE_MM, MIN_MOVE_SHARE * float(extent_mm)) * step.direction
    return moves_mm


def find_offsets(count: int, steps: Sequence[AssemblyStep], moves_mm: Floats) -> Floats:
    """Find the offset of each part from its final position, before each step and after the last one.

    Parameters
    ----------
    count
        Number of parts.
    steps, moves_mm
        Steps, and the movement (steps, 3) of each.

    Returns
    -------
    ndarray
        (steps + 1, count, 3) offsets, in the unit of `moves_mm`; 0 in the last row.
    """
    offsets = np.zeros((len(steps) + 1, count, 3))
    for k in range(len(steps) - 1, -1, -1):
        offsets[k] = offsets[k + 1]
        offsets[k, list(steps[k].moved_parts)] += moves_mm[k]
    return offsets


def write_glb(parts: Sequence[Part], path: Path, steps: Sequence[AssemblyStep] = ()) -> None:
    """Write the parts as a GLB file of the assembly, in metres and with y up, as glTF requires.

    Parameters
    ----------
    parts
        Parts in the model's frame, in mm.
    path
        File to write.
    steps
        Steps of the assembly, for the animation; by default there is no animation.
    """
    visual: Any = trimesh.visual  # untyped
    scene: Any = trimesh.Scene()
    # An animated node must not have a matrix of its own.
    scene.graph.update(MODEL_NODE, matrix=GLTF_TRANSFORM)
    for part, colour in zip(parts, make_part_colours(len(parts)), strict=True):
        vertices, faces = part.solid.arrays()
        material = visual.material.PBRMaterial(
            name=part.id, baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.8
        )
        mesh: Any = trimesh.Trimesh(vertices, faces, process=False)
        mesh.unmerge_vertices()  # the edges of a part are drawn sharp
        mesh.visual = visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=part.id, geom_name=part.id, parent_node_name=MODEL_NODE)

    def animate(buffers: dict[Any, bytes], tree: dict[str, Any]) -> None:
        if steps:
            offsets = find_offsets(len(parts), steps, find_movements_mm(parts, steps))
            _add_animation(tree, buffers, [part.id for part in parts], offsets)

    path.write_bytes(scene.export(file_type="glb", buffer_postprocessor=animate))


def _add_animation(
    tree: dict[str, Any], buffers: dict[Any, bytes], names: Sequence[str], offsets: Floats
) -> None:
    """Add an animation that moves the nodes with these names by offsets (steps + 1, parts, 3)."""
    step_count = len(offsets) - 1
    starts_s = STEP_S * np.arange(step_count)
    times_accessor = _add_accessor(
        tree, buffers, np.append(np.column_stack([starts_s, starts_s + MOVE_S]).ravel(), STEP_S * step_count)
    )
    nodes = {node.get("name"): number for number, node in enumerate(tree["nodes"])}
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for part_index, name in enumerate(names):
        part_offsets = offsets[:, part_index]
        if not part_offsets.any():
            continue
        keyframes = np.append(
            np.stack([part_offsets[:-1], part_offsets[1:]], axis=1).reshape(-1, 3), part_offsets[-1:], axis=0
        )
        channels.append({"sampler": len(samplers), "target": {"node": nodes[name], "path": "translation"}})
        samplers.append(
            {
                "input": times_accessor,
                "output": _add_accessor(tree, buffers, keyframes),
                "interpolation": "LINEAR",
            }
        )
    tree["animations"] = [{"name": "assembly", "samplers": samplers, "channels": channels}]


def _add_accessor(tree: dict[str, Any], buffers: dict[Any, bytes], values: Floats) -> int:
    """Add an accessor of numbers (n,) or vectors (n, 3), and return its number."""
    data: npt.NDArray[np.float32] = values.astype("<f4")
    number = len(tree["accessors"])
    tree["accessors"][f"animation {number}"] = {
        "bufferView": len(buffers),
        "componentType": FLOAT_COMPONENT_TYPE,
        "type": "SCALAR" if data.ndim == 1 else "VEC3",
        "count": len(data),
        "min": np.atleast_1d(data.min(axis=0)).tolist(),
        "max": np.atleast_1d(data.max(axis=0)).tolist(),
    }
    buffers[f"animation {number}"] = data.tobytes()
    return number
