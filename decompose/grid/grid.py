"""Grid over a model: classes of its cells, and the sums in each cell on which print time depends.

Each triangle is clipped once to the cells that it crosses. Everything else follows exactly from the
divergence theorem. A cut area is the area of the solid on a side of a cell. The flux of a constant field
through the surface in a cell is the difference between the cut areas of the lower and the upper side of the
cell. The first moment of this flux gives the volume. No boolean operations are needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats
from decompose.grid.clipping import VOLUME, clip_into_cells
from decompose.grid.piece_counts import NO_BODIES, CellBodies, find_bodies
from decompose.grid.planes import find_flat_faces, place_planes

GRANULARITIES = {
    "ucoarse": 2, "xcoarse": 3, "vcoarse": 8, "coarse": 9, "regular": 10, "fine": 12, "vfine": 15,
}  # fmt: skip
MAX_BOXES = 10_000_000  # maximum number of boxes of a grid: tables of all boxes are kept in memory
# Maximum number of cuts of all boxes together; beyond it, cells are made larger. For each time limit that it
# tries, the search computes a sum for each cut.
MAX_CUTS = 300_000_000
# Maximum number of boxes of a grid, as a multiple of that of a cubic grid with the desired number of cells;
# beyond it, cells are made larger. Without this limit, a flat model would have many times as many boxes.
MAX_FLAT_BOXES_RATIO = 1.5
MIN_CELL_MM = 4.0  # minimum side of a cell
# Number of fine cells along each side of a cell. On fine cells, the bodies of the cell (the connected
# components of the solid in it) are told apart.
CELL_DIVISION = 3
MAX_FINE_CELLS = 500_000  # maximum number of fine cells; the cells of a larger grid are divided less


class Cell(IntEnum):
    """Class of a cell."""

    EXTERNAL = 0  # without solid
    INTERNAL = 1  # full of solid
    BOUNDARY = 2  # with a part of the model's surface


@dataclass(frozen=True, slots=True)
class GridRules:
    """Rules that classify the cells of a grid, and the faces of its model.

    Attributes
    ----------
    min_wall_mm
        Distance from the surface within which internal cells are needed: the minimum thickness of a wall.
    keeps_interior
        Whether every internal cell is needed.
    overhang_cos
        A face counts as an overhang if the cosine of the angle between its normal and the downward direction
        is greater than this.
    skin_cos
        A face gets skin if the cosine of the angle between its normal and the vertical is greater than this.
    """

    min_wall_mm: float
    keeps_interior: bool
    overhang_cos: float
    skin_cos: float


@dataclass(frozen=True, slots=True)
class Grid:
    """A rectilinear grid and its contents.

    Attributes
    ----------
    planes
        (n + 1,) ascending coordinates of the planes perpendicular to each axis, in mm.
    cells
        (nx, ny, nz) int8 `Cell` classes.
    is_needed
        (nx, ny, nz) bool, true for cells that must be printed: those that contain the model's surface, and
        those of the wall behind it, or all cells with solid if the interior is kept.
    sums
        (nx, ny, nz, SUM_COUNT) float64, see the column constants of `clipping`.
    area_mm2
        (nx, ny, nz) float64 area of the model's surface in a cell, in mm2.
    bounds_mm
        (nx, ny, nz, 6) float64 least x, y, z and greatest x, y, z of the solid in a cell, in mm; +inf and
        -inf if it is empty.
    surface_bounds_mm
        (nx, ny, nz, 6) the same for the model's surface alone.
    cuts
        For each axis, float64 area of solid in mm2 on the planes perpendicular to it, by cell: the shape is
        that of the cells, with n + 1 planes instead of n cells along the axis.
    bodies
        Bodies (connected components) of the solid in each cell; only `build_grid` finds them.
    """

    planes: tuple[Floats, Floats, Floats]
    cells: npt.NDArray[np.int8]
    is_needed: Bools
    sums: Floats
    area_mm2: Floats
    bounds_mm: Floats
    surface_bounds_mm: Floats
    cuts: tuple[Floats, Floats, Floats]
    bodies: CellBodies

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells along each axis."""
        nx, ny, nz = self.cells.shape
        return nx, ny, nz

    def find_bounds_mm(self, box: tuple[int, ...]) -> tuple[Floats, Floats]:
        """Find the corners (3,) in mm of a box of cells ``(x0, y0, z0, x1, y1, z1)``, half-open."""
        lo = np.array([self.planes[a][box[a]] for a in range(3)])
        hi = np.array([self.planes[a][box[a + 3]] for a in range(3)])
        return lo, hi


