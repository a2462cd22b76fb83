"""Kernels of `columns`: upright rays through a mesh, and what they say of supports, mass and islands."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.jit import jit

MIN_STEP_MM = 0.4
LEVELS = 8  # heights at which the growing part is looked at
ISLAND_LEVELS, ISLAND_STRIDE = 16, 2  # heights at which islands are counted, in every second column each way
LEVEL_MM = 0.01  # heights that are the same
STEEPEST = 20.0  # the tangent that counts as upright
MIN_GAP_MM = 0.3  # what lies lower above the bed, or above the part, gets no support


@jit
def sweep_columns(
    triangles: Floats,
    marked: Floats,
    rays: tuple[Floats, float, tuple[int, int]],
    height: float,
    overhang_cos: float,
) -> tuple[float, Floats, Bools, Floats, float, float, float]:
    """Send upright rays through a closed mesh and add up what they meet, column by column.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm, outward, standing on z = 0.
    marked
        (m,) float64: 1 for a face to which no support should stick, else 0.
    rays
        Place (2,) of the first ray in mm, their distance in mm, and how many there are along x and y.
    height
        Of the mesh, in mm.
    overhang_cos
        Faces whose normal points down by more than this get support.

    Returns
    -------
    tuple
        touched
            Number of marked faces that support hangs under or stands on, by columns.
        levels
            (LEVELS, 4) moments in x, y, z and mass of what is below each level, per area of a column.
        propped
            (nx, ny) whether support carries the part from the bed.
        supports
            (nx, ny) height of support in each column, in mm.
        towers_mm, edges_mm2, islands_mm
            See `_towers` and `_islands_mm`.
    """
    origin, step, (nx, ny) = rays
    normals = _normals(triangles)
    start, where, which = _crossings(triangles, normals, origin, step, nx, ny)
    touched = 0.0
    # Runs of solid in a column: their ends, the open air and the support below, their lean.
    runs = np.zeros((len(where), 5))
    counts = np.zeros(nx * ny, np.int64)
    supports = np.zeros((nx, ny))
    propped = np.zeros((nx, ny), np.bool_)
    passing = np.zeros((LEVELS, 4))  # runs up to each level that go on above it
    ending = np.zeros((LEVELS, 4))  # and those that end below it, and not below the one before
    for column in range(nx * ny):
        i, j = column // ny, column % ny
        x, y = origin[0] + i * step, origin[1] + j * step
        below, on_marked = 0.0, 0.0  # where a support in this column would stand, and on what
        depth, bottom, air, support, lean = 0, 0.0, 0.0, 0.0, 0.0
        for k in range(start[column], start[column + 1]):
            z, t = where[k], which[k]
            up = normals[t, 2]
            if up < 0.0:
                depth += 1
                if depth != 1:
                    continue
                bottom, air, support = z, z - below, 0.0
                lean = min(STEEPEST, np.sqrt(1.0 - up * up) / -up)
                if -up > overhang_cos and air > MIN_GAP_MM:
                    supports[i, j] += air
                    air, support = 0.0, air
                    touched += marked[t] + on_marked
                    if below == 0.0:
                        propped[i, j] = True
                continue
            depth -= 1
            if depth != 0:
                continue
            below, on_marked = z, marked[t]
            run = start[column] + counts[column]
            runs[run, 0], runs[run, 1], runs[run, 2], runs[run, 3] = bottom, z, air, support
            runs[run, 4] = lean * step
            counts[column] += 1
            level = int(bottom / height * LEVELS)
            while level < LEVELS - 1 and height * (level + 1) / LEVELS < z:
                _add(passing, level, x, y, bottom, height * (level + 1) / LEVELS)
                level += 1
            _add(ending, min(level, LEVELS - 1), x, y, bottom, z)
    for level in range(LEVELS):
        for above in range(level, LEVELS):
            passing[above] += ending[level]
    carried = step * np.sqrt(1.0 - overhang_cos * overhang_cos) / overhang_cos
    towers_mm, edges_mm2 = _towers(start, counts, runs, supports, carried, step)
    islands_mm = _islands_mm(start, counts, runs, nx, ny, height)
    return touched, passing, propped, supports, towers_mm, edges_mm2, islands_mm


@jit
def find_bounds(triangles: Floats) -> tuple[Floats, Floats]:
    """Least and greatest x, y and z."""
    lo, hi = np.full(3, np.inf), np.full(3, -np.inf)
    for t in range(len(triangles)):
        for corner in range(3):
            for axis in range(3):
                lo[axis] = min(lo[axis], triangles[t, corner, axis])
                hi[axis] = max(hi[axis], triangles[t, corner, axis])
    return lo, hi


@jit
def _add(sums: Floats, level: int, x: float, y: float, bottom: float, top: float) -> None:
    """Add the moments and the mass of a run of a column at (x, y)."""
    sums[level, 0] += x * (top - bottom)
    sums[level, 1] += y * (top - bottom)
    sums[level, 2] += (top * top - bottom * bottom) / 2.0
    sums[level, 3] += top - bottom


@jit
def _normals(triangles: Floats) -> Floats:
    """(m, 3) Unit normals; 0 of what has no area."""
    found = np.zeros((len(triangles), 3))
    for t in range(len(triangles)):
        ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
        ux, uy, uz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
        vx, vy, vz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 0.0:
            found[t, 0], found[t, 1], found[t, 2] = nx / length, ny / length, nz / length
    return found


@jit
def _crossings(
    triangles: Floats, normals: Floats, origin: Floats, step: float, nx: int, ny: int
) -> tuple[Ints, Floats, Ints]:
    """Crossings of each column with the mesh: where its own begin, their rising heights, their triangles.

    Of two triangles with an edge in common a column goes through one: what lies on an edge belongs to the
    triangle above it.
    """
    start = np.zeros(nx * ny + 1, np.int64)
    where = np.zeros(0, np.float64)
    which = np.zeros(0, np.int64)
    filled = np.zeros(nx * ny, np.int64)
    edges = np.zeros((3, 4))  # from x, to x, y where it begins, slope
    for turn in range(2):  # count, then fill
        if turn == 1:
            for i in range(nx * ny):
                start[i + 1] += start[i]
            where = np.zeros(start[nx * ny], np.float64)
            which = np.zeros(start[nx * ny], np.int64)
        for t in range(len(triangles)):
            up = normals[t, 2]
            if up == 0.0:
                continue
            left, right = np.inf, -np.inf
            for k in range(3):
                p, q = k, (k + 1) % 3
                if triangles[t, p, 0] > triangles[t, q, 0]:
                    p, q = q, p  # so that both triangles of an edge find the same y
                px, qx = triangles[t, p, 0], triangles[t, q, 0]
                edges[k, 0], edges[k, 1], edges[k, 2] = px, qx, triangles[t, p, 1]
                edges[k, 3] = (triangles[t, q, 1] - triangles[t, p, 1]) / (qx - px) if qx > px else 0.0
                left, right = min(left, px), max(right, qx)
            first = max(0, int(np.ceil((left - origin[0]) / step)))
            last = min(nx, int(np.ceil((right - origin[0]) / step)))
            if first >= last:
                continue
            ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
            lowest = min(az, triangles[t, 1, 2], triangles[t, 2, 2])
            highest = max(az, triangles[t, 1, 2], triangles[t, 2, 2])
            slope_x, slope_y = -normals[t, 0] / up, -normals[t, 1] / up
            for i in range(first, last):
                x = origin[0] + i * step
                low, high = np.inf, -np.inf
                for k in range(3):
                    if edges[k, 0] < x <= edges[k, 1]:
                        y = edges[k, 2] + (x - edges[k, 0]) * edges[k, 3]
                        low, high = min(low, y), max(high, y)
                if low > high:
                    continue
                begin = max(0, int(np.ceil((low - origin[1]) / step)))
                end = min(ny, int(np.ceil((high - origin[1]) / step)))
                for j in range(begin, end):
                    column = i * ny + j
                    if turn == 0:
                        start[column + 1] += 1
                        continue
                    z = az + (x - ax) * slope_x + (origin[1] + j * step - ay) * slope_y
                    z = min(max(z, lowest), highest)
                    at = start[column] + filled[column]
                    filled[column] += 1
                    while at > start[column] and where[at - 1] > z:
                        where[at], which[at] = where[at - 1], which[at - 1]
                        at -= 1
                    where[at], which[at] = z, t
    return start, where, which


@jit
def _towers(
    start: Ints,
    counts: Ints,
    runs: Floats,
    supports: Floats,
    carried: float,
    step: float,
) -> tuple[float, float]:
    """Height of air under runs of solid that neither a run nor a support beside them carries.

    Where runs begin beside each other on about one level, in an edge, the first of them counts, and of the
    others both sides of the strip of support below them, in mm2.

    carried: how much lower a run beside has to begin to carry it.
    """
    total, sides = 0.0, 0.0
    nx, ny = supports.shape
    for column in range(nx * ny):
        for k in range(start[column], start[column] + counts[column]):
            bottom, air = runs[k, 0], runs[k, 2]
            # Between two columns a thin wall that leans goes down by so much: what it stands on is below it.
            reached = bottom - runs[k, 4]
            if air <= MIN_GAP_MM:
                continue
            begins, edge = True, False
            for i in range(max(0, column // ny - 1), min(nx, column // ny + 2)):
                for j in range(max(0, column % ny - 1), min(ny, column % ny + 2)):
                    beside = i * ny + j
                    if supports[i, j] > 0.0:
                        begins = False
                    for m in range(start[beside], start[beside] + counts[beside]):
                        if runs[m, 1] < reached:
                            continue
                        far = abs(i - column // ny) + abs(j - column % ny) == 2
                        lower = bottom - runs[m, 0]
                        least = carried * (1.4142135623730951 if far else 1.0)
                        if lower > least:
                            begins = False
                        elif lower > LEVEL_MM or (lower > -LEVEL_MM and beside < column):
                            edge = True
            if begins and edge:
                sides += 2.0 * step * air
            elif begins:
                total += air
    return total, sides


@jit
def _islands_mm(
    start: Ints,
    counts: Ints,
    runs: Floats,
    nx: int,
    ny: int,
    height: float,
) -> float:
    """The number of islands but one, of solid and of support, summed over the height."""
    total = 0
    rows, row = (nx + ISLAND_STRIDE - 1) // ISLAND_STRIDE, (ny + ISLAND_STRIDE - 1) // ISLAND_STRIDE
    kind = np.zeros(rows * row, np.int8)  # none, solid, support
    parent = np.zeros(rows * row, np.int64)
    for level in range(ISLAND_LEVELS):
        z = height * (level + 0.5) / ISLAND_LEVELS
        islands = 0
        for i in range(rows):
            for j in range(row):
                me = i * row + j
                column = i * ISLAND_STRIDE * ny + j * ISLAND_STRIDE
                kind[me], parent[me] = 0, me
                for k in range(start[column], start[column] + counts[column]):
                    if runs[k, 0] < z < runs[k, 1]:
                        kind[me] = 1
                    elif runs[k, 0] - runs[k, 3] < z <= runs[k, 0]:
                        kind[me] = 2
                if kind[me] == 0:
                    continue
                islands += 1
                for n in range(4):  # those of the eight neighbours that were seen before
                    u, v = (i, j - 1) if n == 3 else (i - 1, j - 1 + n)
                    if u < 0 or v < 0 or v >= row or kind[u * row + v] != kind[me]:
                        continue
                    a, b = _root(parent, me), _root(parent, u * row + v)
                    if a != b:
                        parent[a] = b
                        islands -= 1
        total += max(0, islands - 1)
    return total * height / ISLAND_LEVELS


@jit
def _root(parent: Ints, at: int) -> int:
    """Root of the group of an element."""
    while parent[at] != at:
        parent[at] = parent[parent[at]]
        at = parent[at]
    return at
