"""The engine `guillotine`, for uniform printers and for printers with different build volumes and speeds.

First the model is cut as for uniform printers: each part fits the build volume that all printers have in
common, and the fastest printer prints the part that takes longest. If the printers differ, the model is then
cut for classes of printers (`printer_classes`), by an exact search over all guillotine partitions and all
ways to distribute their parts. The better of the two partitions is the result, so classes that are too coarse
do not make it worse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats
from decompose.bound import bound_makespan
from decompose.engines.guillotine.exact_search import ExactSearch, build_tables, cut_for_uniform_printers
from decompose.engines.guillotine.partitioner import OtherClass, Partitioner
from decompose.engines.guillotine.plane_shift import shift_planes
from decompose.engines.guillotine.printer_classes import PrinterClass, classify_printers, count_divisions
from decompose.engines.guillotine.recursion import UNREACHABLE_COUNT
from decompose.errors import NoFit, format_size
from decompose.grid import Box, BoxTables, Grid, index_box
from decompose.pieces import Piece, solve_bottleneck_assignment
from decompose.printers import TargetPrinter
from decompose.problem import GridFigures, Partition, Problem, Work

PiecesByBox = Mapping[Box, Sequence[Piece]]

MAX_BOX_DIVISIONS = 4e8
"""Maximum product of two numbers: the boxes in the tables, and the ways to divide the printers between the
two sides of a cut. With this product, a search over classes for one time limit takes a few seconds. Classes
of printers are merged until the product is small enough."""
# Maximum number of rounds with true prices (`exact_search`), and maximum number of partitions that are
# rejected because of a sliver or a weak joint.
MAX_ROUNDS, MAX_REJECTIONS = 4, 20
MAX_MAKESPAN_SHARE = 0.995  # maximum makespan that is searched for, as a share of the best makespan so far
TOLERANCE = 0.003  # accuracy of the least makespan, as a share of it
# Maximum number of printers that are added to a class to find how many printers would be enough.
MAX_ADDED_PRINTERS = 32
# Another round follows if the true makespan is more than this multiple of the expected one.
RETRY_RATIO = 1.01


def cut_by_guillotine(problem: Problem) -> Partition:
    """Cut a problem's model for the least makespan on its printers.

    Raises
    ------
    NoFit
        There are more pieces than printers; the error gives the number of printers that would be enough.
    """
    if problem.is_uniform:
        return cut_for_uniform_printers(problem)
    grid, tables, min_s = build_tables(problem)
    candidates: list[PiecesByBox] = []
    failure: NoFit | None = None
    try:
        candidates.append(_assign_printers(problem, ExactSearch(problem, grid, tables, min_s).run()))
    except NoFit as error:
        failure = error
    problem.on_stage("search")
    min_s *= problem.min_time_factor
    class_search = _ClassSearch(problem, grid, tables, min_s)
    makespan_s = min((_compute_makespan_s(problem, c) for c in candidates), default=math.inf)
    candidates += class_search.run(makespan_s)
    if not candidates:
        assert failure is not None
        raise _make_shortage_error(problem, grid, tables) or failure
    problem.on_stage("classes")
    best_candidate = min(candidates, key=lambda c: _compute_makespan_s(problem, c))
    pieces = tuple(shift_planes(problem, grid, best_candidate))
    for candidate in candidates:
        if candidate is not best_candidate and not problem.effort.is_spent():
            best_s = problem.compute_makespan_s(pieces)
            other_pieces = tuple(shift_planes(problem, grid, candidate, best_known_s=best_s))
            pieces = min(pieces, other_pieces, key=problem.compute_makespan_s)
    problem.on_stage("planes")
    figures = class_search.compute_grid_figures(grid, best_candidate, min_s, pieces)
    problem.on_stage("bound")
    return Partition(pieces, problem.model, np.eye(3), figures)


def _assign_printers(problem: Problem, pieces_by_box: PiecesByBox) -> PiecesByBox:
    """Assign printers to the pieces of boxes so that the last piece ends as soon as possible."""
    assigned_printers = problem.assign_printers(_list_pieces(pieces_by_box))
    return pieces_by_box if assigned_printers is None else _set_printers(pieces_by_box, assigned_printers)


def _set_printers(pieces_by_box: PiecesByBox, assigned_printers: Sequence[TargetPrinter]) -> PiecesByBox:
    """Assign a printer to each piece, in the order of the pieces."""
    printers = iter(assigned_printers)
    return {
        box: [replace(piece, printer=next(printers)) for piece in box_pieces]
        for box, box_pieces in pieces_by_box.items()
    }


def _list_pieces(pieces_by_box: PiecesByBox) -> list[Piece]:
    """List the pieces of all boxes."""
    return [piece for box_pieces in pieces_by_box.values() for piece in box_pieces]


def _compute_makespan_s(problem: Problem, pieces_by_box: PiecesByBox) -> float:
    """Compute the makespan of the pieces of all boxes."""
    return problem.compute_makespan_s(_list_pieces(pieces_by_box))


class _ClassSearch(ExactSearch):
    """Exact search for classes of printers, with true prices as in `ExactSearch`.

    It starts from the tables of the shared build volume, after an `ExactSearch` has corrected their prices.
    """

    def __init__(self, problem: Problem, grid: Grid, shared_tables: BoxTables, min_s: float) -> None:
        self.classes = classify_printers(problem.printers, MAX_BOX_DIVISIONS / len(shared_tables.seconds))
        self.class_tables = make_class_tables(problem, grid, shared_tables, self.classes)
        super().__init__(problem, grid, self.class_tables[0], min_s)
        other_classes = zip(self.class_tables[1:], self.classes[1:], strict=True)
        self.solver = Partitioner(
            self.class_tables[0],
            [OtherClass(table, printer_class.count) for table, printer_class in other_classes],
        )

    def run(self, best_known_s: float) -> list[PiecesByBox]:  # type: ignore[override]
        """Find a partition with a shorter makespan than the best known one, at true prices.

        The result is a list of this one partition; it is empty if there is no such partition, or if there is
        only one class.
        """
        candidates: list[PiecesByBox] = []
        tolerance_s = TOLERANCE * (best_known_s if math.isfinite(best_known_s) else self.min_s)
        if len(self.classes) == 1 or not self._may_succeed(MAX_MAKESPAN_SHARE * best_known_s, tolerance_s):
            return candidates
        round_count = 0
        while round_count < MAX_ROUNDS and len(self.rejections) < MAX_REJECTIONS:
            if math.isfinite(best_known_s) and self.problem.effort.is_spent():
                break
            limit_s = self._solve(self.classes[0].count, tolerance_s, MAX_MAKESPAN_SHARE * best_known_s)
            if limit_s is None:
                break
            self.min_s = max(self.min_s, limit_s - tolerance_s)
            boxes = self.solver.list_chosen_boxes()
            if self._correct_piece_counts(boxes) or self._exclude_faulty_boxes(boxes):
                continue
            round_count += 1
            candidate = self._assign_printers_by_tables(boxes)
            makespan_s = _compute_makespan_s(self.problem, candidate)
            if makespan_s < best_known_s:
                candidates, best_known_s = [candidate], makespan_s
            if makespan_s <= RETRY_RATIO * limit_s:
                break
            self._record_prices(candidate)
        return candidates

    def _may_succeed(self, max_s: float, tolerance_s: float) -> bool:
        """Check whether a partition could meet `max_s` if the best printer for each box printed that box."""
        best_tables = replace(
            self.tables, seconds=np.min([table.seconds for table in self.class_tables], axis=0)
        )
        count = sum(printer_class.count for printer_class in self.classes)
        solver = Partitioner(best_tables)
        min_s = solver.find_min_makespan_s(count, self.min_s, tolerance_s, max_s)
        self.problem.effort.record(Work.SUM, solver.sum_count)
        if min_s is not None:
            self.min_s = max(self.min_s, min_s - tolerance_s)
        return min_s is not None

    def _exclude_box(self, box: Box) -> None:
        """Exclude a box from the tables of all classes."""
        for table in self.class_tables:
            table.seconds[index_box(box, self.tables.shape)] = math.inf

    def _assign_printers_by_tables(self, boxes: Sequence[Box]) -> PiecesByBox:
        """Assign printers to the pieces of boxes, according to the times in the tables."""
        pieces_by_box = {box: self.cut_box(box) for box in boxes}
        assigned_printers = solve_bottleneck_assignment(self._look_up_seconds(boxes))
        assert assigned_printers is not None  # the search has found an assignment
        printers = [printer for printer_class in self.classes for printer in printer_class.printers]
        return _set_printers(pieces_by_box, [printers[i] for i in assigned_printers])

    def _look_up_seconds(self, boxes: Sequence[Box]) -> Floats:
        """Look up the seconds (pieces, printers) of pieces on all printers, in the order of the classes."""
        indices = [index_box(box, self.tables.shape) for box in boxes]
        rows = np.repeat(indices, self.tables.piece_counts[indices])
        columns = [
            table.seconds[rows].astype(np.float64) / printer_class.time_factor * printer.time_factor
            for table, printer_class in zip(self.class_tables, self.classes, strict=True)
            for printer in printer_class.printers
        ]
        return np.array(columns).T

    def _record_prices(self, pieces_by_box: PiecesByBox) -> None:
        """Record each piece's true price in the tables of the classes with its printer's build volume."""
        for box, pieces in pieces_by_box.items():
            index = index_box(box, self.tables.shape)
            for piece, pose in zip(pieces, self.problem.find_poses(list(pieces)), strict=True):
                seconds = math.inf if pose is None else pose.price_s
                printer_class = next(
                    other_class for other_class in self.classes if piece.printer in other_class.printers
                )
                for other_class, table in zip(self.classes, self.class_tables, strict=True):
                    if other_class.box_sizes_mm == printer_class.box_sizes_mm:
                        table.seconds[index] = max(
                            float(table.seconds[index]), seconds * other_class.time_factor
                        )

    def compute_grid_figures(
        self, grid: Grid, pieces_by_box: PiecesByBox, min_s: float, pieces: Sequence[Piece]
    ) -> GridFigures:
        """Compute the makespan of a partition according to the tables, and a lower bound for all partitions.

        The bound is proven as if all printers had the speed of the fastest one and, for each box, the best
        build volume.
        """
        problem = self.problem
        times_s = self._look_up_seconds(list(pieces_by_box))
        assigned_printers = solve_bottleneck_assignment(times_s)
        if assigned_printers is None:  # the first search may use boxes that this search has excluded
            makespan_s = _compute_makespan_s(problem, pieces_by_box)
        else:
            makespan_s = float(times_s[range(len(assigned_printers)), assigned_printers].max())
        if problem.needs_proof(pieces):
            min_time_factor = np.float32(problem.min_time_factor)
            printer_tables = [problem.price_boxes(grid, [printer]) for printer in problem.distinct_printers]
            best_tables = replace(
                printer_tables[0],
                seconds=min_time_factor * np.min([tables.seconds for tables in printer_tables], axis=0),
                piece_counts=np.max([tables.piece_counts for tables in printer_tables], axis=0),
            )
            problem.effort.record(Work.BOX_PROVEN, len(best_tables.seconds))
            bound = bound_makespan(best_tables, grid.is_needed, len(problem.printers), makespan_s)
            min_s = max(min_s, bound.seconds)
        return GridFigures(makespan_s, min_s, grid.shape)


def _make_shortage_error(problem: Problem, grid: Grid, shared_tables: BoxTables) -> NoFit | None:
    """Build the error with the number of printers of each class that would be enough; None if it is unknown.

    More printers of the first class, of one other class, or of both are considered.
    """
    max_divisions = MAX_BOX_DIVISIONS / len(shared_tables.seconds)
    classes = classify_printers(
        [replace(printer, time_factor=1.0) for printer in problem.printers], max_divisions
    )
    tables = make_class_tables(problem, grid, shared_tables, classes)
    available_counts = [printer_class.count for printer_class in classes]
    shortages: list[tuple[int, list[int]]] = []
    for grown_class in range(1, len(classes)):
        counts = _grow_counts(available_counts, grown_class, max_divisions)
        other_classes = [OtherClass(table, count) for table, count in zip(tables[1:], counts, strict=True)]
        solver = Partitioner(tables[0], other_classes)
        solver.solve(float(np.finfo(np.float32).max))  # a finite limit, because inf means no fit
        for state, fewest_printers in zip(*solver.list_class_counts(), strict=True):
            shortage = [
                max(0, int(n) - count)
                for n, count in zip((fewest_printers, *state), available_counts, strict=True)
            ]
            shortages += [(sum(shortage), shortage)] if fewest_printers < UNREACHABLE_COUNT else []
    total, shortage = min(shortages, default=(0, []))
    if total == 0:
        return None
    requests = [
        f"{count} more with room for {format_size(np.max(printer_class.box_sizes_mm, axis=0))} mm"
        for count, printer_class in zip(shortage, classes, strict=True)
        if count
    ]
    printer_count = len(problem.printers)
    return NoFit.from_shortage(
        problem.model.extents_mm, printer_count + total, printer_count, " and ".join(requests)
    )


def _grow_counts(available_counts: Sequence[int], grown_class: int, max_divisions: float) -> list[int]:
    """Raise the number of printers of one class as far as the search allows.

    The returned numbers are those of all classes but the first.
    """
    counts = list(available_counts[1:])
    for _ in range(MAX_ADDED_PRINTERS):
        larger_counts = list(counts)
        larger_counts[grown_class - 1] += 1
        if count_divisions([max(larger_counts), *larger_counts]) > max_divisions:
            break
        counts = larger_counts
    return counts


def make_class_tables(
    problem: Problem, grid: Grid, shared_tables: BoxTables, classes: Sequence[PrinterClass]
) -> list[BoxTables]:
    """Build the tables of each class of printers; their times include the speed of the class.

    `trimmed_box` and `piece_counts` are the same in all tables.

    Parameters
    ----------
    problem
        Problem with the printers.
    grid
        Grid over the model.
    shared_tables
        Tables of the build volume that all printers have in common.
    classes
        Classes of the printers.
    """
    tables: dict[object, BoxTables] = {}
    for printer_class in classes:
        if printer_class.box_sizes_mm in tables:
            continue
        is_smallest = all(
            p.fits(*box) for box in printer_class.box_sizes_mm for p in problem.distinct_printers
        )
        tables[printer_class.box_sizes_mm] = (
            shared_tables if is_smallest else problem.price_boxes(grid, [printer_class.smallest_printer])
        )
    piece_counts = np.max([shared_tables.piece_counts, *(t.piece_counts for t in tables.values())], axis=0)
    return [
        replace(
            shared_tables,
            seconds=tables[printer_class.box_sizes_mm].seconds * np.float32(printer_class.time_factor),
            piece_counts=piece_counts,
        )
        for printer_class in classes
    ]
