"""Layers so short that the slicer slows down for them, so that each may cool before the next."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit
from decompose.print_time.cost import MAX_INSET_SHARE, CostModel

SLABS = 32  # of the height, in each of which layers are taken for alike
SLOWED_AT_MOST = 4.0  # times: walls of 40 to 50 mm/s are not printed at less than 10


def short_layers_s(triangles: Floats, cost: CostModel) -> float:
    """Time in seconds by which short layers exceed their lines, beyond what `CostModel.price_s` knows.

    That knows the mean of all layers only: of a part that tapers those at the tip are slowed down alone.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm of a closed mesh, outward, standing on z = 0.
    """
    height_mm = float(triangles[:, :, 2].max())
    slab_mm = height_mm / SLABS
    lateral_mm2, section_mm2 = _by_slab(np.ascontiguousarray(triangles), height_mm)
    walls_s = cost.lateral_s_mm2 * lateral_mm2
    inset_s = np.minimum(cost.inset_s_mm * slab_mm, MAX_INSET_SHARE * walls_s)
    lines_s = cost.volume_s_mm3 * slab_mm * section_mm2 + walls_s - inset_s
    least_s = np.minimum(cost.least_s_mm * slab_mm, SLOWED_AT_MOST * lines_s)
    known_s = max(0.0, cost.least_s_mm * height_mm - float(lines_s.sum()))
    return max(0.0, float(np.maximum(0.0, least_s - lines_s).sum()) - known_s)


@jit
def _by_slab(triangles: Floats, height: float) -> tuple[Floats, Floats]:
    """(SLABS,) Sums of A sqrt(1 - n^2) over the faces in each slab, and the mean section of the solid there.

    The section at a height is the sum of A n over all faces above it, n being the upward part of a face's
    unit normal.
    """
    lateral, above = np.zeros(SLABS + 1), np.zeros(SLABS + 1)  # of what lies below each plane, and above it
    for t in range(len(triangles)):
        ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
        ux, uy, uz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
        vx, vy, vz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
        nx, ny, up = (uy * vz - uz * vy) / 2.0, (uz * vx - ux * vz) / 2.0, (ux * vy - uy * vx) / 2.0
        upright = np.sqrt(nx * nx + ny * ny)
        low, high = min(az, az + uz, az + vz), max(az, az + uz, az + vz)
        middle = 3.0 * az + uz + vz - low - high
        for plane in range(SLABS + 1):
            z = height * plane / SLABS
            if z >= high:
                below = 1.0
            elif z <= low:
                below = 0.0
            elif z < middle:
                below = (z - low) ** 2 / ((middle - low) * (high - low))
            else:
                below = 1.0 - (high - z) ** 2 / ((high - middle) * (high - low))
            lateral[plane] += below * upright
            above[plane] += (1.0 - below) * up
    above[0] = above[1]  # nothing lies below the bed
    return lateral[1:] - lateral[:-1], np.maximum(0.0, (above[1:] + above[:-1]) / 2.0)
