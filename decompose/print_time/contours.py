"""Contours, which sums over faces do not show: rims of flat faces, rings of denser infill under slopes.

A slicer prints no skin where the walls stand at the rim of a flat face, and more of it under a wall that
rises from one. Gradual infill is denser in a ring below each slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.jit import jit

RISING_SHARE = 1.5
"""Width by which skin goes on under a wall that rises from it, over the width of the walls that stand at an
edge: under the walls, and further by what Cura expands it. Measured on a block that stands on another."""


class Contours(NamedTuple):
    """Sums over the edges and the slopes of a part in a pose.

    Attributes
    ----------
    rim_mm
        Length of the rims of faces with skin, as seen from above, each times the share of a right angle by
        which the face beside it is steeper; negative, and `RISING_SHARE` times, where that face rises there.
    ends_mm
        The same without a sign: the ends of lines of skin.
    ring_mm2
        Sum of A sqrt(1 - n^2) over the slopes below which infill is denser.
    steep_top_mm2
        Area of the slopes among them without skin, as seen from above.
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
        (n, 3) in mm and (m, 3), outward; faces share the vertices of their edges.
    up
        (3,) unit vector.
    skin_cos, ring_cos
        Of `CostModel`.
    """
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled_areas = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(doubled_areas, 1e-300)[:, None]
    heights = normals @ up
    upright = doubled_areas / 2.0 * np.sqrt(np.maximum(0.0, 1.0 - heights**2))
    ring = heights > ring_cos
    steep = ring & (heights <= skin_cos)
    first, second = _pair_edges(faces, len(vertices), np.abs(heights) > skin_cos)
    lengths = _sum_rims_mm(vertices, faces, normals, up, np.stack([first, second], axis=1))
    return Contours(*lengths, float(upright[ring].sum()), float((doubled_areas / 2.0 * heights)[steep].sum()))


def _pair_edges(faces: Ints, vertices: int, flat: Bools) -> tuple[Ints, Ints]:
    """Pair the half-edges (k,), as three times the face plus the corner, of edges between flat and steep."""
    next_corners = np.roll(faces, -1, axis=1)
    keys = (
        np.minimum(faces, next_corners).astype(np.int64) * vertices + np.maximum(faces, next_corners)
    ).ravel()
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    first, second = order[same], order[same + 1]
    rim = flat[first // 3] != flat[second // 3]
    flat_first = flat[first // 3][rim]
    first, second = first[rim], second[rim]
    return np.where(flat_first, first, second), np.where(flat_first, second, first)


@jit
def _sum_rims_mm(
    vertices: Floats, faces: Ints, normals: Floats, up: Floats, edges: Ints
) -> tuple[float, float]:
    """Sum the rims at half-edges (k, 2) of a flat face and a steep one beside it: with and without sign."""
    signed, total = 0.0, 0.0
    for e in range(len(edges)):
        flat, steep = edges[e, 0] // 3, edges[e, 1] // 3
        corner = edges[e, 0] % 3
        a, b = faces[flat, corner], faces[flat, (corner + 1) % 3]
        apex = faces[steep, (edges[e, 1] % 3 + 2) % 3]
        rise, square, outside, n_flat, n_steep = 0.0, 0.0, 0.0, 0.0, 0.0
        for axis in range(3):
            along = vertices[b, axis] - vertices[a, axis]
            rise += along * up[axis]
            square += along * along
            outside += (vertices[apex, axis] - vertices[a, axis]) * normals[flat, axis]
            n_flat += normals[flat, axis] * up[axis]
            n_steep += normals[steep, axis] * up[axis]
        length = np.sqrt(max(0.0, square - rise * rise)) * (abs(n_flat) - abs(n_steep))
        total += length
        signed += length if outside < 0.0 else -RISING_SHARE * length
    return signed, total
