"""Cutting of a failed part for several printers. Runs in a worker."""

from __future__ import annotations

import json
import string
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from decompose.auto import decompose_for_goal
from decompose.connectors import read_pair_shapes
from decompose.errors import NoFit
from decompose.export import draw_assembly, simplify_parts, write_decomposition, write_glb
from decompose.files.names import INSTRUCTIONS, REPORT
from decompose.geometry import Model, Solid
from decompose.options import Interior, PairShape
from decompose.results import Decomposition
from decompose.results import Part as DrawnPart
from farm.errors import ErrorCode, FarmError
from farm.model import Part
from farm.planning.error_translation import translate_errors
from farm.planning.part_records import DecomposedPart
from farm.planning.parts.bed_places import find_beds, make_place_finder
from farm.planning.parts.pricing import build_decompose_options, build_target_printers, estimate_time_factors
from farm.planning.replanning.replan import Pieces, ReplanTask
from slicing.settings import find_resources


def cut_part(task: ReplanTask) -> Pieces:
    """Cut a part into pieces for several of the task's printers.

    The number of printers is chosen so that printing and a person's work take the least time in total.

    Raises
    ------
    FarmError
        With code `no_fit` if cutting saves no time; see also `decompose_job`.
    """
    with translate_errors():
        resources = find_resources()
    job_options = build_decompose_options(task.options, task.printers)
    connectors = replace(job_options.connectors, used_shapes=read_used_shapes(task))
    options = replace(job_options, interior=Interior.KEEP, connectors=connectors)  # pieces are not hollowed
    whole, quality = Model(_read_solid(task.files / task.part.file), (), 1.0), task.options.quality
    time_factors = estimate_time_factors(task.printers, task.time_factors, whole.solid, quality, resources)
    printers, cost = build_target_printers(task.printers, time_factors, quality, resources)
    try:
        decomposition = decompose_for_goal(whole, printers, options, cost)
        if len(decomposition.parts) < 2:
            raise FarmError(f"part {task.part.id} finishes sooner in one piece", ErrorCode.NO_FIT)
        beds = find_beds(task.printers, task.options.quality, resources)
        job_decomposition = _move_and_name_pieces(decomposition, task.part)
        stored_decomposition = write_decomposition(job_decomposition, task.folder, make_place_finder(beds))
    except NoFit as error:
        raise FarmError(str(error), ErrorCode.NO_FIT) from error
    except FarmError:
        raise
    except Exception:
        with translate_errors():
            raise
    pieces = tuple(DecomposedPart.from_part(part, task.folder) for part in stored_decomposition.parts)
    job_parts = [
        *(_convert_part(task.files, other) for other in task.other_parts),
        *stored_decomposition.parts,
    ]
    picture, assembly = task.folder / "job.png", task.folder / "job.glb"
    drawn_parts = simplify_parts(job_parts)
    draw_assembly(drawn_parts, picture)
    write_glb(drawn_parts, assembly)
    return Pieces(pieces, picture, assembly, task.folder / REPORT, task.folder / INSTRUCTIONS)


def read_used_shapes(task: ReplanTask) -> tuple[PairShape, ...]:
    """Read the shape of each existing pair of pins; new pairs must be unlike them."""
    reports = ((task.files / name).read_text(encoding="utf-8") for name in task.reports)
    return tuple(shape for report in reports for shape in read_pair_shapes(json.loads(report)))


def _move_and_name_pieces(decomposition: Decomposition, whole: Part) -> Decomposition:
    """Name the pieces by their part and a letter, and move them to the frame of the job's model."""
    to_model = np.reshape(whole.geometry.to_model, (4, 4))
    name = Path(whole.id).name
    pieces = (
        replace(
            piece,
            id=f"{name}{letter}",
            solid=_move_solid(piece.solid, to_model),
            to_model=to_model @ piece.to_model,
            planes=_move_planes(piece.planes, to_model),
        )
        for letter, piece in zip(string.ascii_lowercase, decomposition.parts, strict=False)
    )
    return replace(
        decomposition,
        parts=tuple(pieces),
        joints=tuple(joint.move(to_model) for joint in decomposition.joints),
    )


def _read_solid(stl: Path) -> Solid:
    mesh = trimesh.load_mesh(stl)
    return Solid.from_arrays(mesh.vertices, mesh.faces)


def _move_solid(solid: Solid, transform: np.ndarray) -> Solid:
    vertices, faces = solid.arrays()
    return Solid.from_arrays(vertices @ transform[:3, :3].T + transform[:3, 3], faces)


def _move_planes(planes: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """Transform planes, an array (n, 4) with rows nx, ny, nz, d, by a (4, 4) transform."""
    normals = planes[:, :3] @ transform[:3, :3].T
    return np.column_stack((normals, planes[:, 3] + normals @ transform[:3, 3]))


def _convert_part(files: Path, part: Part) -> DrawnPart:
    """Convert the record of a part to a part for the picture."""
    to_model = np.reshape(part.geometry.to_model, (4, 4))
    return DrawnPart(
        Path(part.id).name, _move_solid(_read_solid(files / part.file), to_model), to_model, 0.0, ""
    )
