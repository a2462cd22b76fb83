"""A rectilinear grid over a model, and tables over all axis-aligned boxes of its cells."""

from __future__ import annotations

from decompose.grid.box_index import Box, Shape, box_at, box_index, index_of, interval
from decompose.grid.boxes import BoxTables, price_boxes
from decompose.grid.clipping import OVERHANG, VOLUME
from decompose.grid.grid import (
    CLEAR_MM,
    GRANULARITY,
    Cell,
    Grid,
    build_grid,
    cell_counts,
    fill_grid,
    flat_coordinates,
)
from decompose.grid.interfaces import fill_out_boxes, free_directions, group_faces, keep_clear, move_groups
from decompose.grid.needed_cells import NeededCells, refine_cells

__all__ = [
    "CLEAR_MM",
    "GRANULARITY",
    "OVERHANG",
    "VOLUME",
    "Box",
    "BoxTables",
    "Cell",
    "Grid",
    "NeededCells",
    "Shape",
    "box_at",
    "box_index",
    "build_grid",
    "cell_counts",
    "fill_grid",
    "fill_out_boxes",
    "flat_coordinates",
    "free_directions",
    "group_faces",
    "index_of",
    "interval",
    "keep_clear",
    "move_groups",
    "price_boxes",
    "refine_cells",
]
