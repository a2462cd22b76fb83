"""A rectilinear grid over a model, and tables with an entry for every axis-aligned box of its cells."""

from __future__ import annotations

from decompose.grid.box_index import (
    Box,
    Shape,
    compute_index,
    find_box,
    find_interval_ends,
    index_box,
    index_interval,
    sum_box,
)
from decompose.grid.boxes import BoxTables, price_boxes
from decompose.grid.clipping import OVERHANG, VOLUME
from decompose.grid.grid import (
    GRANULARITIES,
    Cell,
    Grid,
    GridRules,
    build_grid,
    choose_cell_counts,
    count_cuts,
    fill_grid,
)
from decompose.grid.needed_cells import SAME_PLANE_MM, NeededCells, refine_cells
from decompose.grid.planes import (
    PLANE_CLEARANCE_MM,
    FlatFaces,
    find_flat_faces,
    place_planes,
)
from decompose.grid.threads import SHARE_COUNT, run_shares

__all__ = [
    "GRANULARITIES",
    "OVERHANG",
    "PLANE_CLEARANCE_MM",
    "SAME_PLANE_MM",
    "SHARE_COUNT",
    "VOLUME",
    "Box",
    "BoxTables",
    "Cell",
    "FlatFaces",
    "Grid",
    "GridRules",
    "NeededCells",
    "Shape",
    "build_grid",
    "choose_cell_counts",
    "compute_index",
    "count_cuts",
    "fill_grid",
    "find_box",
    "find_flat_faces",
    "find_interval_ends",
    "index_box",
    "index_interval",
    "place_planes",
    "price_boxes",
    "refine_cells",
    "run_shares",
    "sum_box",
]
