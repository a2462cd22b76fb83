"""Positions of planes along an axis, clear of the flat faces of a model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats

PLANE_CLEARANCE_MM = 2.0
"""Minimum distance of planes from flat faces, where possible, so that cuts leave no slivers."""
# Minimum total area of the flat faces on one plane for which cuts keep the full PLANE_CLEARANCE_MM.
MIN_SLIVER_MM2 = 25.0
SMALL_CLEARANCE_MM = 0.1  # minimum distance from smaller flat faces, so that they are not taken for cut faces
# Decimal places of coordinates in mm; flat faces that agree to these places lie on one plane.
COORDINATE_DECIMALS = 6


class FlatFaces(NamedTuple):
    """Planes of the flat faces of a mesh that are perpendicular to an axis.

    Attributes
    ----------
    coordinates_mm
        (k,) ascending coordinates of these planes along the axis.
    clearances_mm
        (k,) distances that a cut plane should keep from each of them.
    """

    coordinates_mm: Floats
    clearances_mm: Floats

    def measure_gaps_mm(self, positions_mm: Floats | float, max_clearance_mm: float = np.inf) -> Floats:
        """Measure the distance of each position from the nearest flat face, minus the clearance of that face.

        Parameters
        ----------
        positions_mm
            Positions of planes along the axis, an array of any shape.
        max_clearance_mm
            Upper limit of the clearances.

        Returns
        -------
        ndarray
            Distances in the shape of the positions: negative where a plane is too close to a flat face; inf
            if there are no flat faces.
        """
        distances_mm = np.abs(np.asarray(positions_mm)[..., None] - self.coordinates_mm)
        gaps_mm = distances_mm - np.minimum(self.clearances_mm, max_clearance_mm)
        return np.asarray(gaps_mm.min(axis=-1, initial=np.inf))


NO_FLAT_FACES = FlatFaces(np.zeros(0), np.zeros(0))


def find_flat_faces(triangles: Floats, axis: int) -> FlatFaces:
    """Find the flat faces of a mesh that are perpendicular to an axis.

    Models with rounded edges have hundreds of planes with tiny faces. A sliver beside one of them would be
    too small to matter, so cuts may come close to them.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm.
    axis
        Axis from 0 to 2.
    """
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1)
    is_flat = (np.abs(cross[:, axis]) > (1.0 - 1e-9) * length) & (length > 0.0)
    coordinates_mm, indices = np.unique(
        np.round(triangles[is_flat, 0, axis], COORDINATE_DECIMALS), return_inverse=True
    )
    areas_mm2 = np.bincount(indices, weights=length[is_flat] / 2.0, minlength=len(coordinates_mm))
    return FlatFaces(
        coordinates_mm, np.where(areas_mm2 < MIN_SLIVER_MM2, SMALL_CLEARANCE_MM, PLANE_CLEARANCE_MM)
    )


def place_planes(lo_mm: float, hi_mm: float, count: int, flat_faces: FlatFaces = NO_FLAT_FACES) -> Floats:
    """Place planes: the first and the last one outside the model, the others clear of flat faces.

    A plane is clear if it keeps the clearance of each flat face, or 0.2 cells if that is less. A plane that
    would not be clear is moved to the nearest position at which it is. If there is none within 0.4 cells, the
    plane is moved to the position furthest from all flat faces.

    Parameters
    ----------
    lo_mm, hi_mm
        Ends of the model along the axis.
    count
        Number of cells; there is one plane more.
    flat_faces
        Flat faces of the model along the axis.

    Returns
    -------
    ndarray
        (count + 1,) ascending coordinates in mm.
    """
    pad_mm = 0.01 * (hi_mm - lo_mm) / count + 1e-3
    step_mm = (hi_mm - lo_mm) / count
    planes: Floats = lo_mm + step_mm * np.arange(count + 1, dtype=np.float64)
    planes[0], planes[-1] = lo_mm - pad_mm, hi_mm + pad_mm
    offsets_mm = np.linspace(-0.4, 0.4, 161) * step_mm
    offsets_mm = offsets_mm[np.argsort(np.abs(offsets_mm), kind="stable")]
    for i in range(1, count):
        gaps_mm = flat_faces.measure_gaps_mm(planes[i] + offsets_mm, 0.2 * step_mm)
        candidates = np.flatnonzero(gaps_mm >= 0.0)
        best = candidates[0] if len(candidates) else int(np.argmax(gaps_mm))
        planes[i] += offsets_mm[best]
    return planes
