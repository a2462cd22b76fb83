"""Stability of a glued body on the table while the next body is put on top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.geometry import Solid, choose_plane_axes, find_convex_outline, find_half_planes

MAX_CONTACT_HEIGHT_MM = 0.1  # points up to this height above the lowest point count as touching the table
MIN_STABILITY_MM = 2.0  # minimum distance in plan from the centre of mass to the border of the contact area


@dataclass(frozen=True, slots=True, eq=False)
class MassProperties:
    """Points (n, 3) on a part's surface in mm, its volume in mm3, and its centre of mass (3,) in mm."""

    points_mm: Floats
    volume_mm3: float
    centre_mm: Floats

    @classmethod
    def from_solid(cls, solid: Solid) -> MassProperties:
        """Compute the mass properties of a solid of uniform density.

        The centre of mass is that of the tetrahedra between each face and the mean of the vertices.
        """
        vertices, faces = solid.arrays()
        base = vertices.mean(axis=0)
        a, b, c = (vertices[faces[:, k]] - base for k in range(3))
        volumes_mm3 = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
        return cls(vertices, solid.volume_mm3, base + volumes_mm3 @ (a + b + c) / (4.0 * volumes_mm3.sum()))


def find_resting_parts(
    mass_properties: Sequence[MassProperties], body: Sequence[int], up_direction: Floats
) -> tuple[int, ...]:
    """Find the parts on which a body stands without falling over.

    Parameters
    ----------
    mass_properties
        Mass properties of all parts, in one frame.
    body
        Numbers of the parts in the body.
    up_direction
        (3,) unit vector that points up.

    Returns
    -------
    tuple of int
        Parts that touch the table; empty if the body would fall over.
    """
    frame = choose_plane_axes(up_direction)
    heights_mm = {number: mass_properties[number].points_mm @ up_direction for number in body}
    table_mm = min(float(height_mm.min()) for height_mm in heights_mm.values()) + MAX_CONTACT_HEIGHT_MM
    contacts = {
        number: mass_properties[number].points_mm[height_mm < table_mm]
        for number, height_mm in heights_mm.items()
    }
    edges = find_half_planes(find_convex_outline(np.concatenate(list(contacts.values())) @ frame.T))
    if not len(edges):
        return ()
    volumes_mm3 = np.array([mass_properties[number].volume_mm3 for number in body])
    centre_mm = frame @ (
        volumes_mm3 @ np.array([mass_properties[number].centre_mm for number in body]) / volumes_mm3.sum()
    )
    if float((edges[:, :2] @ centre_mm + edges[:, 2]).max()) > -MIN_STABILITY_MM:
        return ()
    return tuple(number for number, points in contacts.items() if len(points))
