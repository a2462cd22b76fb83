"""Contours of a part: rims of flat faces, and rings of denser infill under slopes.

The `ADDITIVE_FEATURES` do not include contours. A rim is an edge between a face with skin and a steeper face.
At a rim, the slicer prints walls instead of skin; but if a wall rises from the rim, it prints additional skin
below this wall. A ring is a ring-shaped strip below a slope, in which gradual infill is denser. In this
module, n is the upward component of a face's unit normal, and A is the area of the face.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.surfaces import Surfaces

RISING_WALL_FACTOR = 1.5
"""Width of the additional skin below a wall that rises from a flat face, as a multiple of the width of all
wall lines together: Cura expands skin beyond the walls. Measured on a block that stands on another block."""


class Contours(NamedTuple):
    """Sums over the edges and the slopes of a part in a pose.

    Attributes
    ----------
    rim_mm
        Weighted length of the rims, as seen from above. The weight of a rim is |n| of the face with skin
        minus |n| of the steeper face. If the steeper face rises from the rim, the weight is also multiplied
        by -`RISING_WALL_FACTOR`.
    rim_ends_mm
        The same length without the factor -`RISING_WALL_FACTOR`, because lines of skin end at every rim.
    ring_mm2
        Sum of A sqrt(1 - n^2) over the slopes below which infill is denser.
    steep_top_mm2
        Area, as seen from above, of the slopes with denser infill below them and without skin.
    """

    rim_mm: float
    rim_ends_mm: float
    ring_mm2: float
    steep_top_mm2: float


def measure_contours(mesh: PartMesh, up: Floats, skin_cos: float, ring_cos: float) -> Contours:
    """Measure the contours of a part in a pose.

    Parameters
    ----------
    mesh
        Mesh of the part; faces share the vertices of their common edges.
    up
        (3,) unit vector that points up.
    skin_cos, ring_cos
        Limits of |n| above which a face has skin, and of n above which there is denser infill below it; see
        `CostModel`.
    """
    surfaces = mesh.surfaces
    return Contours(
        *_sum_rims_mm(mesh.vertices, mesh.faces, surfaces.normals, up, mesh.edges, skin_cos),
        *_sum_slopes_mm2(surfaces, up, skin_cos, ring_cos),
    )


@jit
def _sum_slopes_mm2(surfaces: Surfaces, up: Floats, skin_cos: float, ring_cos: float) -> tuple[float, float]:
    """Sum the areas of the slopes with denser infill below them.

    Parameters
    ----------
    surfaces
        Faces of the mesh.
    up
        (3,) float64 unit vector that points up.
    skin_cos, ring_cos
        As in `measure_contours`.

    Returns
    -------
    tuple
        `ring_mm2` and `steep_top_mm2` of `Contours`.
    """
    ring_mm2, steep_top_mm2 = 0.0, 0.0
    for i in range(len(surfaces.areas_mm2)):
        n = 0.0
        for axis in range(3):
            n += surfaces.normals[i, axis] * up[axis]
        if n > ring_cos:
            ring_mm2 += surfaces.areas_mm2[i] * np.sqrt(max(0.0, 1.0 - n * n))
            if n <= skin_cos:
                steep_top_mm2 += surfaces.areas_mm2[i] * n
    return ring_mm2, steep_top_mm2


@jit
def _sum_rims_mm(
    vertices: Floats, faces: Ints, normals: Floats, up: Floats, edges: Ints, skin_cos: float
) -> tuple[float, float]:
    """Sum the lengths of the rims: edges between a face with skin and a steeper face without skin.

    Parameters
    ----------
    vertices, faces
        (n, 3) float64 in mm and (m, 3) int64.
    normals
        (m, 3) float64 unit normals of the faces.
    up
        (3,) float64 unit vector that points up.
    edges
        (k, 2) int64 pairs of half-edges, by `pair_half_edges`.
    skin_cos
        Limit of |n| above which a face has skin.

    Returns
    -------
    tuple
        `rim_mm` and `rim_ends_mm` of `Contours`.
    """
    rim_mm, rim_ends_mm = 0.0, 0.0
    has_skin = np.zeros(len(faces), np.bool_)
    for i in range(len(faces)):
        has_skin[i] = abs(normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]) > skin_cos
    for e in range(len(edges)):
        first, second = edges[e]
        if has_skin[first // 3] == has_skin[second // 3]:
            continue
        if has_skin[second // 3]:
            first, second = second, first
        flat, steep, corner = first // 3, second // 3, first % 3
        a, b = faces[flat, corner], faces[flat, (corner + 1) % 3]
        apex = faces[steep, (second % 3 + 2) % 3]
        rise, squared_length, apex_offset, n_flat, n_steep = 0.0, 0.0, 0.0, 0.0, 0.0
        for axis in range(3):
            along = vertices[b, axis] - vertices[a, axis]
            rise += along * up[axis]
            squared_length += along * along
            apex_offset += (vertices[apex, axis] - vertices[a, axis]) * normals[flat, axis]
            n_flat += normals[flat, axis] * up[axis]
            n_steep += normals[steep, axis] * up[axis]
        length_mm = np.sqrt(max(0.0, squared_length - rise * rise)) * (abs(n_flat) - abs(n_steep))
        rim_ends_mm += length_mm
        rim_mm += length_mm if apex_offset < 0.0 else -RISING_WALL_FACTOR * length_mm
    return rim_mm, rim_ends_mm
