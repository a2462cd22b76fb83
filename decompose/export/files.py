"""Files of a decomposition in a folder: STL files of the parts, report, picture, GLB and instructions."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from decompose.errors import GeometryError
from decompose.export.drawn_parts import simplify_parts
from decompose.export.glb import write_glb
from decompose.export.instructions import write_instructions
from decompose.export.picture import draw_assembly
from decompose.export.step_picture import StepPictures
from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE, REPORT
from decompose.geometry import write_stl
from decompose.printers import BedPlace
from decompose.results import Decomposition, Part, check_stl, connect_parts, omit_connectors

PlaceFinder = Callable[[Part], BedPlace | None]
"""Function that finds the place of a part on the bed of its printer; it returns None if this is not known."""


def write_decomposition(
    decomposition: Decomposition, folder: Path, find_place: PlaceFinder = lambda part: None
) -> Decomposition:
    """Write an STL file of each part, the report, the picture, the GLB and the instructions.

    Parameters
    ----------
    decomposition, folder
        As in `write_parts`.
    find_place
        As in `draw_parts`.

    Returns
    -------
    Decomposition
        As in `write_parts`.
    """
    stored_result = write_parts(decomposition, folder)
    drawn_result = replace(stored_result, parts=simplify_parts(stored_result.parts))
    draw_parts(drawn_result, folder, find_place)
    return stored_result


def write_parts(decomposition: Decomposition, folder: Path) -> Decomposition:
    """Write a binary STL file of each part, and the report; read each STL file back.

    Parameters
    ----------
    decomposition
        Decomposition with its parts.
    folder
        Folder to write; it is created if it does not exist.

    Returns
    -------
    Decomposition
        Decomposition with the parts' file names, the assembly, pins and marks.

    Raises
    ------
    GeometryError
        An STL file, when read back, is not watertight, or its volume differs from that of the part, even
        without holes and marks.
    """
    folder.mkdir(parents=True, exist_ok=True)
    planned_result = decomposition.with_assembly()
    connected_result = connect_parts(planned_result)
    try:
        parts = _write_parts(connected_result.parts, folder)
    except GeometryError as error:
        if not connected_result.connectors.tools:
            raise
        connected_result = omit_connectors(planned_result, str(error))
        parts = _write_parts(connected_result.parts, folder)
    stored_result = replace(connected_result, parts=parts)
    text = json.dumps(stored_result.as_dict(), indent=1) + "\n"
    (folder / REPORT).write_text(text, encoding="utf-8")
    return stored_result


def draw_parts(
    decomposition: Decomposition,
    folder: Path,
    find_place: PlaceFinder = lambda part: None,
    overview: bytes | None = None,
    steps: Sequence[StepPictures] | None = None,
) -> None:
    """Write the picture, the GLB and the instructions.

    Parameters
    ----------
    decomposition
        Result of `write_parts`.
    folder
        Existing folder.
    find_place
        Function that finds the place of a part on its bed, for the instructions. If it returns None, the bed
        is not shown.
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
    """Write an STL file of each part, and check it; return the parts with the names of their files."""
    stored_parts = tuple(replace(part, file=f"{part.id}.stl") for part in parts)
    for part in stored_parts:
        write_stl(folder / part.file, part.build_stl_triangles())
        check_stl(folder / part.file, part)
    return stored_parts
