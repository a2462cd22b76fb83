"""Exploded picture of the assembly: each part in its own colour, with its number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from colorsys import hsv_to_rgb
from pathlib import Path
from textwrap import fill

import numpy as np

from decompose.arrays import Floats
from decompose.export.canvas import Canvas
from decompose.export.raster import Shape, draw_shapes, make_camera
from decompose.files.names import find_part_number
from decompose.results import Part

EXPLOSION_SHARE = 0.28  # movement of a part away from the middle, as a share of its distance from the middle
AZIMUTH_DEG, ELEVATION_DEG = -58.0, 22.0  # position of the eye: in front, slightly to the right and above
LETTER_WIDTH_PX = 10.0  # width of a letter of a label
OVERVIEW_COLOUR_COUNT = 256
GOLDEN_RATIO = (math.sqrt(5.0) - 1.0) / 2.0


def make_part_colours(count: int) -> Floats:
    """Make distinct colours (count, 3): red, green and blue from 0 to 1. Consecutive colours differ most."""
    colours = [
        hsv_to_rgb((0.58 + GOLDEN_RATIO * i) % 1.0, 0.35 + 0.15 * (i % 3), 0.95 - 0.12 * (i // 3 % 2))
        for i in range(count)
    ]
    return np.array(colours)


def draw_assembly(parts: Sequence[Part], path: Path, long_side_px: int = 1100) -> None:
    """Write a PNG with an exploded view of the parts and their numbers; hidden parts are listed below.

    Parameters
    ----------
    parts
        Parts in the model's frame, in mm; at least one.
    path
        File to write.
    long_side_px
        Longer side of the picture without its margin, in pixels.
    """
    lo_mm = np.min([p.solid.bounds_mm[0] for p in parts], axis=0)
    hi_mm = np.max([p.solid.bounds_mm[1] for p in parts], axis=0)
    middle_mm = (lo_mm + hi_mm) / 2.0
    shapes = []
    for part, colour in zip(parts, make_part_colours(len(parts)), strict=True):
        vertices, faces = part.solid.arrays()
        offset_mm = EXPLOSION_SHARE * (part.solid.bounds_mm.mean(axis=0) - middle_mm)
        shapes.append(Shape((vertices + offset_mm - middle_mm)[faces], colour))
    drawing = draw_shapes(shapes, make_camera(AZIMUTH_DEG, ELEVATION_DEG), long_side_px)
    canvas = Canvas(drawing)
    hidden_labels = canvas.write_labels([find_part_number(part.id) for part in parts])
    if hidden_labels:
        width_px = drawing.front_shapes.shape[1]
        lines = fill(f"behind: {', '.join(hidden_labels)}", max(20, int(width_px / LETTER_WIDTH_PX)))
        canvas.write_lines(0.01 * width_px, 0.01 * width_px, lines)
    path.write_bytes(canvas.encode_png(OVERVIEW_COLOUR_COUNT))
