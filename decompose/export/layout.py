"""Picture of the parts as they come off the beds, laid out in the order of gluing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decompose.export.picture import (
    encode_png,
    make_figure,
    part_colours,
    white_outline,
    write_labels,
)
from decompose.export.raster import Shape, draw, make_camera
from decompose.files.names import short_label
from decompose.results import Part

WIDER = 1.5  # columns over rows
GAP = 0.15  # between two places, as a share of the longest side
EYE_DEG = 50.0  # above the table
LONG_SIDE_PX = 900
NAME_PT = 9.0


def sort_by_use(parts: Sequence[Part], order: Sequence[int]) -> list[int]:
    """List the numbers of all parts: those of an order first."""
    return [*order, *(number for number in range(len(parts)) if number not in set(order))]


def draw_layout(parts: Sequence[Part], order: Sequence[int]) -> bytes:
    """Draw the parts as they were printed, row by row from behind, each with its number and printer.

    Parameters
    ----------
    parts
        All parts, at least one.
    order
        Numbers of parts, in the order in which they are drawn.

    Returns
    -------
    bytes
        PNG.
    """
    colours = part_colours(len(parts))
    meshes = [parts[number].printing_mesh() for number in order]
    extents_mm = np.array([np.ptp(vertices, axis=0) for vertices, _ in meshes])
    seen_mm = extents_mm[:, 1] + extents_mm[:, 2] / np.tan(np.radians(EYE_DEG))  # of depth and height
    pitch_mm = (1.0 + GAP) * np.array([extents_mm[:, 0].max(), seen_mm.max(), 0.0])
    columns = int(np.ceil(np.sqrt(WIDER * len(order))))
    shapes, front_mm = [], []
    for place, (number, (vertices, faces)) in enumerate(zip(order, meshes, strict=True)):
        middle_mm = (vertices.max(axis=0) + vertices.min(axis=0)) / 2.0 * [1.0, 1.0, 0.0]
        at_mm = pitch_mm * [place % columns, -(place // columns), 0.0]
        placed = vertices - middle_mm + at_mm
        shapes.append(Shape(placed[faces], colours[number]))
        front_mm.append([at_mm[0], placed[:, 1].min(), 0.0])
    below_mm = np.min(front_mm, axis=0) - [0.0, GAP / 2.0 * pitch_mm[1], 0.0]
    shapes.append(Shape(np.tile(below_mm, (1, 3, 1)), np.ones(3)))  # no area: room for the last names
    drawing = draw(shapes, make_camera(-90.0, EYE_DEG), LONG_SIDE_PX, oversample=2)
    figure, axes = make_figure(drawing)
    write_labels(axes, drawing, [short_label(parts[number].id) for number in order])
    for number, (x, y) in zip(order, drawing.place(np.array(front_mm)), strict=True):
        axes.text(
            x, y - NAME_PT, name_printer(parts[number]),
            ha="center", va="top", fontsize=NAME_PT, path_effects=white_outline(),
        )  # fmt: skip
    return encode_png(figure)


def name_printer(part: Part) -> str:
    """Name the printer of a part: without a fleet, printers have numbers."""
    return f"printer {part.printer}" if part.printer.isdigit() else part.printer
