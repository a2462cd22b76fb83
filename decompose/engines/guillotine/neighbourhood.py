"""Neighbourhood search: improvement of a partition near its slowest boxes, not limited to guillotine cuts.

A window consists of a box and a few faster boxes next to it; windows around the slowest box are tried first.
The window is cut again so that its slowest part ends sooner; all other boxes stay as they are. The window may
get no more parts than it has, plus one for each spare printer. The union of the boxes of a window need not be
a box. A new cut of a window may move one face, pass a slab from one box to the next, or merge boxes and split
them elsewhere.

The tables of a window are cut out of those of the grid. Only the cells of the window's own boxes have to be
covered, and a box that overlaps another box of the partition is not allowed. The search over guillotine cuts
of a window is exact. In addition, the window as a whole may be cut as a pinwheel (`pinwheel`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Ints
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.engines.guillotine.pinwheel import Pinwheel, find_smallest_pinwheel, list_pinwheel_boxes
from decompose.grid import Box, BoxTables, Shape, compute_index, find_interval_ends, index_box, sum_box
from decompose.jit import jit
from decompose.problem import Effort, Work

MAX_WINDOWS = 200  # maximum number of windows that one search cuts again
MAX_BOXES_IN_WINDOW = 5  # maximum number of boxes in a window
MAX_NEIGHBOURS = 10  # maximum number of neighbours of a box, the fastest first, that form windows with it
MAX_WINDOWS_PER_BOX = 24  # maximum number of windows around one box, those with the least mean time first
MAX_BOXES = 150_000  # maximum number of boxes of all sizes in a window's tables; larger windows are left out
MAX_TIME_RATIO = 0.999  # the new time of a window's slowest part must be below this share of the old time
TOLERANCE = 0.002  # accuracy of the least makespan of a window, as a share of it


@jit
def _split_box(box: Box, shape: Shape) -> tuple[int, int]:
    """Find the indices of the two parts of a box of several cells: all but its last layer, and that layer.

    Parameters
    ----------
    box
        Box in cells of the window.
    shape
        Shape of the window, in cells.
    """
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
def _join_bounds(
    trimmed_box: npt.NDArray[np.int32],
    bounds: npt.NDArray[np.int16],
    parts: tuple[int, int],
    box: int,
) -> bool:
    """Join the bounds of the two parts of a box; return False if neither has cells to be covered.

    Parameters
    ----------
    trimmed_box
        (boxes,) int32, -1 for a box without cells to be covered.
    bounds
        (boxes, 6) int16 smallest box around the cells to be covered in each box; the row `box` is filled in.
    parts
        Indices of the two parts.
    box
        Index of the box.
    """
    lower, upper = parts
    if trimmed_box[lower] < 0 and trimmed_box[upper] < 0:
        return False
    if trimmed_box[lower] < 0:
        lower = upper
    elif trimmed_box[upper] < 0:
        upper = lower
    for k in range(3):
        bounds[box, k] = min(bounds[lower, k], bounds[upper, k])
        bounds[box, k + 3] = max(bounds[lower, k + 3], bounds[upper, k + 3])
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
        (wx, wy, wz) bool, true for cells of the window to be covered.
    other_sums
        (wx + 1, wy + 1, wz + 1) int64 summed-area table of the cells that boxes outside the window occupy.
    place
        First cell x, y, z of the window on the grid, and the grid's shape.
    grid_tables
        `seconds` float32 and `piece_counts` int16 of the grid, (boxes of the grid,).
    tables
        `seconds` float32, `trimmed_box` int32 and `piece_counts` int16 of the window, (boxes of the window,),
        filled in; initially +inf, -1 and 1.
    """
    (x, y, z), grid_shape = place
    grid_seconds, grid_piece_counts = grid_tables
    seconds, trimmed_box, piece_counts = tables
    wx, wy, wz = shape = own_cells.shape
    bounds = np.zeros((len(seconds), 6), np.int16)
    box = -1
    for ix in range(wx * (wx + 1) // 2):
        x0, x1 = find_interval_ends(ix, wx)
        for iy in range(wy * (wy + 1) // 2):
            y0, y1 = find_interval_ends(iy, wy)
            for dz in range(1, wz + 1):
                for z0 in range(wz - dz + 1):
                    box += 1
                    ends = (x0, y0, z0, x1, y1, z0 + dz)
                    if x1 - x0 == 1 and y1 - y0 == 1 and dz == 1:
                        if not own_cells[x0, y0, z0]:
                            continue
                        for k in range(6):
                            bounds[box, k] = ends[k]
                    elif not _join_bounds(trimmed_box, bounds, _split_box(ends, shape), box):
                        continue
                    trimmed_box[box] = compute_index(
                        (
                            bounds[box, 0],
                            bounds[box, 1],
                            bounds[box, 2],
                            bounds[box, 3],
                            bounds[box, 4],
                            bounds[box, 5],
                        ),
                        shape,
                    )
                    if trimmed_box[box] == box and sum_box(other_sums, ends) == 0:
                        grid_index = compute_index(
                            (x + x0, y + y0, z + z0, x + x1, y + y1, z + z0 + dz), grid_shape
                        )
                        seconds[box] = grid_seconds[grid_index]
                        piece_counts[box] = grid_piece_counts[grid_index]


class Window:
    """Window of a partition: some boxes of the partition, which are cut again while the others stay.

    Parameters
    ----------
    tables
        Tables of the grid.
    boxes_to_cut, other_boxes
        Boxes of the partition that are cut again, and all other boxes of the partition.
    """

    def __init__(self, tables: BoxTables, boxes_to_cut: Iterable[Box], other_boxes: Iterable[Box]) -> None:
        window_boxes = np.array(sorted(boxes_to_cut))
        self._lo, hi = window_boxes[:, :3].min(axis=0), window_boxes[:, 3:].max(axis=0)
        nx, ny, nz = (hi - self._lo).tolist()
        self.shape = (nx, ny, nz)
        is_own = self._mark_cells(window_boxes)
        x_offset, y_offset, z_offset = self._lo.tolist()
        for cell in np.argwhere(is_own):
            x, y, z = (self._lo + cell).tolist()
            is_own[tuple(cell)] = (
                tables.trimmed_box[index_box((x, y, z, x + 1, y + 1, z + 1), tables.shape)] >= 0
            )
        boxes_outside = np.array(list(other_boxes)).reshape(-1, 6)
        boxes_outside = boxes_outside[
            (boxes_outside[:, :3] < hi).all(axis=1) & (boxes_outside[:, 3:] > self._lo).all(axis=1)
        ]
        is_occupied = self._mark_cells(boxes_outside).astype(np.int64)
        sums = np.pad(is_occupied, ((1, 0),) * 3).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
        box_count = int(np.prod([n * (n + 1) // 2 for n in self.shape]))
        seconds = np.full(box_count, np.inf, np.float32)
        trimmed_box = np.full(box_count, -1, np.int32)
        piece_counts = np.ones(box_count, np.int16)
        grid_tables = (tables.seconds, tables.piece_counts)
        place = ((x_offset, y_offset, z_offset), tables.shape)
        _fill_tables(is_own, sums, place, grid_tables, (seconds, trimmed_box, piece_counts))
        self._solver = Partitioner(BoxTables(self.shape, seconds, trimmed_box, piece_counts))
        self._pinwheel: Pinwheel | None = None

    @property
    def box_count(self) -> int:
        """Number of boxes in the window's tables."""
        return len(self._solver.tables.seconds)

    @property
    def sum_count(self) -> int:
        """Number of additions of the values of both sides of a cut, in all searches in the window."""
        return self._solver.sum_count

    def _mark_cells(self, boxes: Ints) -> Bools:
        """Mark the cells (wx, wy, wz) of the window that lie in any of the boxes (n, 6)."""
        is_inside = np.zeros(self.shape, dtype=np.bool_)
        for box in boxes:
            lo, hi = np.maximum(box[:3] - self._lo, 0), box[3:] - self._lo
            is_inside[lo[0] : hi[0], lo[1] : hi[1], lo[2] : hi[2]] = True
        return is_inside

    def count_fewest_parts(self, limit_s: float) -> int:
        """Find the minimum number of parts of a partition in which each part takes at most `limit_s`.

        The number is `UNREACHABLE_COUNT` or higher if there is no such partition.
        """
        fewest_by_cuts = self._solver.solve(limit_s, break_ties=True)
        count, *pinwheel = find_smallest_pinwheel(self._solver.counts, *self.shape)
        axis, is_mirrored, p1, p2, q1, q2 = pinwheel
        self._pinwheel = (axis, is_mirrored, p1, p2, q1, q2) if count < fewest_by_cuts else None
        return min(fewest_by_cuts, int(count))

    def list_chosen_boxes(self) -> list[Box]:
        """List the boxes of the last solution, in the cells of the grid."""
        if self._pinwheel is None:
            boxes = self._solver.list_chosen_boxes()
        else:
            arms = list_pinwheel_boxes(self.shape, self._pinwheel)
            boxes = [box for arm in arms for box in self._solver.list_chosen_boxes(arm)]
        x, y, z = self._lo.tolist()
        return [(a + x, b + y, c + z, d + x, e + y, f + z) for a, b, c, d, e, f in boxes]

    def solve(self, max_parts: int, time_limit_s: float, min_s: float) -> list[Box] | None:
        """Cut the window into parts with about the least makespan; None if no partition meets the limits.

        Parameters
        ----------
        max_parts
            Maximum number of parts.
        time_limit_s
            Time that each part must stay below.
        min_s
            Lower limit of the makespans that are tried.
        """
        high_s = float(np.nextafter(np.float32(time_limit_s), np.float32(0.0)))
        if self.count_fewest_parts(high_s) > max_parts:
            return None
        best_boxes, low_s = self.list_chosen_boxes(), min_s
        while high_s - low_s > TOLERANCE * high_s:
            middle_s = (low_s + high_s) / 2.0
            if self.count_fewest_parts(middle_s) <= max_parts:
                best_boxes, high_s = self.list_chosen_boxes(), middle_s
            else:
                low_s = middle_s
        return best_boxes


def improve_locally(
    tables: BoxTables,
    partition: Sequence[Box],
    printer_count: int,
    max_windows: int = MAX_WINDOWS,
    effort: Effort | None = None,
) -> list[Box]:
    """Search near a partition for one whose times, sorted in descending order, are lexicographically smaller.

    Parameters
    ----------
    tables
        Tables of the grid.
    partition
        Trimmed boxes that do not overlap and cover every needed cell.
    printer_count
        Maximum number of pieces, at least the number of pieces of the partition.
    max_windows
        Maximum number of windows to cut again.
    effort
        Effort in which the work is recorded, and whose budget limits the search; None for no limit.
    """
    effort = effort or Effort()
    parts = list(partition)
    failed_windows: set[frozenset[Box]] = set()
    windows = _list_window_boxes(tables, parts)
    for _ in range(max_windows):
        window_boxes = next((boxes for boxes in windows if boxes not in failed_windows), None)
        if window_boxes is None or effort.is_spent():
            break
        spare_printer_count = printer_count - _count_pieces(tables, parts)
        other_boxes = [box for box in parts if box not in window_boxes]
        times_s = [_look_up_seconds(tables, box) for box in window_boxes]
        window = Window(tables, window_boxes, other_boxes)
        replacement = window.solve(
            _count_pieces(tables, window_boxes) + spare_printer_count,
            MAX_TIME_RATIO * max(times_s),
            0.5 * float(np.mean(times_s)),
        )
        effort.record(Work.BOX_PRICED, window.box_count)
        effort.record(Work.SUM, window.sum_count)
        if replacement is None:
            failed_windows.add(window_boxes)
        else:
            parts = other_boxes + replacement
            windows = _list_window_boxes(tables, parts)
    return parts


def sort_times_s(tables: BoxTables, partition: Sequence[Box]) -> list[float]:
    """Sort the times of a partition in descending order; lexicographically lower is better.

    Parameters
    ----------
    tables
        Tables of the grid.
    partition
        Boxes of the partition.
    """
    return sorted((_look_up_seconds(tables, box) for box in partition), reverse=True)


def _look_up_seconds(tables: BoxTables, box: Box) -> float:
    """Look up the time of a box."""
    return float(tables.seconds[index_box(box, tables.shape)])


def _count_pieces(tables: BoxTables, partition: Iterator[Box] | Sequence[Box] | frozenset[Box]) -> int:
    """Count the pieces of all boxes according to the tables."""
    return sum(int(tables.piece_counts[index_box(box, tables.shape)]) for box in partition)


def _list_window_boxes(tables: BoxTables, parts: list[Box]) -> Iterator[frozenset[Box]]:
    """Yield the boxes of each window, windows around slower boxes first.

    Among the windows around one box, those with the least mean time come first.
    """
    ends = np.array(parts)
    seconds = np.array([_look_up_seconds(tables, box) for box in parts])
    for centre in np.lexsort((*ends.T, -seconds)):
        lo, hi = ends[centre, :3], ends[centre, 3:]
        gap = np.maximum(ends[:, :3] - hi, lo - ends[:, 3:]).max(axis=1)
        neighbours = [
            i for i in np.flatnonzero(gap <= 0).tolist() if i != centre and seconds[i] < seconds[centre]
        ]
        neighbours = sorted(neighbours, key=lambda i: seconds[i])[:MAX_NEIGHBOURS]
        windows = []
        for neighbour_count in range(MAX_BOXES_IN_WINDOW):
            for chosen_neighbours in combinations(neighbours, neighbour_count):
                numbers = [int(centre), *chosen_neighbours]
                sides = ends[numbers, 3:].max(axis=0) - ends[numbers, :3].min(axis=0)
                if np.prod(sides * (sides + 1) // 2) <= MAX_BOXES:
                    windows.append((float(seconds[numbers].mean()), sorted(parts[i] for i in numbers)))
        for _, boxes in sorted(windows)[:MAX_WINDOWS_PER_BOX]:
            yield frozenset(boxes)
