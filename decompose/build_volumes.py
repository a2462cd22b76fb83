"""Build volumes of printers as arrays, for compiled functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit
from decompose.printers import TargetPrinter


def list_build_volumes(printers: Sequence[TargetPrinter]) -> Floats:
    """List the distinct build volumes of printers; each is a list of boxes, one of which a part has to fit.

    Returns
    -------
    ndarray
        (build volumes, boxes, 3) float64 in mm, padded with boxes that are too small for any part.
    """
    distinct_volumes = sorted({p.box_sizes_mm for p in printers})
    max_box_count = max((len(boxes) for boxes in distinct_volumes), default=0)
    build_volumes = np.full((len(distinct_volumes), max_box_count, 3), -1.0)
    for number, boxes in enumerate(distinct_volumes):
        build_volumes[number, : len(boxes)] = boxes
    return build_volumes


@jit
def fits_all(build_volumes: Floats, width_mm: float, depth_mm: float, height_mm: float) -> bool:
    """Check whether a part fits each build volume, as `TargetPrinter.fits` does for one printer.

    Parameters
    ----------
    build_volumes
        (build volumes, boxes, 3) float64 in mm, from `list_build_volumes`.
    width_mm, depth_mm, height_mm
        Size of the part.
    """
    for v in range(len(build_volumes)):
        fits = False
        for b in range(build_volumes.shape[1]):
            x, y, z = build_volumes[v, b, 0], build_volumes[v, b, 1], build_volumes[v, b, 2]
            fits_base = (width_mm <= x and depth_mm <= y) or (depth_mm <= x and width_mm <= y)
            if height_mm <= z and fits_base:
                fits = True
        if not fits:
            return False
    return True
