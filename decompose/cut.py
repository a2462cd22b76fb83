"""Boxes of cells -> solids: exact cuts in double precision."""

from __future__ import annotations

from decompose.boxes import Box
from decompose.grid import Grid
from decompose.solid import Solid


def cut_box(solid: Solid, grid: Grid, box: Box) -> list[Solid]:
    """The connected pieces of the solid in a box.

    The first and last planes of the grid lie outside the model, so only inner planes make cut faces.
    """
    return solid.clip(*grid.bounds_mm(box)).pieces()
