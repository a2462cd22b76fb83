"""Seed blocks: k-means++ on the model's vertices, each centroid moved to a cell of the surface."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from sklearn.cluster import KMeans

from decompose.boxes import Box
from decompose.grid import Cell, Grid

Floats = npt.NDArray[np.float64]


def draw_seeds(
    points: Floats, grid: Grid, barred: npt.NDArray[np.bool_], count: int, rng: np.random.Generator
) -> list[Box]:
    """Cells to grow blocks from, all of them boundary cells and no two the same.

    Parameters
    ----------
    points
        (n, 3) in mm, no two the same: the model's vertices, or the centres of its boundary cells where the
        vertices are fewer than the seeds.
    barred
        (nx, ny, nz) cells that are out of bounds.
    count
        Wanted; never more than there are boundary cells.
    """
    boundary = np.argwhere((grid.cells == Cell.BOUNDARY) & ~barred)
    count = min(count, len(boundary))
    middles = [(p[1:] + p[:-1]) / 2.0 for p in grid.planes]
    centres = np.stack([middles[axis][boundary[:, axis]] for axis in range(3)], axis=1)
    if len(points) < count:
        points = centres
    draw = int(rng.integers(2**31))
    found = KMeans(count, init="k-means++", n_init=1, random_state=draw).fit(points).cluster_centers_
    free = np.ones(len(boundary), dtype=np.bool_)
    chosen: list[Box] = []
    for centroid in found:
        x, y, z = (
            int(np.clip(np.searchsorted(grid.planes[a], centroid[a]) - 1, 0, grid.shape[a] - 1))
            for a in range(3)
        )
        own = free & (boundary == (x, y, z)).all(axis=1)
        gaps = np.where(own, -1.0, np.linalg.norm(centres - centroid, axis=1))
        nearest = int(np.where(free, gaps, np.inf).argmin())
        free[nearest] = False
        x, y, z = boundary[nearest].tolist()
        chosen.append((x, y, z, x + 1, y + 1, z + 1))
    return chosen
