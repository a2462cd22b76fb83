"""Neighbourhood search: a partition is improved where it is slowest, not limited to guillotine cuts.

A window is the slowest box with a few boxes near it. It is cut again into at most as many parts, so that the
slowest of them ends sooner; all other boxes stay. The union of its boxes need not be a box. Windows include
the move of one face, a slab that passes from one box to the next, and two boxes that are merged and split
elsewhere.

The tables of a window are those of the grid, but only the cells of its own boxes are to be covered, and a box
that meets another part is not allowed. The search over guillotine cuts of a window is exact; besides, the
window as a whole may be cut as a pinwheel: four boxes around a fifth, which no guillotine cut can begin.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Ints
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.engines.guillotine.recursion import UNREACHABLE
from decompose.grid import Box, BoxTables, Shape, box_index, compute_index, find_interval_ends, interval
from decompose.jit import jit
from decompose.problem import Effort, Work

MAX_WINDOWS = 200  # maximum number of windows solved in one search
MAX_BOXES_IN_WINDOW = 5  # maximum number of boxes in a window
MAX_NEIGHBOURS = 10  # maximum number of neighbours of a box in its windows, the fastest first
MAX_WINDOWS_OF_A_BOX = 24  # maximum number of windows about one box, those with the most slack first
MAX_BOXES = 150_000  # maximum number of boxes of all sizes in a window's tables
MAX_TIME_RATIO = 0.999  # a window's new time must be below this share of its time
TOLERANCE = 0.002  # accuracy of the minimum makespan, as a share of it

Pinwheel = tuple[int, int, int, int, int, int]  # axis of extrusion, whether it is mirrored, p1, p2, q1, q2


@jit
def _cut_in_two(box: Box, shape: Shape) -> tuple[int, int]:
    """Find the two boxes that form a box of two cells or more: its last layer, and the rest."""
    x0, y0, z0, x1, y1, z1 = box
    if z1 - z0 > 1:
        return compute_index((x0, y0, z0, x1, y1, z1 - 1), shape), compute_index(
            (x0, y0, z1 - 1, x1, y1, z1), shape
        )
    if y1 - y0 > 1:
        return compute_index((x0, y0, z0, x1, y1 - 1, z1), shape), compute_index(
            (x0, y1 - 1, z0, x1, y1, z1), shape
        )
    return compute_index((x0, y0, z0, x1 - 1, y1, z1), shape), compute_index(
        (x1 - 1, y0, z0, x1, y1, z1), shape
    )


@jit
def _count_cells(sums: Ints, box: Box) -> int:
    """Count the cells in a box, by their summed-area table (nx + 1, ny + 1, nz + 1)."""
    x0, y0, z0, x1, y1, z1 = box
    count = sums[x1, y1, z1] - sums[x0, y1, z1] - sums[x1, y0, z1] + sums[x0, y0, z1]
    return int(count - sums[x1, y1, z0] + sums[x0, y1, z0] + sums[x1, y0, z0] - sums[x0, y0, z0])


@jit
def _join_ends(
    trimmed: npt.NDArray[np.int32],
    ends: npt.NDArray[np.int16],
    parts: tuple[int, int],
    box: int,
) -> bool:
    """Join the ends of the two parts of a box; False if there is nothing to be covered in either.

    Parameters
    ----------
    trimmed
        (boxes,) -1 for a box without cells to be covered.
    ends
        (boxes, 6) int16 ends of the box about the cells to be covered; those of the box are filled in.
    parts
        Indices of the two parts.
    box
        Index of the box.
    """
    lower, upper = parts
    if trimmed[lower] < 0 and trimmed[upper] < 0:
        return False
    if trimmed[lower] < 0:
        lower = upper
    elif trimmed[upper] < 0:
        upper = lower
    for k in range(3):
        ends[box, k] = min(ends[lower, k], ends[upper, k])
        ends[box, k + 3] = max(ends[lower, k + 3], ends[upper, k + 3])
    return True


@jit
def _fill_tables(
    own_cells: Bools,
    other_sums: Ints,
    place: tuple[Shape, Shape],
    grid_tables: tuple[npt.NDArray[np.float32], npt.NDArray[np.int16]],
    tables: tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.int16]],
) -> None:
    """Fill in the tables of a window, smaller boxes first.

    Parameters
    ----------
    own_cells
        (wx, wy, wz) cells of the window to be covered.
    other_sums
        (wx + 1, wy + 1, wz + 1) int64 summed-area table of the cells of other parts.
    place
        First cell x, y, z of the window on the grid, and the grid's shape.
    grid_tables
        `seconds` and `pieces` of the grid, (boxes of the grid,).
    tables
        `seconds`, `trimmed` and `pieces` of the window, (boxes of the window,), initially +inf, -1 and 1.
    """
    (x, y, z), grid_shape = place
    grid_seconds, grid_pieces = grid_tables
    seconds, trimmed, pieces = tables
    wx, wy, wz = shape = own_cells.shape
    ends = np.zeros((len(seconds), 6), np.int16)  # the price of the box about the cells to be covered
    box = -1
    for ix in range(wx * (wx + 1) // 2):
        x0, x1 = find_interval_ends(ix, wx)
        for iy in range(wy * (wy + 1) // 2):
            y0, y1 = find_interval_ends(iy, wy)
            for dz in range(1, wz + 1):
                for z0 in range(wz - dz + 1):
                    box += 1
                    sides = (x0, y0, z0, x1, y1, z0 + dz)
                    if x1 - x0 == 1 and y1 - y0 == 1 and dz == 1:
                        if not own_cells[x0, y0, z0]:
                            continue
                        for k in range(6):
                            ends[box, k] = sides[k]
                    elif not _join_ends(trimmed, ends, _cut_in_two(sides, shape), box):
                        continue
                    trimmed[box] = compute_index(
                        (ends[box, 0], ends[box, 1], ends[box, 2], ends[box, 3], ends[box, 4], ends[box, 5]),
                        shape,
                    )
                    if trimmed[box] == box and _count_cells(other_sums, sides) == 0:
                        on_grid = compute_index(
                            (x + x0, y + y0, z + z0, x + x1, y + y1, z + z0 + dz), grid_shape
                        )
                        seconds[box] = grid_seconds[on_grid]
                        pieces[box] = grid_pieces[on_grid]


@jit
def _count_fewest_in_pinwheel(
    counts: npt.NDArray[np.int16], wx: int, wy: int, wz: int
) -> tuple[int, int, int, int, int, int, int]:
    """Find the pinwheel of the whole window with the fewest parts.

    Parameters
    ----------
    counts
        (boxes,) fewest parts of each box of the window, by its index.
    wx, wy, wz
        Cells of the window.

    Returns
    -------
    tuple
        Number of parts, `UNREACHABLE` for none, and the `Pinwheel`, see `list_pinwheel_boxes`.
    """
    sizes = (wx, wy, wz)
    strides = (wy * (wy + 1) // 2 * (wz * (wz + 1) // 2), wz * (wz + 1) // 2, 1)
    best = (UNREACHABLE, 0, 0, 0, 0, 0, 0)
    for axis in range(3):
        p_axis, q_axis = (axis + 1) % 3, (axis + 2) % 3
        p, q = sizes[p_axis], sizes[q_axis]
        p_stride, q_stride = strides[p_axis], strides[q_axis]
        full_index = interval(0, sizes[axis], sizes[axis]) * strides[axis]
        for p1 in range(1, p - 1):
            for p2 in range(p1 + 1, p):
                for q1 in range(1, q - 1):
                    for q2 in range(q1 + 1, q):
                        low, high = interval(0, q1, q) * q_stride, interval(q2, q, q) * q_stride
                        lower, upper = interval(0, q2, q) * q_stride, interval(q1, q, q) * q_stride
                        middle = interval(p1, p2, p) * p_stride + interval(q1, q2, q) * q_stride
                        centre = np.int64(counts[full_index + middle])
                        n = centre + counts[full_index + interval(0, p2, p) * p_stride + low]
                        n += counts[full_index + interval(p2, p, p) * p_stride + lower]
                        n += counts[full_index + interval(p1, p, p) * p_stride + high]
                        n += counts[full_index + interval(0, p1, p) * p_stride + upper]
                        if n < best[0]:
                            best = (n, axis, 0, p1, p2, q1, q2)
                        n = centre + counts[full_index + interval(p1, p, p) * p_stride + low]
                        n += counts[full_index + interval(0, p1, p) * p_stride + lower]
                        n += counts[full_index + interval(0, p2, p) * p_stride + high]
                        n += counts[full_index + interval(p2, p, p) * p_stride + upper]
                        if n < best[0]:
                            best = (n, axis, 1, p1, p2, q1, q2)
    return best


def list_pinwheel_boxes(shape: tuple[int, int, int], pinwheel: Pinwheel) -> list[Box]:
    """List the five boxes of a pinwheel that fills a grid; the last one is in the middle."""
    axis, is_mirrored, p1, p2, q1, q2 = pinwheel
    p, q = shape[(axis + 1) % 3], shape[(axis + 2) % 3]
    if is_mirrored:
        flat = [(p1, p, 0, q1), (0, p1, 0, q2), (0, p2, q2, q), (p2, p, q1, q), (p1, p2, q1, q2)]
    else:
        flat = [(0, p2, 0, q1), (p2, p, 0, q2), (p1, p, q2, q), (0, p1, q1, q), (p1, p2, q1, q2)]
    boxes = []
    for a, b, c, d in flat:
        lo, hi = [0, 0, 0], list(shape)
        lo[(axis + 1) % 3], hi[(axis + 1) % 3] = a, b
        lo[(axis + 2) % 3], hi[(axis + 2) % 3] = c, d
        boxes.append((lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]))
    return boxes


class Window:
    """Some boxes of a partition, which are cut again while the others stay.

    Parameters
    ----------
    boxes
        The tables of the grid.
    boxes_inside, other_boxes
        Boxes of the partition that are cut again, and all others.
    """

    def __init__(self, boxes: BoxTables, boxes_inside: Iterable[Box], other_boxes: Iterable[Box]) -> None:
        inside_boxes = np.array(sorted(boxes_inside))
        self._lo, hi = inside_boxes[:, :3].min(axis=0), inside_boxes[:, 3:].max(axis=0)
        nx, ny, nz = (hi - self._lo).tolist()
        self.shape = (nx, ny, nz)
        is_covered = self._mark_cells(inside_boxes)
        x_offset, y_offset, z_offset = self._lo.tolist()
        for cell in np.argwhere(is_covered):
            x, y, z = (self._lo + cell).tolist()
            is_covered[tuple(cell)] = (
                boxes.trimmed[box_index((x, y, z, x + 1, y + 1, z + 1), boxes.shape)] >= 0
            )
        boxes_outside = np.array(list(other_boxes)).reshape(-1, 6)
        boxes_outside = boxes_outside[
            (boxes_outside[:, :3] < hi).all(axis=1) & (boxes_outside[:, 3:] > self._lo).all(axis=1)
        ]
        is_foreign = self._mark_cells(boxes_outside).astype(np.int64)
        sums = np.pad(is_foreign, ((1, 0),) * 3).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
        total = int(np.prod([n * (n + 1) // 2 for n in self.shape]))
        seconds = np.full(total, np.inf, np.float32)
        trimmed = np.full(total, -1, np.int32)
        pieces = np.ones(total, np.int16)
        on_grid = (boxes.seconds, boxes.pieces)
        place = ((x_offset, y_offset, z_offset), boxes.shape)
        _fill_tables(is_covered, sums, place, on_grid, (seconds, trimmed, pieces))
        self._solver = Partitioner(BoxTables(self.shape, seconds, trimmed, pieces))
        self._pinwheel: Pinwheel | None = None

    @property
    def boxes(self) -> int:
        """Number of boxes in the window's tables."""
        return len(self._solver.boxes.seconds)

    @property
    def sums(self) -> int:
        """Number of sums in all of its solves."""
        return self._solver.sums

    def _mark_cells(self, boxes: Ints) -> Bools:
        """Mark the cells (nx, ny, nz) of the window that lie in any of some boxes (n, 6)."""
        inside = np.zeros(self.shape, dtype=np.bool_)
        for box in boxes:
            lo, hi = np.maximum(box[:3] - self._lo, 0), box[3:] - self._lo
            inside[lo[0] : hi[0], lo[1] : hi[1], lo[2] : hi[2]] = True
        return inside

    def count_fewest_parts(self, limit_s: float) -> int:
        """Find the fewest parts that each take at most limit_s; `UNREACHABLE` or more for none."""
        by_cuts = self._solver.solve(limit_s, ties=True)
        count, *pinwheel = _count_fewest_in_pinwheel(self._solver.counts, *self.shape)
        axis, is_mirrored, p1, p2, q1, q2 = pinwheel
        self._pinwheel = (axis, is_mirrored, p1, p2, q1, q2) if count < by_cuts else None
        return min(by_cuts, int(count))

    def list_chosen_boxes(self) -> list[Box]:
        """List the boxes of the last solution, in the cells of the grid."""
        if self._pinwheel is None:
            boxes = self._solver.list_chosen_boxes()
        else:
            arms = list_pinwheel_boxes(self.shape, self._pinwheel)
            boxes = [box for arm in arms for box in self._solver.list_chosen_boxes(arm)]
        x, y, z = self._lo.tolist()
        return [(a + x, b + y, c + z, d + x, e + y, f + z) for a, b, c, d, e, f in boxes]

    def solve(self, parts: int, below_s: float, min_s: float) -> list[Box] | None:
        """Cut the window into at most `parts` parts that all take less than below_s, about as fast as
        possible.

        The search does not go below min_s.
        """
        high = float(np.nextafter(np.float32(below_s), np.float32(0.0)))
        if self.count_fewest_parts(high) > parts:
            return None
        best, low = self.list_chosen_boxes(), min_s
        while high - low > TOLERANCE * high:
            middle = (low + high) / 2.0
            if self.count_fewest_parts(middle) <= parts:
                best, high = self.list_chosen_boxes(), middle
            else:
                low = middle
        return best


