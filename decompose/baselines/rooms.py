"""How many parts the printers' room asks for, and where a plane is clear of faces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import permutations

import numpy as np
import numpy.typing as npt

from decompose.cost import PrinterRoom
from decompose.grid import CLEAR_MM
from decompose.solid import Solid

Floats = npt.NDArray[np.float64]

FIT_MM = 1e-6  # a part may be this much larger than its room: rounding


def blocks_needed(size_mm: Floats, printers: Sequence[PrinterRoom]) -> tuple[int, int, int]:
    """Along each axis the least equal blocks of a box (3,) that fit every printer, square to its sides.

    A box that needs one block fits; it may fit turned where it needs more.
    """
    each = []
    for printer in printers:
        turned = [np.ceil((size_mm - FIT_MM) / box) for b in printer.boxes for box in permutations(b)]
        each.append(min(turned, key=lambda counts: (math.prod(counts.tolist()), counts.tolist())))
    x, y, z = np.maximum(1.0, np.max(each, axis=0)).astype(int).tolist()
    return x, y, z


def parts_needed(solid: Solid, printers: Sequence[PrinterRoom]) -> int:
    """The parts that a solid is cut into at least, along the axes; 1 where it fits as it is."""
    return math.prod(blocks_needed(np.ptp(solid.bounds_mm, axis=0), printers))


def clear_of_faces(solid: Solid, normal: Floats, at_mm: float, reach_mm: float = 2.0 * CLEAR_MM) -> float:
    """A place next to `at_mm` for a plane, where no face of the solid lies near it.

    A cut there would leave slivers, and the face be taken for a cut. Where nothing within the reach is clear,
    the place is that which is furthest from any face.
    """
    vertices, faces = solid.arrays()
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    along, size = cross @ normal, np.linalg.norm(cross, axis=1)
    flat = (np.abs(along) > (1.0 - 1e-9) * size) & (size > 0.0)
    coordinates = np.unique(np.round(a[flat] @ normal, 6))
    coordinates = coordinates[np.abs(coordinates - at_mm) < reach_mm + CLEAR_MM]
    if not len(coordinates):
        return at_mm
    offsets = np.linspace(-reach_mm, reach_mm, 81)
    offsets = offsets[np.argsort(np.abs(offsets), kind="stable")]
    gaps = np.abs(at_mm + offsets[:, None] - coordinates[None]).min(axis=1)
    clear = np.flatnonzero(gaps >= CLEAR_MM)
    return at_mm + float(offsets[clear[0] if len(clear) else int(np.argmax(gaps))])
