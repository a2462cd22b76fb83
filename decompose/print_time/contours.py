"""Contours, which sums over faces do not show: rims of flat faces, and rings of denser infill under slopes.

A slicer prints no skin under the walls at the rim of a flat face, and additional skin under a wall that rises
from such a face. Gradual infill is denser in a ring below each slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit
from decompose.print_time.surfaces import Surfaces, measure_surfaces

RISING_WALL_FACTOR = 1.5
"""Width of the skin that continues under a wall rising from it, as a multiple of the width of the walls at an
edge: Cura expands skin beyond the walls. Measured on a block that stands on another."""


class Contours(NamedTuple):
    """Sums over the edges and the slopes of a part in a pose.

    Attributes
    ----------
    rim_mm
        Weighted length of the rims of faces with skin, as seen from above. The weight is the difference
        between |n| of the face and |n| of the steeper face beside it, multiplied by -`RISING_WALL_FACTOR` if
        the steeper face rises.
    ends_mm
        The same length without the factor -`RISING_WALL_FACTOR`, because lines of skin end at all rims.
    ring_mm2
        Sum of A sqrt(1 - n^2) over the slopes below which infill is denser.
    steep_top_mm2
        Area, as seen from above, of the slopes with denser infill below them and without skin.
    """

    rim_mm: float
    ends_mm: float
    ring_mm2: float
    steep_top_mm2: float


def measure_contours(vertices: Floats, faces: Ints, up: Floats, skin_cos: float, ring_cos: float) -> Contours:
    """Measure the contours of a closed mesh in a pose.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3), outward; faces share the vertices of their common edges.
    up
        (3,) unit vector.
    skin_cos, ring_cos
        Limits of slopes with skin, and with denser infill below them; see `CostModel`.
    """
    surfaces = measure_surfaces(vertices, faces)
    edges = _pair_half_edges(faces, len(vertices))
    return Contours(
        *_sum_rims_mm(vertices, faces, surfaces.normals, up, edges, skin_cos),
        *_sum_slopes_mm2(surfaces, up, skin_cos, ring_cos),
    )


@jit
def _pair_half_edges(faces: Ints, vertices: int) -> Ints:
    """Pair the two half-edges of each edge.

    Half-edges are stored in lists by the lower of their vertices until the other half of their edge follows.

    Parameters
    ----------
    faces
        (m, 3) int64 vertices of the faces.
    vertices
        Number of vertices.

    Returns
    -------
    ndarray
        (k, 2) int64 half-edges of each edge, each as three times its face plus its corner.
    """
    start = np.zeros(vertices + 1, np.int64)
    for i in range(len(faces)):
        for corner in range(3):
            start[min(faces[i, corner], faces[i, (corner + 1) % 3]) + 1] += 1
    for vertex in range(vertices):
        start[vertex + 1] += start[vertex]
    ends = start[:-1].copy()
    stored, pairs = np.zeros((start[-1], 2), np.int64), np.zeros((start[-1], 2), np.int64)
    count = 0
    for i in range(len(faces)):
        for corner in range(3):
            a, b = faces[i, corner], faces[i, (corner + 1) % 3]
            low, high = min(a, b), max(a, b)
            slot = start[low]
            while slot < ends[low] and stored[slot, 0] != high:
                slot += 1
            if slot < ends[low]:
                pairs[count, 0], pairs[count, 1] = stored[slot, 1], 3 * i + corner
                count += 1
            else:
                ends[low] += 1
            stored[slot, 0], stored[slot, 1] = high, 3 * i + corner
    return pairs[:count].copy()


@jit
def _sum_slopes_mm2(surfaces: Surfaces, up: Floats, skin_cos: float, ring_cos: float) -> tuple[float, float]:
    """Sum the areas of the slopes with denser infill below them.

    Parameters
    ----------
    surfaces
        Faces of the mesh.
    up
        (3,) float64 unit vector.
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
    """Sum the rims, which are edges between a face with skin and a steeper face without skin.

    Parameters
    ----------
    vertices, faces
        (n, 3) float64 in mm and (m, 3) int64.
    normals
        (m, 3) float64 unit normals of the faces.
    up
        (3,) float64 unit vector.
    edges
        (k, 2) int64 pairs of half-edges, by `_pair_half_edges`.
    skin_cos
        Limit of slopes with skin.

    Returns
    -------
    tuple
        `rim_mm` and `ends_mm` of `Contours`.
    """
    rim_mm, ends_mm = 0.0, 0.0
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
        ends_mm += length_mm
        rim_mm += length_mm if apex_offset < 0.0 else -RISING_WALL_FACTOR * length_mm
    return rim_mm, ends_mm
