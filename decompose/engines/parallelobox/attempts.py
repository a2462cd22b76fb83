"""Metaheuristic: the best of many attempts, with several random sets of seeds for each number of seeds.

The number of seeds decreases from one group of attempts to the next. With fewer seeds, more printers remain
for filling voids, so an attempt succeeds more often.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from decompose.arrays import Bools, Floats, Ints
from decompose.engines.parallelobox.growth import fill_voids, grow_blocks
from decompose.engines.parallelobox.growth_tables import GrowthTables
from decompose.grid import Box, Cell, Grid, index_box
from decompose.options import Score

Seeds = list[Box]
T = TypeVar("T")
R = TypeVar("R")


class MapFunction(Protocol):
    """Function like the builtin `map`, such as that of an executor."""

    def __call__(self, function: Callable[[T], R], arguments: Iterable[T], /) -> Iterable[R]:
        """Call a function with each argument, and return the results in order."""


@dataclass(frozen=True, slots=True)
class BlockPartition:
    """Blocks that cover every needed cell once.

    Attributes
    ----------
    blocks
        Blocks in cells.
    max_price
        Highest price of a block, the paper's P.
    part_count
        Number of pieces in all blocks, as counted on the grid.
    """

    blocks: tuple[Box, ...]
    max_price: float
    part_count: int


@dataclass(frozen=True, slots=True, eq=False)
class SeedSource:
    """Points that are clustered to find seeds, and the cells that may be seeds.

    Attributes
    ----------
    points_mm
        (n, 3) distinct vertices in mm. If there are fewer vertices than seeds, the centres of the boundary
        cells are clustered instead.
    grid
        Grid over the model.
    is_excluded
        (nx, ny, nz) bool, true for cells that may not be seeds.
    """

    points_mm: Floats
    grid: Grid
    is_excluded: Bools


def draw_seed_sets(
    source: SeedSource,
    printer_count: int,
    sets_per_count: int,
    random_seed: int,
    map_function: MapFunction = map,
) -> list[Seeds]:
    """Draw random sets of seeds from which blocks grow: several sets for each number of seeds.

    The number of seeds decreases from `printer_count` to 1.

    Parameters
    ----------
    source
        Points to cluster, and cells that may be seeds.
    printer_count, sets_per_count
        Maximum number of seeds, and number of sets for each number of seeds.
    random_seed
        Seed of the random numbers.
    map_function
        Function that maps over the sets: `map`, or the `map` of an executor.
    """
    draws = [(count, number) for count in range(printer_count, 0, -1) for number in range(sets_per_count)]

    def draw_set(draw: tuple[int, int]) -> Seeds:
        return draw_seeds(source, draw[0], np.random.default_rng([random_seed, *draw]))

    with threadpool_limits(1):  # with more threads, k-means would add numbers in a varying order
        return list(map_function(draw_set, draws))


def run_attempts(
    seed_sets: Sequence[Seeds],
    tables: GrowthTables,
    printer_count: int,
    score: Score,
    map_function: MapFunction = map,
) -> list[BlockPartition]:
    """Run attempts; return those that cover the model, sorted by `max_price`, then by the number of parts.

    Parameters
    ----------
    seed_sets
        Seeds from `draw_seed_sets`.
    tables
        Cells of the grid, and prices that decide how blocks grow.
    printer_count
        Maximum number of parts.
    score
        Interpretation of the score: `LOW` or `HIGH`.
    map_function
        Function that maps over the attempts: `map`, or the `map` of an executor.
    """

    def make_attempt(seeds: Seeds) -> BlockPartition | None:
        return _run_attempt(seeds, tables, printer_count, score)

    results = [result for result in map_function(make_attempt, seed_sets) if result is not None]
    return sorted(results, key=lambda a: (a.max_price, a.part_count))


def _run_attempt(
    seeds: Seeds, tables: GrowthTables, printer_count: int, score: Score
) -> BlockPartition | None:
    """Run one attempt; return None if it needs more parts than there are printers."""
    blocks, owner = grow_blocks(seeds, tables, score)
    all_blocks = fill_voids(blocks, owner, tables, printer_count - _count_parts(blocks, tables))
    if all_blocks is None or _count_parts(all_blocks, tables) > printer_count:
        return None
    boxes = [(x0, y0, z0, x1, y1, z1) for x0, y0, z0, x1, y1, z1 in all_blocks.tolist()]
    shape = tables.shape
    max_price = max(float(tables.printing_prices[index_box(box, shape)]) for box in boxes)
    return BlockPartition(tuple(boxes), max_price, _count_parts(all_blocks, tables))


def _count_parts(blocks: Ints, tables: GrowthTables) -> int:
    """Count the pieces in blocks (n, 6) according to the tables."""
    indices = [index_box((*block,), tables.shape) for block in blocks.tolist()]
    return int(tables.piece_counts[indices].sum())


def _find_centres(points: Floats, count: int, random_state: int) -> Floats:
    """Find the centres (count, 3) of k-means clusters of points (n, 3), from a random state."""
    with warnings.catch_warnings():
        # Without /dev/shm joblib lacks semaphores and warns, although k-means does not need them.
        warnings.filterwarnings("ignore", message=".*joblib will operate in serial mode")
        # This package is slow to import, and only this engine needs it.
        from sklearn.cluster import KMeans
    centres: Floats = (
        KMeans(count, init="k-means++", n_init=1, random_state=random_state).fit(points).cluster_centers_
    )
    return centres


def draw_seeds(source: SeedSource, count: int, rng: np.random.Generator) -> list[Box]:
    """Draw the seeds of one set: distinct boundary cells.

    Parameters
    ----------
    source
        Points to cluster, and cells that may be seeds.
    count
        Number of seeds; fewer are drawn if there are fewer boundary cells.
    rng
        Generator of random numbers.
    """
    points, grid = source.points_mm, source.grid
    boundary = np.argwhere((grid.cells == Cell.BOUNDARY) & ~source.is_excluded)
    count = min(count, len(boundary))
    middles_mm = [(p[1:] + p[:-1]) / 2.0 for p in grid.planes]
    cell_centres_mm = np.stack([middles_mm[axis][boundary[:, axis]] for axis in range(3)], axis=1)
    if len(points) < count:
        points = cell_centres_mm
    random_state = int(rng.integers(2**31))
    cluster_centres = _find_centres(points, count, random_state)
    is_available = np.ones(len(boundary), dtype=np.bool_)
    seeds: list[Box] = []
    for centre in cluster_centres:
        x, y, z = (
            int(np.clip(np.searchsorted(grid.planes[a], centre[a]) - 1, 0, grid.shape[a] - 1))
            for a in range(3)
        )
        contains_centre = is_available & (boundary == (x, y, z)).all(axis=1)
        gaps_mm = np.where(contains_centre, -1.0, np.linalg.norm(cell_centres_mm - centre, axis=1))
        nearest = int(np.where(is_available, gaps_mm, np.inf).argmin())
        is_available[nearest] = False
        x, y, z = boundary[nearest].tolist()
        seeds.append((x, y, z, x + 1, y + 1, z + 1))
    return seeds
