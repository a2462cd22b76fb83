"""Block growth: blocks of cells grow from seeds, one layer at a time, until none can grow.

Among the blocks that can grow, the cheapest one grows next, in the direction with the best score. The score
is ``|P + O|`` times the proximity of the block to other blocks, where P and O are the printing price and the
overhang price of the grown block. The paper calls higher scores better (section "Objective") although P and O
are costs, so `Score` has both interpretations; if lower scores are better, ``|P + O|`` is divided by the
proximity. A direction is forbidden if the grown block would leave the grid, not fit a printer, gain no needed
cell, take a cell that has an owner, or consist of more pieces than before.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Float32s, Ints
from decompose.engines.parallelobox.growth_tables import GrowthTables
from decompose.grid import Box, compute_index
from decompose.jit import jit
from decompose.options import Score

FREE_CELL, EXCLUDED_CELL = -1, -2


@jit
def _find_block_index(block: Ints, shape: tuple[int, int, int]) -> int:
    """Compute the index of a block among all boxes of a grid.

    Parameters
    ----------
    block
        (6,) int64 in cells, half-open.
    shape
        Shape of the grid, in cells.
    """
    return compute_index((block[0], block[1], block[2], block[3], block[4], block[5]), shape)


@jit
def find_grown_index(
    block: Ints,
    direction: int,
    owner: Ints,
    is_needed: Bools,
    seconds: npt.NDArray[np.float32],
    piece_counts: npt.NDArray[np.int16],
) -> int:
    """Find the index of the box into which a block grows; -1 if a constraint forbids the growth.

    Parameters
    ----------
    block
        (6,) int64 of x0, y0, z0, x1, y1, z1 in cells, half-open.
    direction
        0 to 5: -x, -y, -z, +x, +y, +z.
    owner
        (nx, ny, nz) int64 number of the block that owns each cell, `FREE_CELL` or `EXCLUDED_CELL`.
    is_needed
        (nx, ny, nz) bool, true for cells that must be covered.
    seconds, piece_counts
        (boxes,) float32 in s and (boxes,) int16 of `GrowthTables`.
    """
    axis = direction % 3
    grown_block = block.copy()
    layer = block.copy()
    if direction < 3:
        grown_block[axis] -= 1
        layer[axis], layer[axis + 3] = grown_block[axis], block[axis]
    else:
        grown_block[direction] += 1
        layer[axis], layer[axis + 3] = block[direction], grown_block[direction]
    if grown_block[axis] < 0 or grown_block[axis + 3] > owner.shape[axis]:
        return -1
    gains_needed_cell = False
    for x in range(layer[0], layer[3]):
        for y in range(layer[1], layer[4]):
            for z in range(layer[2], layer[5]):
                if owner[x, y, z] != FREE_CELL:
                    return -1
                gains_needed_cell = gains_needed_cell or is_needed[x, y, z]
    if not gains_needed_cell:
        return -1
    grown_index = _find_block_index(grown_block, owner.shape)
    current_index = _find_block_index(block, owner.shape)
    if not np.isfinite(seconds[grown_index]) or piece_counts[grown_index] > piece_counts[current_index]:
        return -1
    return grown_index


@jit
def claim_cells(block: Ints, number: int, owner: Ints) -> None:
    """Make a block the owner of all its cells.

    Parameters
    ----------
    block
        (6,) int64 in cells, half-open.
    number
        Number of the block.
    owner
        (nx, ny, nz) int64 number of the block that owns each cell; updated in place.
    """
    owner[block[0] : block[3], block[1] : block[4], block[2] : block[5]] = number


@jit
def _compute_proximity(blocks: Ints, number: int, direction: int, grid_length: int) -> float:
    """Compute the proximity of a block to the other blocks in its direction of growth, the paper's S_prox.

    The proximity is 0.5 if another block in this direction touches the block, and 1 if none is within the
    length of the grid. The gap between two blocks is the L1 distance of their centres, minus half the sum of
    all their sides, as in the paper. The paper's program divides the gap by twice the length of the grid, and
    adds 0.5; otherwise a touching block would prevent all growth.

    Parameters
    ----------
    blocks
        (k, 6) int64 in cells, half-open.
    number, direction
        Number of the block, and direction in which it grows, as in `find_grown_index`.
    grid_length
        Length of the grid in cells: the sum of its sides.
    """
    axis = direction % 3
    nearest = 1.0
    for other_number in range(len(blocks)):
        offset = (
            blocks[other_number, axis]
            + blocks[other_number, axis + 3]
            - blocks[number, axis]
            - blocks[number, axis + 3]
        )
        if other_number == number or (offset <= 0 if direction >= 3 else offset >= 0):
            continue
        gap = 0.0
        for k in range(3):
            a0, a1 = blocks[number, k], blocks[number, k + 3]
            b0, b1 = blocks[other_number, k], blocks[other_number, k + 3]
            gap += abs(a0 + a1 - b0 - b1) / 2.0 - (a1 - a0 + b1 - b0) / 2.0
        nearest = min(nearest, 0.5 + 0.5 * max(0.0, gap) / grid_length)
    return nearest


@jit
def _grow_all_blocks(
    blocks: Ints,
    owner: Ints,
    is_needed: Bools,
    tables: tuple[Float32s, npt.NDArray[np.int16], Float32s, Float32s],
    prefers_high_score: bool,
) -> None:
    """Grow blocks, in place, until none can grow.

    Parameters
    ----------
    blocks
        (k, 6) int64, in cells, half-open.
    owner
        (nx, ny, nz) int64 number of the block that owns each cell, `FREE_CELL` or `EXCLUDED_CELL`; updated
        in place.
    is_needed
        (nx, ny, nz) bool, true for cells that must be covered.
    tables
        (boxes,) `seconds`, `piece_counts`, `printing_prices` and `overhang_prices` of `GrowthTables`.
    prefers_high_score
        Whether the highest score is the best one; otherwise the lowest one is.
    """
    seconds, piece_counts, printing, overhang = tables
    nx, ny, nz = owner.shape
    prices = np.zeros(len(blocks))
    for i in range(len(blocks)):
        claim_cells(blocks[i], i, owner)
        prices[i] = printing[_find_block_index(blocks[i], owner.shape)]
    while len(blocks):
        cheapest = int(np.argmin(prices))
        if prices[cheapest] == np.inf:
            return
        best_direction, best_score, best_price = -1, 0.0, 0.0
        for direction in range(6):
            index = find_grown_index(blocks[cheapest], direction, owner, is_needed, seconds, piece_counts)
            if index < 0:
                continue
            score = abs(printing[index] + overhang[index])
            proximity = _compute_proximity(blocks, cheapest, direction, nx + ny + nz)
            score = score * proximity if prefers_high_score else -score / proximity
            if best_direction < 0 or score > best_score:
                best_direction, best_score, best_price = direction, score, float(printing[index])
        if best_direction < 0:  # the block can never grow again, because no cell loses its owner
            prices[cheapest] = np.inf
            continue
        blocks[cheapest, best_direction] += 1 if best_direction >= 3 else -1
        claim_cells(blocks[cheapest], cheapest, owner)
        prices[cheapest] = best_price


def grow_blocks(seeds: list[Box], tables: GrowthTables, score: Score) -> tuple[Ints, Ints]:
    """Grow blocks from seeds.

    Parameters
    ----------
    seeds
        Distinct single cells.
    tables
        Cells of the grid, and prices that decide how blocks grow.
    score
        Interpretation of the score: `LOW` or `HIGH`.

    Returns
    -------
    blocks, owner
        (k, 6) int64 in cells, half-open; (nx, ny, nz) int64 number of the block that owns each cell,
        `FREE_CELL` or `EXCLUDED_CELL`.
    """
    blocks = np.array(seeds, dtype=np.int64).reshape(-1, 6)
    owner = np.where(tables.is_excluded, EXCLUDED_CELL, FREE_CELL).astype(np.int64)
    prices = (tables.seconds, tables.piece_counts, tables.printing_prices, tables.overhang_prices)
    _grow_all_blocks(blocks, owner, tables.is_needed, prices, score is Score.HIGH)
    return blocks, owner


@jit
def _cover_voids(
    owner: Ints,
    is_needed: Bools,
    seconds: npt.NDArray[np.float32],
    piece_counts: npt.NDArray[np.int16],
    number: int,
    max_parts: int,
) -> tuple[bool, Ints]:
    """Cover the needed cells that have no owner with new blocks.

    Parameters
    ----------
    owner, is_needed
        As in `_grow_all_blocks`; the owners are updated in place.
    seconds, piece_counts
        (boxes,) float32 in s and (boxes,) int16 of `GrowthTables`.
    number
        Number of the first new block.
    max_parts
        Maximum number of parts in the new blocks.

    Returns
    -------
    tuple
        Whether all needed cells are covered, and the new blocks (n, 6) int64.
    """
    nx, ny, nz = owner.shape
    blocks = np.zeros((max(max_parts, 0), 6), np.int64)
    block_count = part_count = 0
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if owner[x, y, z] != FREE_CELL or not is_needed[x, y, z]:
                    continue
                block = np.array([x, y, z, x + 1, y + 1, z + 1])
                index = compute_index((x, y, z, x + 1, y + 1, z + 1), owner.shape)
                part_count += piece_counts[index]
                if part_count > max_parts or not np.isfinite(seconds[index]):
                    return False, blocks[:block_count]
                can_grow = True
                while can_grow:
                    can_grow = False
                    for direction in (3, 0, 4, 1, 5, 2):
                        if find_grown_index(block, direction, owner, is_needed, seconds, piece_counts) >= 0:
                            block[direction] += 1 if direction >= 3 else -1
                            can_grow = True
                claim_cells(block, number + block_count, owner)
                blocks[block_count] = block
                block_count += 1
    return True, blocks[:block_count]


def fill_voids(blocks: Ints, owner: Ints, tables: GrowthTables, max_parts: int) -> Ints | None:
    """Cover the needed cells that have no owner with new blocks, and return all blocks.

    The first such cell becomes a block, which grows in every direction in turn as far as possible; then the
    next such cell follows. As in `grow_blocks`, no block may be too large for a printer; the paper's program
    does not check that.

    Parameters
    ----------
    blocks, owner
        Results of `grow_blocks`; the owners are updated in place.
    tables
        Cells of the grid, and prices that decide how blocks grow.
    max_parts
        Maximum number of parts in the new blocks.

    Returns
    -------
    Ints or None
        (n, 6) all blocks in cells; None if more parts would be needed.
    """
    is_covered, fillers = _cover_voids(
        owner, tables.is_needed, tables.seconds, tables.piece_counts, len(blocks), max_parts
    )
    return np.concatenate([blocks, fillers]) if is_covered else None
