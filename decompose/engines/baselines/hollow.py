"""Hollowing of a model on a grid, and the largest cube in its cavity, which may be refined on the mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.geometry import Solid
from decompose.grid import PLANE_CLEARANCE_MM, Box, Cell, FlatFaces, Grid, find_flat_faces
from decompose.pieces import list_box_planes

MAX_GROWTH_CELLS = 2.0  # maximum growth of a cube on each side, as a multiple of a cell's longest side
ACCURACY_MM = 0.2  # accuracy of the cube's size
MARGIN_MM = 0.01  # margin above the minimum thickness of the wall, because distances are rounded
ROUND_COUNT = 2  # maximum number of rounds, in each of which the cube grows in every direction


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """Hollowed model.

    Attributes
    ----------
    solid
        Solid of the model without the cavity.
    cavity
        (nx, ny, nz) bool, true for the cells that were removed.
    planes
        (k, 4) planes of the sides of the cavity: in each row the unit normal (3,), and its offset in mm.
    boxes_mm
        (b, 2, 3) corners of boxes that cover the shell; empty if nothing was removed.
    """

    solid: Solid
    cavity: Bools
    planes: Floats
    boxes_mm: Floats


def hollow_model(solid: Solid, grid: Grid, cube: Box | None = None) -> Shell:
    """Remove from a solid a cube, and all cells further from the surface than the minimum wall thickness.

    Parameters
    ----------
    solid
        Solid of the model.
    grid
        Grid over the solid; its needed cells include those of the wall.
    cube
        Cells of a cube, which are always removed; None for no cube.
    """
    cube_cells = np.zeros_like(grid.is_needed)
    if cube is not None:
        cube_cells[cube[0] : cube[3], cube[1] : cube[4], cube[2] : cube[5]] = True
    cavity = remove_diagonal_cells(cube_cells | ((grid.cells == Cell.INTERNAL) & ~grid.is_needed), cube_cells)
    if not cavity.any():
        return Shell(solid, cavity, np.zeros((0, 4)), np.zeros((0, 2, 3)))
    holes = [np.array(grid.find_bounds_mm(block)) for block in cover_with_boxes(cavity)]
    solid_boxes = np.array([grid.find_bounds_mm(block) for block in cover_with_boxes(~cavity)])
    shell = solid.subtract(Solid.union([Solid.box(*hole) for hole in holes]))
    planes = np.unique(np.concatenate([list_box_planes(hole) for hole in holes]), axis=0)
    return Shell(shell, cavity, planes, solid_boxes)


def remove_diagonal_cells(cells: Bools, kept_cells: Bools | None = None) -> Bools:
    """Remove cells that meet others only along an edge, where the surface of a cavity would touch itself.

    Parameters
    ----------
    cells
        (nx, ny, nz) bool, the cells of the cavity.
    kept_cells
        (nx, ny, nz) bool, true for cells that are not removed; None if any cell may be removed.

    Returns
    -------
    ndarray
        (nx, ny, nz) bool, the remaining cells.
    """
    cells = cells.copy()
    kept_cells = np.zeros_like(cells) if kept_cells is None else kept_cells
    while True:
        count = int(cells.sum())
        for a, b in ((0, 1), (0, 2), (1, 2)):
            view = np.moveaxis(cells, (a, b), (0, 1))
            kept_view = np.moveaxis(kept_cells, (a, b), (0, 1))
            near, far = view[:-1, :-1], view[1:, 1:]
            left, right = view[1:, :-1], view[:-1, 1:]
            meets = near & far & ~left & ~right
            near &= ~meets | kept_view[:-1, :-1]
            far &= ~meets | ~kept_view[:-1, :-1]
            meets = left & right & ~near & ~far
            left &= ~meets | kept_view[1:, :-1]
            right &= ~meets | ~kept_view[1:, :-1]
        if int(cells.sum()) == count:
            return cells


def cover_with_boxes(cells: Bools) -> list[Box]:
    """Cover cells (nx, ny, nz) with disjoint boxes.

    Each box begins at a cell, and grows along z, then y, then x as far as possible.
    """
    is_free = cells.copy()
    boxes: list[Box] = []
    for x, y, z in np.argwhere(cells).tolist():
        if not is_free[x, y, z]:
            continue
        x1, y1, z1 = x + 1, y + 1, z + 1
        while z1 < is_free.shape[2] and is_free[x, y, z1]:
            z1 += 1
        while y1 < is_free.shape[1] and is_free[x, y1, z:z1].all():
            y1 += 1
        while x1 < is_free.shape[0] and is_free[x1, y:y1, z:z1].all():
            x1 += 1
        is_free[x:x1, y:y1, z:z1] = False
        boxes.append((x, y, z, x1, y1, z1))
    return boxes


def find_largest_cube(cells: Bools) -> Box | None:
    """Find the largest cube of cells (nx, ny, nz); of several, the cube nearest to the middle of the cells.

    Returns
    -------
    tuple or None
        Cells of the cube; None if there are no cells.
    """
    if not cells.any():
        return None
    # Size of the largest cube that ends at each cell.
    cube_sizes = np.zeros([n + 1 for n in cells.shape], dtype=np.int64)
    for x, y, z in np.argwhere(cells).tolist():
        previous_sizes = cube_sizes[x : x + 2, y : y + 2, z : z + 2].ravel()[:7]
        cube_sizes[x + 1, y + 1, z + 1] = 1 + previous_sizes.min()
    ends = np.argwhere(cube_sizes == cube_sizes.max())
    size = int(cube_sizes.max())
    middle = np.argwhere(cells).mean(axis=0) + 0.5
    distances = np.round(np.linalg.norm(ends - size / 2.0 - middle, axis=1), 6)
    x, y, z = ends[int(np.argmin(distances))].tolist()
    return x - size, y - size, z - size, x, y, z


def refine_cube(solid: Solid, cube_mm: Floats, cell_mm: float, wall_mm: float) -> Floats:
    """Grow a cube, at first the largest one in a cuboid, until only the minimum wall thickness remains.

    The cube grows about its middle and towards each corner, in at most `ROUND_COUNT` rounds and to at most
    `MAX_GROWTH_CELLS` cells beyond the cuboid. Bisection finds the growth at which the distance from the mesh
    is the thickness of the wall. Afterwards, almost no larger cube that contains this one would leave enough
    wall.

    Parameters
    ----------
    solid
        Solid of the model.
    cube_mm
        (2, 3) corners of the cuboid, which leaves enough wall.
    cell_mm
        Longest side of a cell.
    wall_mm
        Minimum thickness of the wall.

    Returns
    -------
    ndarray
        (2, 3) corners of the cube in mm.
    """
    reach_mm, wall_mm = MAX_GROWTH_CELLS * cell_mm, max(wall_mm, ACCURACY_MM) + MARGIN_MM
    middle_mm, half_side_mm = cube_mm.mean(axis=0), np.ptp(cube_mm, axis=0).min() / 2.0
    min_corner_mm, max_corner_mm = cube_mm[0] - reach_mm, cube_mm[1] + reach_mm
    margin_mm = wall_mm + ACCURACY_MM
    outer_solid = Solid.box(min_corner_mm - margin_mm, max_corner_mm + margin_mm).subtract(solid)
    cube = np.array([middle_mm - half_side_mm, middle_mm + half_side_mm])
    # In each row, the shares of the growth at the lower sides along x, y and z.
    directions: Floats = np.array([(0.5, 0.5, 0.5), *np.ndindex(2, 2, 2)])

    def leaves_wall(box: Floats) -> bool:
        return outer_solid.is_empty or outer_solid.measure_gap_mm(Solid.box(*box), wall_mm) >= wall_mm

    for _ in range(ROUND_COUNT):
        before_mm = float(cube[1, 0] - cube[0, 0])
        for direction in directions:
            shares = np.array([direction, 1.0 - direction])
            spaces_mm = np.array([cube[0] - min_corner_mm, max_corner_mm - cube[1]])
            max_mm = float((spaces_mm[shares > 0.0] / shares[shares > 0.0]).min())
            cube = _grow_cube(cube, direction, max_mm, leaves_wall)
        if cube[1, 0] - cube[0, 0] < before_mm + ACCURACY_MM:
            break
    return cube


def _grow_cube(
    cube: Floats, direction: Floats, max_mm: float, leaves_wall: Callable[[Floats], bool]
) -> Floats:
    """Grow a cube (2, 3) by bisection until only the minimum thickness of the wall remains.

    Parameters
    ----------
    direction
        (3,) shares of the growth at the lower sides along x, y and z; the rest is at the upper sides.
    max_mm
        Maximum growth.
    leaves_wall
        Function that returns whether a cube leaves enough wall.
    """

    def grow(distance_mm: float) -> Floats:
        return np.array([cube[0] - direction * distance_mm, cube[1] + (1.0 - direction) * distance_mm])

    low_mm, high_mm = 0.0, max_mm
    while high_mm - low_mm > ACCURACY_MM:
        growth_mm = (low_mm + high_mm) / 2.0
        low_mm, high_mm = (growth_mm, high_mm) if leaves_wall(grow(growth_mm)) else (low_mm, growth_mm)
    return grow(low_mm)


def move_planes_to_cube(
    solid: Solid, grid: Grid, cube_mm: Floats
) -> tuple[tuple[Floats, Floats, Floats], Box]:
    """Move the nearest planes of a grid to the sides of a cube.

    A side is moved inwards if it is next to a flat face of the solid, where a plane would cut off slivers.

    Parameters
    ----------
    solid
        Solid of the model.
    grid
        Grid over the solid.
    cube_mm
        (2, 3) corners of the cube.

    Returns
    -------
    tuple
        Coordinates in mm of the planes perpendicular to x, y and z, and the cube in cells.
    """
    vertices, faces = solid.arrays()
    inwards_mm = min(2.0 * PLANE_CLEARANCE_MM, float(np.ptp(cube_mm, axis=0).min()) / 3.0)
    planes, cells = [], []
    for axis, sides in enumerate(cube_mm.T.tolist()):
        positions_mm, flat_faces = grid.planes[axis].copy(), find_flat_faces(vertices[faces], axis)
        low_mm, high_mm = (
            _find_clear_position_mm(flat_faces, side_mm, reach_mm)
            for side_mm, reach_mm in zip(sides, (inwards_mm, -inwards_mm), strict=True)
        )
        first = 1 + int(np.abs(positions_mm[1:-2] - low_mm).argmin())
        last = first + 1 + int(np.abs(positions_mm[first + 1 : -1] - high_mm).argmin())
        positions_mm[first], positions_mm[last] = low_mm, high_mm
        planes.append(positions_mm)
        cells.append((first, last))
    (x0, x1), (y0, y1), (z0, z1) = cells
    return (planes[0], planes[1], planes[2]), (x0, y0, z0, x1, y1, z1)


def _find_clear_position_mm(flat_faces: FlatFaces, at_mm: float, reach_mm: float) -> float:
    """Find the nearest position within reach that is clear of flat faces, or the one furthest from them."""
    positions_mm = np.linspace(at_mm, at_mm + reach_mm, 41)
    gaps_mm = flat_faces.measure_gaps_mm(positions_mm)
    clear_indices = np.flatnonzero(gaps_mm >= 0.0)
    return float(positions_mm[clear_indices[0] if len(clear_indices) else int(gaps_mm.argmax())])


def list_cubes_around(cube: Box, cells: Bools) -> list[Box]:
    """List the cubes that touch the faces of a cube from outside, one in the middle of each face.

    Each is the largest cube that fits, at most as large as the given cube. If the cells are not cubes,
    neither are the listed boxes: along every axis, a box is shorter than the given cube by the same number
    of cells.

    Parameters
    ----------
    cube
        Cells of the cube.
    cells
        (nx, ny, nz) bool, true for cells that the cubes may occupy.
    """
    edges = [cube[axis + 3] - cube[axis] for axis in range(3)]
    cubes: list[Box] = []
    for axis in range(3):
        for is_upper_side in (False, True):
            for margin in range(min(edges)):
                lo = [cube[a] + margin // 2 for a in range(3)]
                lo[axis] = cube[axis + 3] if is_upper_side else cube[axis] - edges[axis] + margin
                hi = [v + edge - margin for v, edge in zip(lo, edges, strict=True)]
                is_inside = min(lo) >= 0 and all(h <= n for h, n in zip(hi, cells.shape, strict=True))
                if is_inside and cells[lo[0] : hi[0], lo[1] : hi[1], lo[2] : hi[2]].all():
                    cubes.append((lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]))
                    break
    return cubes
