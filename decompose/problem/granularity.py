"""Granularity of a grid: the cube root of the number of its cells."""

from __future__ import annotations

import math

from decompose.errors import DecomposeError
from decompose.grid import GRANULARITIES

AUTO_GRANULARITY = 15
# Maximum granularity that `auto` chooses for small build volumes; a finer grid takes gigabytes of memory.
MAX_VOLUME_GRANULARITY = 24
MAX_GRANULARITY = 60  # maximum granularity that a person may request
# Minimum number of cells of a part: with fewer cells, a layer of them is too large a share of the part.
CELLS_PER_PART = 400


def choose_granularity(granularity: str | int, printer_count: int, size_ratio: float = 1.0) -> int:
    """Choose the cube root of the number of cells from a name, a number, or ``auto``.

    With ``auto``, the side of a cell is not much longer than half the shortest side of a build volume, unless
    that takes a greater granularity than `MAX_VOLUME_GRANULARITY`.

    Parameters
    ----------
    granularity
        A name of `grid.GRANULARITIES`, a number, or ``auto``.
    printer_count
        Number of printers.
    size_ratio
        Longest side of the model divided by the shortest side of a build volume.

    Raises
    ------
    DecomposeError
        The granularity is not valid.
    """
    if granularity == "auto":
        part_cells = math.ceil(math.pow(CELLS_PER_PART * printer_count, 1.0 / 3.0))
        volume_cells = min(MAX_VOLUME_GRANULARITY, math.ceil(2.0 * size_ratio))
        return max(AUTO_GRANULARITY, part_cells, volume_cells)
    if granularity in GRANULARITIES:
        return GRANULARITIES[str(granularity)]
    try:
        number = int(granularity)
    except ValueError:
        number = 0
    if not 1 <= number <= MAX_GRANULARITY:
        allowed = ", ".join(GRANULARITIES)
        raise DecomposeError(
            f"--granularity {granularity}: give auto, one of {allowed}, or a number from 1 to "
            f"{MAX_GRANULARITY}"
        )
    return number
