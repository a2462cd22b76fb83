"""The metaheuristic: many attempts, with fewer and fewer seeds and several draws of each, and the best one.

Fewer seeds leave more printers to the void fill, so that it more often finds enough.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from decompose.boxes import Box, box_index
from decompose.grid import Grid
from decompose.growth import Score, Terrain, grow
from decompose.seeds import seeds
from decompose.voids import fill

Floats = npt.NDArray[np.float64]
Draw = tuple[Score, int, int]  # reading of the score, seeds, and which of the tries
Run = Callable[[Callable[[Draw], "Attempt | None"], Sequence[Draw]], Iterable["Attempt | None"]]


@dataclass(frozen=True, slots=True)
class Attempt:
    """A partition: blocks that cover every needed cell once.

    Attributes
    ----------
    longest
        The greatest P of a block, the paper's parallel score.
    parts
        Pieces in all blocks, as far as the grid can tell.
    """

    blocks: tuple[Box, ...]
    longest: float
    parts: int


def attempt(
    draw: Draw, points: Floats, grid: Grid, terrain: Terrain, printers: int, seed: int
) -> Attempt | None:
    """One attempt; None where it needs more parts than there are printers."""
    score, count, number = draw
    rng = np.random.default_rng([seed, count, number])
    blocks, owner = grow(seeds(points, grid, terrain.barred, count, rng), terrain, score)
    parts = _parts(blocks, terrain)
    filled = fill(blocks, owner, terrain, printers - parts)
    if filled is None or _parts(filled, terrain) > printers:
        return None
    boxes = [(x0, y0, z0, x1, y1, z1) for x0, y0, z0, x1, y1, z1 in filled.tolist()]
    longest = max(float(terrain.printing[box_index(box, grid.shape)]) for box in boxes)
    return Attempt(tuple(boxes), longest, _parts(filled, terrain))


def _parts(blocks: npt.NDArray[np.int64], terrain: Terrain) -> int:
    shape = terrain.needed.shape
    indices = [box_index((*block,), (shape[0], shape[1], shape[2])) for block in blocks.tolist()]
    return int(terrain.pieces[indices].sum())


def attempts(
    points: Floats,
    grid: Grid,
    terrain: Terrain,
    printers: int,
    tries: int,
    score: Score,
    seed: int,
    run: Run = map,
) -> list[Attempt]:
    """All attempts that cover the model, the best first: least parallel score, then fewest parts.

    Parameters
    ----------
    points
        (n, 3) vertices in mm, no two the same.
    tries
        For each number of seeds, from `printers` down to 1.
    run
        As the builtin `map`: calls a function with each of a list, in any order, and returns what it returns
        in that of the list.
    """
    counts = range(printers, 0, -1)
    draws = [(reading, count, n) for reading in score.readings for count in counts for n in range(tries)]

    def one(draw: Draw) -> Attempt | None:
        return attempt(draw, points, grid, terrain, printers, seed)

    with threadpool_limits(1):  # threads of k-means would add up in any order
        found = [result for result in run(one, draws) if result is not None]
    return sorted(found, key=lambda a: (a.longest, a.parts))
