"""Picture of the parts in their printing poses, in the order of gluing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.export.canvas import PX_PER_PT, Canvas
from decompose.export.picture import make_part_colours
from decompose.export.raster import Shape, draw_shapes, make_camera
from decompose.files.names import find_part_number
from decompose.printers import BedPlace
from decompose.results import Part

WIDTH_RATIO = 1.5  # ratio of the number of columns to that of rows
GAP_SHARE = 0.15  # gap between two parts, as a share of the longest side
EYE_ELEVATION_DEG = 50.0  # elevation of the eye above the table
LONG_SIDE_PX = 900
NAME_PT = 9.0
BED_COLOUR = np.array([0.93, 0.93, 0.95])
BED_DEPTH_MM = 0.5  # depth below a part at which its bed is drawn


def sort_parts_by_use(parts: Sequence[Part], order: Sequence[int]) -> list[int]:
    """Sort the numbers of all parts: first those in an order, then the others.

    Parameters
    ----------
    parts
        All parts.
    order
        Numbers of parts in the order of use.
    """
    return [*order, *(number for number in range(len(parts)) if number not in set(order))]


def draw_layout(parts: Sequence[Part], order: Sequence[int], places: Sequence[BedPlace | None] = ()) -> bytes:
    """Draw the parts in their printing poses, row by row from the back, each with its number and printer.

    Parameters
    ----------
    parts
        All parts, at least one.
    order
        Numbers of parts, in the order in which they are drawn.
    places
        Place of each part on its bed, None if it is not known; a bed is drawn for each known place.

    Returns
    -------
    bytes
        PNG.
    """
    shapes, front_mm = _lay_out_shapes(parts, order, places)
    drawing = draw_shapes(shapes, make_camera(-90.0, EYE_ELEVATION_DEG), LONG_SIDE_PX)
    canvas = Canvas(drawing)
    canvas.write_labels([find_part_number(parts[number].id) for number in order])
    for number, (x, y) in zip(order, drawing.find_pixels(front_mm), strict=True):
        canvas.write_text(x, y - NAME_PT / 2.0 * PX_PER_PT, name_printer(parts[number]), NAME_PT, "ma")
    return canvas.encode_png()


def _lay_out_shapes(
    parts: Sequence[Part], order: Sequence[int], places: Sequence[BedPlace | None]
) -> tuple[list[Shape], Floats]:
    """Lay out the shapes of parts and beds; return them, and the points (n, 3) in mm for the names."""
    colours = make_part_colours(len(parts))
    ordered_places = [places[number] if places else None for number in order]
    meshes = [
        put_part_on_bed(*parts[number].build_printing_mesh(), place)
        for number, place in zip(order, ordered_places, strict=True)
    ]
    extents_mm = np.array(
        [_find_extents(vertices, place) for (vertices, _), place in zip(meshes, ordered_places, strict=True)]
    )
    # Depth of the table that each part hides from the eye, by its own depth and its height.
    hidden_mm = extents_mm[:, 1] + extents_mm[:, 2] / np.tan(np.radians(EYE_ELEVATION_DEG))
    pitch_mm = (1.0 + GAP_SHARE) * np.array([extents_mm[:, 0].max(), hidden_mm.max(), 0.0])
    column_count = int(np.ceil(np.sqrt(WIDTH_RATIO * len(order))))
    shapes, bed_shapes, front_mm = [], [], []
    for i, (number, (vertices, faces), place) in enumerate(zip(order, meshes, ordered_places, strict=True)):
        middle_mm = pitch_mm * [i % column_count, -(i // column_count), 0.0]
        placed_vertices = vertices + middle_mm
        shapes.append(Shape(placed_vertices[faces], colours[number]))
        front_y_mm = placed_vertices[:, 1].min()
        if place is not None:
            bed_shapes.append(Shape(_make_bed(place) + middle_mm, BED_COLOUR))
            front_y_mm = min(front_y_mm, middle_mm[1] - place.bed_mm[1] / 2.0)
        front_mm.append([middle_mm[0], front_y_mm, 0.0])
    below_mm = np.min(front_mm, axis=0) - [0.0, GAP_SHARE / 2.0 * pitch_mm[1], 0.0]
    # A triangle without area reserves space for the names in the last row.
    name_space = Shape(np.tile(below_mm, (1, 3, 1)), np.ones(3))
    return [*shapes, *bed_shapes, name_space], np.array(front_mm)


def describe_place(place: BedPlace | None) -> str:
    """Describe where the middle of a part lies on its bed, seen from the front; empty if it is not known."""
    if place is None:
        return ""
    right, back = (round(mm) for mm in place.centre_mm)
    offsets = [
        f"{abs(mm)} mm {names[mm > 0]}"
        for mm, names in ((right, ("left of", "right of")), (back, ("in front of", "behind")))
        if mm
    ]
    return f"{' and '.join(offsets) or 'in'} the middle"


def put_part_on_bed(vertices: Floats, faces: Ints, place: BedPlace | None) -> tuple[Floats, Ints]:
    """Move a part to its place on the bed, or to the origin if its place is not known.

    Parameters
    ----------
    vertices, faces
        (n, 3) vertices in mm and (m, 3) faces of the part, in printing pose.
    place
        Place of the part's bounding box on the bed; None if it is not known.

    Returns
    -------
    tuple
        (n, 3) moved vertices, and the faces.
    """
    middle_mm = (vertices.max(axis=0) + vertices.min(axis=0)) / 2.0 * [1.0, 1.0, 0.0]
    placed_vertices = vertices - middle_mm
    if place is None:
        return placed_vertices, faces
    if place.is_rotated:
        placed_vertices = placed_vertices @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return placed_vertices + np.array([*place.centre_mm, 0.0]), faces


def _find_extents(vertices: Floats, place: BedPlace | None) -> Floats:
    """Find the extents (3,) in mm of a part, with the bed around the origin if its place is known."""
    if place is None:
        return np.asarray(np.ptp(vertices, axis=0))
    extents_mm = np.maximum(2.0 * np.abs(vertices[:, :2]).max(axis=0), place.bed_mm)
    return np.append(extents_mm, np.ptp(vertices[:, 2]))


def _make_bed(place: BedPlace) -> Floats:
    """Make two triangles (2, 3, 3) of a bed, slightly below the parts."""
    x, y = np.array(place.bed_mm) / 2.0
    corners = np.array(
        [[-x, -y, -BED_DEPTH_MM], [x, -y, -BED_DEPTH_MM], [x, y, -BED_DEPTH_MM], [-x, y, -BED_DEPTH_MM]]
    )
    return np.asarray(corners[[[0, 1, 2], [0, 2, 3]]])


def name_printer(part: Part) -> str:
    """Name the printer of a part; without a fleet, printers have numbers instead of names."""
    return f"printer {part.printer}" if part.printer.isdigit() else part.printer
