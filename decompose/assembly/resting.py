"""Stability of a glued body on the table while the next one is put on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.geometry import Solid, choose_plane_axes, find_convex_outline, find_half_planes

ON_TABLE_MM = 0.1  # maximum height above the lowest point at which points touch the table
STEADY_MM = 2.0  # minimum distance of the centre of mass inside the border of the contact area


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """Points (n, 3) on a part's surface in mm, its volume in mm3, and its centre of mass (3,) in mm."""

    points: Floats
    volume_mm3: float
    centre: Floats

    @classmethod
    def from_solid(cls, solid: Solid) -> Weight:
        """Compute the centre of mass of a solid of uniform density, by the tetrahedra below its faces."""
        vertices, faces = solid.arrays()
        base = vertices.mean(axis=0)
        a, b, c = (vertices[faces[:, k]] - base for k in range(3))
        volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
        return cls(vertices, solid.volume_mm3, base + volumes @ (a + b + c) / (4.0 * volumes.sum()))


def find_resting_parts(weights: Sequence[Weight], body: Sequence[int], up: Floats) -> tuple[int, ...]:
    """Find the parts on which a body stands without falling over.

    Parameters
    ----------
    weights
        All parts, in one frame.
    body
        Numbers of the parts in the body.
    up
        (3,) unit vector that points up.

    Returns
    -------
    tuple of int
        Parts that touch the table; empty if the body would fall over.
    """
    frame = choose_plane_axes(up)
    heights = {number: weights[number].points @ up for number in body}
    table_mm = min(float(height.min()) for height in heights.values()) + ON_TABLE_MM
    contacts = {number: weights[number].points[height < table_mm] for number, height in heights.items()}
    edges = find_half_planes(find_convex_outline(np.concatenate(list(contacts.values())) @ frame.T))
    if not len(edges):
        return ()
    masses = np.array([weights[number].volume_mm3 for number in body])
    centre = frame @ (masses @ np.array([weights[number].centre for number in body]) / masses.sum())
    if float((edges[:, :2] @ centre + edges[:, 2]).max()) > -STEADY_MM:
        return ()
    return tuple(number for number, points in contacts.items() if len(points))