def count_cuts(shape: tuple[int, int, int]) -> int:
    """Count the cuts of all boxes of a grid (nx, ny, nz); a cut divides a box between two layers of cells."""
    interval_counts = [n * (n + 1) // 2 for n in shape]
    cut_counts = [n * (n * n - 1) // 6 for n in shape]
    return sum(
        math.prod([*interval_counts[:axis], cut_counts[axis], *interval_counts[axis + 1 :]])
        for axis in range(3)
    )


def choose_cell_counts(size_mm: Floats, granularity: int) -> tuple[int, int, int]:
    """Choose the number of nearly cubic cells along each axis: about granularity**3 in total.

    There are fewer cells if they would otherwise be too small, or if their boxes would have too many cuts.
    The number of boxes is also limited, because a flat model has many times as many boxes as a cube with the
    same number of cells.

    Parameters
    ----------
    size_mm
        (3,) size of the model.
    granularity
        Cube root of the desired number of cells.
    """
    edge_mm = max(MIN_CELL_MM, float(np.prod(size_mm) ** (1.0 / 3.0)) / granularity)
    max_boxes = min(MAX_BOXES, MAX_FLAT_BOXES_RATIO * (granularity * (granularity + 1) // 2) ** 3)
    while True:
        nx, ny, nz = (max(1, round(float(s) / edge_mm)) for s in size_mm)
        box_count = nx * (nx + 1) // 2 * (ny * (ny + 1) // 2) * (nz * (nz + 1) // 2)
        if box_count <= max_boxes and count_cuts((nx, ny, nz)) <= MAX_CUTS:
            return nx, ny, nz
        edge_mm *= 1.03


def build_grid(
    triangles: Floats,
    granularity: int,
    rules: GridRules,
    target_plane: tuple[int, float] | None = None,
) -> Grid:
    """Build a grid over a closed mesh.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm, a closed mesh whose faces point outward by the right-hand rule.
    granularity
        Cube root of the desired number of cells.
    rules
        Rules for cells and faces.
    target_plane
        Axis, and coordinate in mm along it to which the nearest inner plane of the grid is moved; None to
        move none.
    """
    lo, hi = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    counts = choose_cell_counts(hi - lo, granularity)
    px, py, pz = (
        place_planes(float(lo[a]), float(hi[a]), counts[a], find_flat_faces(triangles, a)) for a in range(3)
    )
    planes = (px, py, pz)
    if target_plane is not None and counts[target_plane[0]] > 1:
        inner_planes = planes[target_plane[0]][1:-1]
        inner_planes[np.abs(inner_planes - target_plane[1]).argmin()] = target_plane[1]
    grid = fill_grid(triangles, planes, rules)
    divisions = max(1, min(CELL_DIVISION, int((MAX_FINE_CELLS / grid.is_needed.size) ** (1.0 / 3.0))))
    fine_planes = (divide_planes(px, divisions), divide_planes(py, divisions), divide_planes(pz, divisions))
    fine_grid = fill_grid(triangles, fine_planes, replace(rules, keeps_interior=True))
    return replace(grid, bodies=_find_bodies(fine_grid.bounds_mm, fine_grid.cuts, divisions))


def fill_grid(triangles: Floats, planes: tuple[Floats, Floats, Floats], rules: GridRules) -> Grid:
    """Build a grid with given planes over a closed mesh, without finding the bodies in its cells.

    Parameters
    ----------
    triangles, rules
        As in `build_grid`; the mesh lies between the outermost planes.
    planes
        (n + 1,) ascending coordinates of the planes perpendicular to each axis, in mm.
    """
    contents = clip_into_cells(triangles, planes, rules.skin_cos, rules.overhang_cos, True)
    area_mm2, flux, sums, bounds_mm = contents
    surface_bounds_mm = bounds_mm.copy()  # `bounds_mm` becomes the bounds of the solid below
    cuts = _sum_cuts(flux, planes)
    x_steps_mm = np.diff(planes[0])[:, None, None]
    sums[..., VOLUME] = np.maximum(0.0, flux[..., 3] + cuts[0][1:] * x_steps_mm)
    # Where solid crosses a side of a cell, its bounds reach this side; a cell without surface is full or
    # empty.
    for axis in range(3):
        is_lower_side_cut = np.take(cuts[axis], range(area_mm2.shape[axis]), axis=axis) > 0.0
        is_upper_side_cut = np.take(cuts[axis], range(1, area_mm2.shape[axis] + 1), axis=axis) > 0.0
        shape = [1, 1, 1]
        shape[axis] = -1
        low_mm, high_mm = planes[axis][:-1].reshape(shape), planes[axis][1:].reshape(shape)
        bounds_mm[..., axis] = np.where(is_lower_side_cut, low_mm, bounds_mm[..., axis])
        bounds_mm[..., axis + 3] = np.where(is_upper_side_cut, high_mm, bounds_mm[..., axis + 3])
    cells = _classify_cells(area_mm2, cuts)
    is_needed = cells != Cell.EXTERNAL
    if not rules.keeps_interior:
        is_needed = (cells == Cell.BOUNDARY) | _find_wall_cells(
            cells, surface_bounds_mm, planes, rules.min_wall_mm
        )
    return Grid(planes, cells, is_needed, sums, area_mm2, bounds_mm, surface_bounds_mm, cuts, NO_BODIES)


def find_cells(
    triangles: Floats, planes: tuple[Floats, Floats, Floats]
) -> tuple[npt.NDArray[np.int8], Floats]:
    """Find the classes of cells, and the bounds of the surface in them, without the other fields of a grid.

    A grid with the same planes takes three times as much memory.

    Parameters
    ----------
    triangles, planes
        As in `fill_grid`.

    Returns
    -------
    tuple
        `Grid.cells` and `Grid.surface_bounds_mm`.
    """
    contents = clip_into_cells(triangles, planes, 1.0, 1.0, False)
    return _classify_cells(contents.area_mm2, _sum_cuts(contents.flux, planes)), contents.bounds_mm


def _sum_cuts(flux: Floats, planes: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats, Floats]:
    """Compute `Grid.cuts` from the flux through the surface in each cell, see `CellContents`."""
    cuts = []
    for axis in range(3):
        other_steps_mm = [np.diff(planes[(axis + i) % 3]) for i in (1, 2)]
        cut_mm2 = np.zeros([n + (a == axis) for a, n in enumerate(flux.shape[:3])])
        inner_index = [slice(None)] * 3
        inner_index[axis] = slice(1, None)
        np.cumsum(-flux[..., axis], axis=axis, out=cut_mm2[tuple(inner_index)])
        min_face_mm2 = np.multiply.outer(*other_steps_mm).min()
        cut_mm2[cut_mm2 < 1e-9 * min_face_mm2] = 0.0
        cuts.append(cut_mm2)
    return cuts[0], cuts[1], cuts[2]


def _classify_cells(area_mm2: Floats, cuts: tuple[Floats, Floats, Floats]) -> npt.NDArray[np.int8]:
    """Classify cells by the area of the surface in them, and the area of the solid on their lower x side."""
    cells = np.full(area_mm2.shape, Cell.EXTERNAL, dtype=np.int8)
    cells[(area_mm2 == 0.0) & (cuts[0][:-1] > 0.0)] = Cell.INTERNAL
    cells[area_mm2 > 0.0] = Cell.BOUNDARY
    return cells


def _find_bodies(bounds_mm: Floats, cuts: tuple[Floats, Floats, Floats], divisions: int) -> CellBodies:
    """Find the bodies of cells from `bounds_mm` and `cuts` of a finer grid, which divides the cells."""
    nx, ny, nz = bounds_mm.shape[:3]
    crosses_x, crosses_y, crosses_z = (cut[:nx, :ny, :nz] > 0.0 for cut in cuts)
    return find_bodies(np.isfinite(bounds_mm[..., 0]), (crosses_x, crosses_y, crosses_z), divisions)


def divide_planes(planes: Floats, divisions: int) -> Floats:
    """Divide each interval between planes into equal intervals.

    Parameters
    ----------
    planes
        (n + 1,) ascending coordinates in mm.
    divisions
        Number of new intervals in each interval.

    Returns
    -------
    ndarray
        (n * divisions + 1,) ascending coordinates in mm.
    """
    fractions = np.arange(divisions) / divisions
    return np.append((planes[:-1, None] + np.diff(planes)[:, None] * fractions).ravel(), planes[-1])


def _find_wall_cells(
    cells: npt.NDArray[np.int8], surface_bounds_mm: Floats, planes: tuple[Floats, ...], min_wall_mm: float
) -> Bools:
    """Find the internal cells (nx, ny, nz) that may be nearer to the surface than the thickness of the wall.

    The distance is measured from the cell to the box around the surface in each boundary cell, so it is never
    more than the true distance.
    """
    boundary = np.argwhere(cells == Cell.BOUNDARY)
    is_wall = np.zeros(cells.shape, dtype=np.bool_)
    boxes = surface_bounds_mm[tuple(boundary.T)]
    for x, y, z in np.argwhere(cells == Cell.INTERNAL):
        lo = np.array([planes[0][x], planes[1][y], planes[2][z]])
        hi = np.array([planes[0][x + 1], planes[1][y + 1], planes[2][z + 1]])
        gaps_mm = np.maximum(0.0, np.maximum(boxes[:, :3] - hi, lo - boxes[:, 3:]))
        is_wall[x, y, z] = bool((np.einsum("ij,ij->i", gaps_mm, gaps_mm) < min_wall_mm * min_wall_mm).any())
    return is_wall