def improve_locally(
    boxes: BoxTables,
    partition: Sequence[Box],
    printers: int,
    max_windows: int = MAX_WINDOWS,
    effort: Effort | None = None,
) -> list[Box]:
    """Search for a partition whose times, the longest first, are lexicographically less.

    Parameters
    ----------
    boxes
        The tables.
    partition
        A partition: trimmed boxes that do not overlap and cover every needed cell.
    printers
        Maximum number of pieces; at least that of the partition.
    effort
        Budget from which the work is taken.
    """
    effort = effort or Effort()
    parts = list(partition)
    failed_windows: set[frozenset[Box]] = set()
    groups = _list_groups(boxes, parts)
    for _ in range(max_windows):
        group = next((g for g in groups if g not in failed_windows), None)
        if group is None or effort.is_spent():
            break
        spare = printers - _count_pieces(boxes, parts)
        other_boxes = [box for box in parts if box not in group]
        times = [_find_seconds(boxes, box) for box in group]
        window = Window(boxes, group, other_boxes)
        replacement = window.solve(
            _count_pieces(boxes, group) + spare, MAX_TIME_RATIO * max(times), 0.5 * float(np.mean(times))
        )
        effort.record(Work.BOX_PRICED, window.boxes)
        effort.record(Work.SUM, window.sums)
        if replacement is None:
            failed_windows.add(group)
        else:
            parts = other_boxes + replacement
            groups = _list_groups(boxes, parts)
    return parts


