"""Mesh of a part, with the properties that are the same in all its poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.jit import jit
from decompose.print_time.surfaces import Surfaces, measure_surfaces


@dataclass(frozen=True, eq=False)
class PartMesh:
    """Closed mesh of a part: vertices (n, 3) in mm, outward faces (m, 3), and a mask (m,) of cut faces."""

    vertices: Floats
    faces: Ints
    is_cut: Bools

    @cached_property
    def surfaces(self) -> Surfaces:
        """Normals, areas and centres of the faces."""
        return measure_surfaces(self.vertices, self.faces)

    @cached_property
    def edges(self) -> Ints:
        """Pairs (k, 2) of half-edges, one for each edge."""
        return pair_half_edges(self.faces, len(self.vertices))


@jit
def pair_half_edges(faces: Ints, vertex_count: int) -> Ints:
    """Pair the two half-edges of each edge.

    Each half-edge is stored in the list of its lower-numbered vertex until the other half of the same edge is
    found.

    Parameters
    ----------
    faces
        (m, 3) int64 vertices of the faces.
    vertex_count
        Number of vertices.

    Returns
    -------
    ndarray
        (k, 2) int64 half-edges of each edge, each as three times its face plus its corner.
    """
    start = np.zeros(vertex_count + 1, np.int64)
    for i in range(len(faces)):
        for corner in range(3):
            start[min(faces[i, corner], faces[i, (corner + 1) % 3]) + 1] += 1
    for vertex in range(vertex_count):
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
