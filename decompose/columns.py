"""A part seen as upright columns: where its supports stand, and how its mass grows as it is printed.

A support ends on whatever is below it, which is often the part itself; sums over faces cannot see that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.jit import jit

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

COLUMNS = 12_000  # about how many: support volumes then err by 1 to 2 %
LEAST_STEP_MM = 0.4
LEVELS = 8  # heights at which the growing part is looked at
LEVEL_MM = 0.01  # heights that are the same
LEAST_GAP_MM = 0.3  # what lies lower above the bed, or above the part, gets no support


@dataclass(frozen=True, slots=True)
class Columns:
    """What the columns say of a part in its printing pose.

    Attributes
    ----------
    support_mm3
        Volume below faces that lean out too far, down to the bed or to the part.
    support_side_mm2
        Upright sides of this support, counted along the columns' grid.
    towers_mm
        Height of all towers under tips in mid-air, whose sides need no support.
    propped_mm2, props_mm
        Area, as seen from above, that this support carries from the bed, and (p, 2) where it stands there.
    touched_mm2
        Area of marked faces, as seen from above, that this support hangs under or stands on.
    volumes_mm3, centres_mm
        (LEVELS,) and (LEVELS, 3) volume and centre of mass of what is below each of LEVELS evenly spaced
        heights; the last is the whole part's.
    """

    support_mm3: float
    support_side_mm2: float
    towers_mm: float
    propped_mm2: float
    props_mm: Floats
    touched_mm2: float
    volumes_mm3: Floats
    centres_mm: Floats


def columns(triangles: Floats, marked: Bools, overhang_cos: float) -> Columns:
    """Cut a closed mesh into columns.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm, outward, standing on z = 0.
    marked
        (m,) faces to which no support should stick.
    overhang_cos
        Faces whose normal points down by more than this get support.
    """
    lo, hi = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    width, depth, height = (hi - lo).tolist()
    step = max(LEAST_STEP_MM, math.sqrt(width * depth / COLUMNS))
    shape = math.ceil(width / step), math.ceil(depth / step)
    # Off the middle by an odd share: a column through an edge of the mesh would be seen twice or not at all.
    origin = lo[:2] + step * (0.5 + np.array([0.0123, 0.0271]))
    touched, levels, propped, supports, towers_mm = _sweep(
        np.ascontiguousarray(triangles),
        marked.astype(np.float64),
        origin,
        step,
        *shape,
        height,
        overhang_cos,
    )
    mass = np.maximum(levels[:, 3:], 1e-12)
    props = origin + step * np.argwhere(propped)
    area = step**2
    return Columns(
        support_mm3=float(supports.sum() * area),
        support_side_mm2=_side_mm2(supports, step),
        towers_mm=towers_mm,
        propped_mm2=float(len(props) * area),
        props_mm=props,
        touched_mm2=float(touched * area),
        volumes_mm3=levels[:, 3] * area,
        centres_mm=levels[:, :3] / mass,
    )


def _side_mm2(heights_mm: Floats, step_mm: float) -> float:
    """Upright area between columns (nx, ny) of different heights; what slants is taken along the grid."""
    heights = np.pad(heights_mm, 1)
    steps = np.abs(np.diff(heights, axis=0)).sum() + np.abs(np.diff(heights, axis=1)).sum()
    return float(steps * step_mm)


@jit
def _sweep(
    triangles: Floats,
    marked: Floats,
    origin: Floats,
    step: float,
    nx: int,
    ny: int,
    height: float,
    overhang_cos: float,
) -> tuple[float, Floats, Bools, Floats, float]:
    """Touched columns; (LEVELS, 4) moments and mass; which are propped, what of each is support; towers."""
    start = np.zeros(nx * ny + 1, np.int64)
    where = np.zeros(0, np.float64)
    which = np.zeros(0, np.int64)
    filled = np.zeros(nx * ny, np.int64)
    for turn in range(2):  # count, then fill
        if turn == 1:
            for i in range(nx * ny):
                start[i + 1] += start[i]
            where = np.zeros(start[nx * ny], np.float64)
            which = np.zeros(start[nx * ny], np.int64)
        for t in range(len(triangles)):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            whole = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            if whole == 0.0:
                continue
            x0 = max(0, int(np.ceil((min(a[0], b[0], c[0]) - origin[0]) / step)))
            x1 = min(nx - 1, int(np.floor((max(a[0], b[0], c[0]) - origin[0]) / step)))
            y0 = max(0, int(np.ceil((min(a[1], b[1], c[1]) - origin[1]) / step)))
            y1 = min(ny - 1, int(np.floor((max(a[1], b[1], c[1]) - origin[1]) / step)))
            for i in range(x0, x1 + 1):
                x = origin[0] + i * step
                for j in range(y0, y1 + 1):
                    y = origin[1] + j * step
                    u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / whole
                    v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / whole
                    w = 1.0 - u - v
                    if u < 0.0 or v < 0.0 or w < 0.0:
                        continue
                    column = i * ny + j
                    if turn == 0:
                        start[column + 1] += 1
                        continue
                    z = u * a[2] + v * b[2] + w * c[2]
                    at = start[column] + filled[column]
                    filled[column] += 1
                    while at > start[column] and where[at - 1] > z:
                        where[at], which[at] = where[at - 1], which[at - 1]
                        at -= 1
                    where[at], which[at] = z, t
    touched = 0.0
    runs = np.zeros(
        (len(where), 3)
    )  # of solid in a column: its ends, and the air below it that no support fills
    counts = np.zeros(nx * ny, np.int64)
    supports = np.zeros((nx, ny))
    propped = np.zeros((nx, ny), np.bool_)
    levels = np.zeros((LEVELS, 4))
    for column in range(nx * ny):
        x = origin[0] + (column // ny) * step
        y = origin[1] + (column % ny) * step
        below, on_marked = 0.0, 0.0  # where a support in this column would stand, and on what
        depth, bottom, air = 0, 0.0, 0.0
        for k in range(start[column], start[column + 1]):
            z, t = where[k], which[k]
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            up = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            if up < 0.0:
                depth += 1
                if depth != 1:
                    continue
                bottom, air = z, z - below
                across_x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
                across_y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
                length = np.sqrt(across_x**2 + across_y**2 + up**2)
                if -up > overhang_cos * length and air > LEAST_GAP_MM:
                    supports[column // ny, column % ny] += air
                    air = 0.0
                    touched += marked[t] + on_marked
                    if below == 0.0:
                        propped[column // ny, column % ny] = True
            else:
                depth -= 1
                if depth != 0:
                    continue
                below, on_marked = z, marked[t]
                runs[start[column] + counts[column]] = bottom, z, air
                counts[column] += 1
                for level in range(LEVELS):
                    top = min(z, height * (level + 1) / LEVELS)
                    if top > bottom:
                        levels[level, 0] += x * (top - bottom)
                        levels[level, 1] += y * (top - bottom)
                        levels[level, 2] += (top * top - bottom * bottom) / 2.0
                        levels[level, 3] += top - bottom
    return touched, levels, propped, supports, _towers_mm(start, counts, runs, supports)


@jit
def _towers_mm(
    start: npt.NDArray[np.int64], counts: npt.NDArray[np.int64], runs: Floats, supports: Floats
) -> float:
    """Height of air under runs of solid that neither a run nor a support beside them carries."""
    total = 0.0
    nx, ny = supports.shape
    for column in range(nx * ny):
        for k in range(start[column], start[column] + counts[column]):
            bottom, air = runs[k, 0], runs[k, 2]
            if air <= LEAST_GAP_MM:
                continue
            begins = True
            for i in range(max(0, column // ny - 1), min(nx, column // ny + 2)):
                for j in range(max(0, column % ny - 1), min(ny, column % ny + 2)):
                    beside = i * ny + j
                    if supports[i, j] > 0.0:
                        begins = False
                    for m in range(start[beside], start[beside] + counts[beside]):
                        lower = runs[m, 0] - bottom
                        # Of those that begin together, one counts.
                        if runs[m, 1] >= bottom and (
                            lower < -LEVEL_MM or (lower < LEVEL_MM and beside < column)
                        ):
                            begins = False
            if begins:
                total += air
    return total