def sort_times_s(boxes: BoxTables, partition: Sequence[Box]) -> list[float]:
    """Sort the times of a partition, the longest first; lexicographically lower is better."""
    return sorted((_find_seconds(boxes, box) for box in partition), reverse=True)


def _find_seconds(boxes: BoxTables, box: Box) -> float:
    return float(boxes.seconds[box_index(box, boxes.shape)])


def _count_pieces(boxes: BoxTables, partition: Iterator[Box] | Sequence[Box] | frozenset[Box]) -> int:
    return sum(int(boxes.pieces[box_index(box, boxes.shape)]) for box in partition)


def _list_groups(boxes: BoxTables, parts: list[Box]) -> Iterator[frozenset[Box]]:
    """Yield groups of boxes to cut again: the slowest part first, its group with the most slack first."""
    ends = np.array(parts)
    seconds = np.array([_find_seconds(boxes, box) for box in parts])
    for centre in np.lexsort((*ends.T, -seconds)):
        lo, hi = ends[centre, :3], ends[centre, 3:]
        gap = np.maximum(ends[:, :3] - hi, lo - ends[:, 3:]).max(axis=1)
        neighbours = [
            i for i in np.flatnonzero(gap <= 0).tolist() if i != centre and seconds[i] < seconds[centre]
        ]
        neighbours = sorted(neighbours, key=lambda i: seconds[i])[:MAX_NEIGHBOURS]
        groups = []
        for extra in range(MAX_BOXES_IN_WINDOW):
            for chosen_neighbours in combinations(neighbours, extra):
                group = [int(centre), *chosen_neighbours]
                sides = ends[group, 3:].max(axis=0) - ends[group, :3].min(axis=0)
                if np.prod(sides * (sides + 1) // 2) <= MAX_BOXES:
                    groups.append((float(seconds[group].mean()), sorted(parts[i] for i in group)))
        for _, window in sorted(groups)[:MAX_WINDOWS_OF_A_BOX]:
            yield frozenset(window)
