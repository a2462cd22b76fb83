"""Length of the travel between islands of a layer, in the order in which a slicer visits them.

CuraEngine prints all supports of a layer first, then the part. From an island it travels to the nearest one
that is not printed yet.
"""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit


@jit
def measure_tour_cells(stretches: Ints, parent: Ints, support_count: int, island_count: int) -> float:
    """Measure the way from each island to the next one, between their centres, in cells.

    Parameters
    ----------
    stretches
        (stretches, 4) int64 kind (1 for solid, 2 for support), first and last cell, and row of each stretch.
    parent
        (stretches,) int64 parents of the stretches in a forest with a tree for each island; the root of a
        tree is its first stretch.
    support_count, island_count
        Number of islands of the support, and number of all islands.
    """
    centres = _find_centres(stretches, parent, support_count, island_count)
    tour_cells = 0.0
    # Islands before `visited` are part of the tour; the last one of them is where the nozzle is.
    for visited in range(1, island_count):
        end = support_count if visited < support_count else island_count
        nearest, nearest_square = visited, np.inf
        for k in range(visited, end):
            di, dj = centres[k, 0] - centres[visited - 1, 0], centres[k, 1] - centres[visited - 1, 1]
            square = di * di + dj * dj
            if square < nearest_square:
                nearest, nearest_square = k, square
        tour_cells += np.sqrt(nearest_square)
        for axis in range(2):
            centre = centres[nearest, axis]
            centres[nearest, axis] = centres[visited, axis]
            centres[visited, axis] = centre
    return tour_cells


@jit
def _find_centres(stretches: Ints, parent: Ints, support_count: int, island_count: int) -> Floats:
    """Find the centres (island_count, 2) of islands in cells, those of the support first.

    Parameters
    ----------
    stretches, parent, support_count, island_count
        As in `measure_tour_cells`.
    """
    sums = np.zeros((island_count, 3))  # of the rows and the columns of an island's cells, and their number
    islands = np.zeros(len(stretches), np.int64)  # island of each root
    support, body = 0, support_count  # next island of each kind
    for s in range(len(stretches)):
        kind, first, last, row = stretches[s]
        root = s
        while parent[root] != root:
            root = parent[root]
        if root == s and kind == 2:
            islands[s] = support
            support += 1
        elif root == s:
            islands[s] = body
            body += 1
        island, length = islands[root], last + 1 - first
        sums[island, 0] += length * row
        sums[island, 1] += length * (first + last) / 2.0
        sums[island, 2] += length
    return sums[:, :2] / sums[:, 2:]
