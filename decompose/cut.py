"""Boxes of cells -> pieces: exact cuts in double precision, whose cut faces are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.boxes import Box
from decompose.check import ON_PLANE_MM
from decompose.grid import Grid
from decompose.solid import Solid


def cut_box(solid: Solid, grid: Grid, box: Box) -> list[Solid]:
    """The connected pieces of the solid in a box.

    The first and last planes of the grid lie outside the model, so only inner planes make cut faces.
    """
    return solid.clip(*grid.bounds_mm(box)).pieces()


def cut_faces(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64], box_mm: npt.NDArray[np.float64]
) -> npt.NDArray[np.bool_]:
    """(m,) Which faces of a piece lie on the sides of the box (2, 3) in mm that it was cut out of."""
    on_plane = np.abs(vertices[faces][:, :, None, :] - box_mm) < ON_PLANE_MM
    return np.asarray(on_plane.all(axis=1).reshape(len(faces), 6).any(axis=1))
