"""A decomposition as a folder: one STL per part, report, picture, GLB and instructions."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from decompose.connectors import Connectors
from decompose.errors import GeometryError
from decompose.export.glb import write_glb
from decompose.export.instructions import write_instructions
from decompose.export.picture import draw_assembly
from decompose.export.step_picture import StepPictures
from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE, REPORT
from decompose.geometry import write_stl
from decompose.printers import BedPlace
from decompose.results import Decomposition, Part, check_stl, connect_parts

FindPlace = Callable[[Part], BedPlace | None]
"""Finds the place of a part on the bed of its printer; None if that is not known."""


def write_decomposition(
    decomposition: Decomposition, folder: Path, find_place: FindPlace = lambda part: None
) -> Decomposition:
    """Write one binary STL per part, report, picture, GLB and instructions.

    See `write_parts` and `draw_parts`.
    """
    stored_result = write_parts(decomposition, folder)
    draw_parts(stored_result, folder, find_place)
    return stored_result


def write_parts(decomposition: Decomposition, folder: Path) -> Decomposition:
    """Write one binary STL per part, and the report; read each STL back.

    Parameters
    ----------
    decomposition
        Its parts.
    folder
        Folder to write; created if it does not exist.

    Returns
    -------
    Decomposition
        The same, with the parts' file names, the assembly, pins and marks.

    Raises
    ------
    GeometryError
        An STL, read back, is not watertight or has another volume, even without holes and marks.
    """
    folder.mkdir(parents=True, exist_ok=True)
    planned_result = decomposition.with_assembly()
    connected_result = connect_parts(planned_result)
    try:
        parts = _write_parts(connected_result.parts, folder)
    except GeometryError as error:
        if not connected_result.connectors.tools:
            raise
        connected_result = replace(
            planned_result, connectors=Connectors(failures=(f"no pins and marks: {error}",))
        )
        parts = _write_parts(connected_result.parts, folder)
    stored_result = replace(connected_result, parts=parts)
    text = json.dumps(stored_result.as_dict(), indent=1) + "\n"
    (folder / REPORT).write_text(text, encoding="utf-8")
    return stored_result


def draw_parts(
    decomposition: Decomposition,
    folder: Path,
    find_place: FindPlace = lambda part: None,
    overview: bytes | None = None,
    steps: Sequence[StepPictures] | None = None,
) -> None:
    """Write picture, GLB and instructions.

    Parameters
    ----------
    decomposition
        Parts from `write_parts`.
    folder
        Folder that exists.
    find_place
        Finds the place of a part on its bed, for the instructions; None if the bed is not shown.
    overview, steps
        Picture of the parts as PNG, and pictures of all steps; None to draw them.
    """
    if overview is None:
        draw_assembly(decomposition.parts, folder / PICTURE)
    else:
        (folder / PICTURE).write_bytes(overview)
    write_glb(decomposition.parts, folder / ASSEMBLY, decomposition.assembly.steps)
    places = [find_place(part) for part in decomposition.parts]
    write_instructions(decomposition, folder / INSTRUCTIONS, folder / PICTURE, places, steps)


def _write_parts(parts: Sequence[Part], folder: Path) -> tuple[Part, ...]:
    """Write an STL per part, and read it back; returns the parts with the names of their files."""
    stored_parts = tuple(replace(part, file=f"{part.id}.stl") for part in parts)
    for part in stored_parts:
        write_stl(folder / part.file, part.build_stl_triangles())
        check_stl(folder / part.file, part)
    return stored_parts
