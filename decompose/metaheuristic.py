"""The metaheuristic: many attempts, with fewer and fewer seeds and several draws of each, and the best one.

Fewer seeds leave more printers to the void fill, so that it more often finds enough.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from decompose.boxes import Box, box_index
from decompose.grid import Grid
from decompose.growth import Bools, Ints, Score, Terrain, grow_blocks
from decompose.seeds import draw_seeds
from decompose.voids import fill_voids

Floats = npt.NDArray[np.float64]
Seeds = list[Box]
T = TypeVar("T")
R = TypeVar("R")


class Run(Protocol):
    """As the builtin `map`: calls a function with each, in any order, and returns the answers in theirs."""

    def __call__(self, function: Callable[[T], R], each: Iterable[T], /) -> Iterable[R]: ...


@dataclass(frozen=True, slots=True)
class BlockPartition:
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


def draw_seed_sets(
    points: Floats, grid: Grid, barred: Bools, printers: int, tries: int, seed: int, run: Run = map
) -> list[Seeds]:
    """The seeds to grow blocks from: `tries` draws of each number from `printers` down to 1.

    Parameters
    ----------
    points
        (n, 3) vertices in mm, no two the same.
    barred
        (nx, ny, nz) cells that are out of bounds.
    """
    wanted = [(count, number) for count in range(printers, 0, -1) for number in range(tries)]

    def one(draw: tuple[int, int]) -> Seeds:
        return draw_seeds(points, grid, barred, draw[0], np.random.default_rng([seed, *draw]))

    with threadpool_limits(1):  # threads of k-means would add up in any order
        return list(run(one, wanted))


def run_attempts(
    drawn: Sequence[Seeds], terrain: Terrain, printers: int, score: Score, run: Run = map
) -> list[BlockPartition]:
    """All attempts that cover the model, the best first: least parallel score, then fewest parts.

    Parameters
    ----------
    drawn
        From `draws`.
    score
        A reading of it, low or high.
    """

    def one(seeds: Seeds) -> BlockPartition | None:
        return _attempt(seeds, terrain, printers, score)

    found = [result for result in run(one, drawn) if result is not None]
    return sorted(found, key=lambda a: (a.longest, a.parts))


def _attempt(seeds: Seeds, terrain: Terrain, printers: int, score: Score) -> BlockPartition | None:
    """One attempt; None where it needs more parts than there are printers."""
    blocks, owner = grow_blocks(seeds, terrain, score)
    filled = fill_voids(blocks, owner, terrain, printers - _parts(blocks, terrain))
    if filled is None or _parts(filled, terrain) > printers:
        return None
    boxes = [(x0, y0, z0, x1, y1, z1) for x0, y0, z0, x1, y1, z1 in filled.tolist()]
    shape = terrain.shape
    longest = max(float(terrain.printing[box_index(box, shape)]) for box in boxes)
    return BlockPartition(tuple(boxes), longest, _parts(filled, terrain))


def _parts(blocks: Ints, terrain: Terrain) -> int:
    indices = [box_index((*block,), terrain.shape) for block in blocks.tolist()]
    return int(terrain.pieces[indices].sum())
