"""Void fill: what growth left without an owner becomes blocks of its own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.boxes import index_of
from decompose.growth import Ints, Terrain, claim_cells, grown_box_index
from decompose.jit import jit


@jit
def _fill(
    owner: Ints,
    needed: npt.NDArray[np.bool_],
    seconds: npt.NDArray[np.float32],
    pieces: npt.NDArray[np.int16],
    number: int,
    most: int,
) -> tuple[bool, Ints]:
    nx, ny, nz = owner.shape
    blocks = np.zeros((max(most, 0), 6), np.int64)
    found = parts = 0
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if owner[x, y, z] != -1 or not needed[x, y, z]:
                    continue
                block = np.array([x, y, z, x + 1, y + 1, z + 1])
                at = index_of(x, y, z, x + 1, y + 1, z + 1, nx, ny, nz)
                parts += pieces[at]
                if parts > most or not np.isfinite(seconds[at]):
                    return False, blocks[:found]
                growing = True
                while growing:
                    growing = False
                    for direction in (3, 0, 4, 1, 5, 2):
                        if grown_box_index(block, direction, owner, needed, seconds, pieces) >= 0:
                            block[direction] += 1 if direction >= 3 else -1
                            growing = True
                claim_cells(block, number + found, owner)
                blocks[found] = block
                found += 1
    return True, blocks[:found]


def fill_voids(blocks: Ints, owner: Ints, terrain: Terrain, most: int) -> Ints | None:
    """Cover what is needed and has no owner.

    The first such cell becomes a block, which grows in every direction in turn as far as it may; then the
    next. As in growth, no block may be too large for a printer, which the paper's program does not see to.

    Parameters
    ----------
    blocks, owner
        From `growth.grow`; owner is changed.
    most
        Parts that may be added.

    Returns
    -------
    Ints or None
        (n, 6) all blocks, or None where more would be needed.
    """
    tables = (terrain.needed, terrain.seconds, terrain.pieces)
    covered, fillers = _fill(owner, *tables, len(blocks), most)
    return np.concatenate([blocks, fillers]) if covered else None
