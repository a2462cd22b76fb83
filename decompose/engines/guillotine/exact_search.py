"""Exact search of the engine `guillotine` for uniform printers: those with one build volume and one speed.

All boxes of a grid are priced, and the best guillotine partition into boxes is found exactly. Then its boxes
are cut out of the model, and their pieces are priced. These true prices replace those from the grid, prices
of other boxes are estimated from them (`price_excess`), and the search is repeated. Afterwards, the partition
is improved with cuts that are not guillotine cuts, and its planes are moved off the grid. As long as the
budget lasts, so are the planes of looser partitions, which have less total print time (`least_work`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from decompose.bound import compute_surface_bound_s
from decompose.engines.guillotine.least_work import LeastWorkSearch, Range
from decompose.engines.guillotine.neighbourhood import improve_locally, sort_times_s
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.engines.guillotine.plane_shift import estimate_shift_s, refine_needed_cells, shift_planes
from decompose.engines.guillotine.price_excess import PriceExcess
from decompose.engines.guillotine.recursion import UNREACHABLE_COUNT
from decompose.errors import NoFit, format_size
from decompose.grid import VOLUME, Box, BoxTables, Grid, index_box
from decompose.pieces import Piece, cut_cells, find_faults
from decompose.problem import Partition, Problem, Work

MAX_ROUNDS = 8  # maximum number of rounds; each one chooses boxes, and computes their true prices
MAX_REJECTIONS = 40  # maximum number of partitions rejected because of a sliver or a weak joint
MAX_UNPOSED_COUNT = 40  # maximum number of partitions with a part that has no pose
# Another round follows if the true makespan is more than this multiple of the expected one.
RETRY_RATIO = 1.01
# The least makespan according to the estimates is sought to an accuracy of `TOLERANCE_S`, or of the share
# `TOLERANCE` of the makespan if that is longer; the errors of the tables' prices are larger.
TOLERANCE_S = 1.0
TOLERANCE = 5e-4
# Share of the unreserved budget for the exact search; the rest is for the neighbourhood search.
SEARCH_SHARE = 0.75
LATE_TOLERANCE = 0.02  # accuracy as a share of the makespan, once the budget is spent without a result
# Minimum and maximum times of a part of looser partitions, as multiples of the least makespan on the grid.
TIME_RANGES = ((0.0, 1.03), (0.7, 1.03), (0.0, 1.015), (0.5, 1.03), (0.7, 1.05), (0.0, 1.05), (0.7, 1.015))
# Looser partitions whose mean time of a part exceeds this multiple of the best makespan are not shifted.
MAX_MEAN_RATIO = 1.02
MAX_LOOSER_ROUNDS = 2  # maximum number of rounds for each of them
WORK_RATIO = 2  # work of an addition of print times, as a multiple of that of numbers of parts
MAX_KEPT_FACES = 300_000  # maximum number of faces of the pieces that are kept for later rounds
# Looser partitions are tried only if the makespan of the result is below this multiple of the one to beat.
CLOSE_RATIO = 1.03


def cut_for_uniform_printers(problem: Problem) -> Partition:
    """Cut a problem's model along its grid for the least makespan on uniform printers.

    Raises
    ------
    NoFit
        There are more pieces than printers; the error gives the number of printers that would be enough.
    """
    grid, tables, bound_s = build_tables(problem)
    get_needed_cells = problem.start_work(partial(refine_needed_cells, problem, grid))
    search = ExactSearch(problem, grid, tables, bound_s)
    needs_proof = problem.options.prove and math.isinf(problem.best_known_s)  # no result to beat
    problem.effort.reserved_s = estimate_shift_s(problem, len(problem.printers))
    partition = search.run()
    problem.effort.reserved_s = 0.0
    problem.on_stage("search")
    proof = problem.start_proof(grid, tables, list(partition)) if needs_proof else None
    pieces = tuple(shift_planes(problem, grid, partition, get_needed_cells()))
    is_promising = (
        problem.is_thorough and problem.compute_makespan_s(pieces) < CLOSE_RATIO * problem.best_known_s
    )
    if is_promising and not problem.effort.is_spent():
        for looser_partition in search.list_looser_partitions(list(partition)):
            # The times of pieces that are cut for no certain printer are those of a printer with factor 1.
            best_s = problem.compute_makespan_s(pieces) / problem.min_time_factor
            if search.compute_mean_s(looser_partition) <= MAX_MEAN_RATIO * best_s:
                other_pieces = tuple(
                    shift_planes(problem, grid, looser_partition, get_needed_cells(), best_s)
                )
                pieces = min(pieces, other_pieces, key=problem.compute_makespan_s)
            if problem.effort.is_spent():
                break
    problem.on_stage("planes")
    figures = problem.compute_grid_figures(grid, tables, list(partition), pieces, proof)
    problem.on_stage("bound")
    return Partition(pieces, problem.model, np.eye(3), figures)


def build_tables(problem: Problem) -> tuple[Grid, BoxTables, float]:
    """Build a problem's grid, price its boxes, and compute a lower bound on the makespan in s."""
    grid = problem.build_grid(problem.model)
    problem.on_stage("grid")
    tables = problem.price_boxes(grid)
    problem.on_stage("boxes")
    needed_mm3 = float(grid.sums[grid.is_needed][:, VOLUME].sum())
    area_mm2 = problem.model.solid.area_mm2
    return grid, tables, compute_surface_bound_s(area_mm2, needed_mm3, len(problem.printers), problem.cost)


class ExactSearch:
    """Exact search, with true prices and numbers of pieces for the boxes that it chooses.

    The tables may count too few pieces in a box. They price the box in an axis-aligned pose (one of its sides
    lies on the bed), even if it is not stable in it. For the chosen boxes, the true numbers of pieces are
    written into the tables, and the true prices where they are higher. Prices of the other boxes are
    estimated again, and the search is repeated with these estimates. A box with a piece that cannot be glued
    well is excluded.
    """

    def __init__(
        self,
        problem: Problem,
        grid: Grid,
        tables: BoxTables,
        bound_s: float,
        excess: PriceExcess | None = None,
    ) -> None:
        self.problem, self.grid, self.tables = problem, grid, tables
        self.excess = excess or PriceExcess(grid, tables)
        self.bound_s = bound_s  # lower bound on the makespan at any prices
        self.min_s = bound_s  # lower bound on the makespan at the estimated prices
        self.least_s = math.inf  # last least makespan at estimated prices
        self.guess_s: float | None = None  # least makespan at the prices of the last round
        self.solver = Partitioner(self.excess.estimates, executor=problem.executor)
        self.pieces_by_box: dict[Box, list[Piece]] = {}
        self.true_times_s: dict[Box, float] = {}
        self.rejections: list[str] = []  # a fault of each rejected partition

    def run(self) -> dict[Box, list[Piece]]:
        """Search for the partition with the least true makespan; return its boxes, and the pieces in each."""
        best_boxes: list[Box] = []
        best_s = math.inf
        round_count, unposed_count, effort = 0, 0, self.problem.effort
        search_end_s = effort.spent_s + SEARCH_SHARE * (effort.budget_s - effort.reserved_s - effort.spent_s)
        while True:
            is_late = effort.spent_s >= search_end_s
            if is_late:
                effort.is_cut_short = True  # from here on any partition is accepted
                if best_boxes:
                    break
            tolerance = LATE_TOLERANCE if is_late else TOLERANCE
            tolerance_s = max(TOLERANCE_S, tolerance * (self.guess_s or self.min_s))
            makespan_s = self._solve(len(self.problem.printers), tolerance_s)
            is_hopeless = len(self.rejections) > MAX_REJECTIONS or unposed_count > MAX_UNPOSED_COUNT
            if makespan_s is None or is_hopeless:
                if best_boxes:
                    break
                raise self._make_no_fit_error()
            self.least_s = makespan_s
            self.min_s = max(self.min_s, makespan_s if is_late else makespan_s - tolerance_s)
            if makespan_s >= best_s:
                break
            boxes = self.solver.list_chosen_boxes()
            if self._correct_piece_counts(boxes) or self._exclude_faulty_boxes(boxes):
                self._drop_pieces(boxes)
                continue
            longest_s = self._compute_true_makespan_s(boxes)
            if math.isinf(longest_s):  # the tables now exclude the box whose piece has no pose
                unposed_count += 1
                continue
            round_count += 1
            if longest_s < best_s:
                best_boxes, best_s = boxes, longest_s
            is_estimated_well = makespan_s / RETRY_RATIO <= longest_s <= RETRY_RATIO * makespan_s
            if is_estimated_well or round_count == MAX_ROUNDS:
                break
            self._estimate_prices()
        best_boxes = self._improve_partition(best_boxes)
        self._drop_pieces(best_boxes)
        return {box: self.cut_box(box) for box in best_boxes}

    def list_looser_partitions(self, best_partition: Sequence[Box]) -> Iterator[dict[Box, list[Piece]]]:
        """Yield partitions with little total print time, but perhaps a longer makespan than the best one.

        The best partition on the grid may not be the best one after its planes are shifted: shifts balance
        the times of the parts, so the total print time matters then (`least_work`). A minimum time of a part
        excludes parts that are too short to be balanced.
        """
        if len(best_partition) < 2:
            return
        # Copies, so that the tables of this search do not change.
        seconds, piece_counts = self.tables.seconds.copy(), self.tables.piece_counts.copy()
        tables = replace(self.tables, seconds=seconds, piece_counts=piece_counts)
        search = ExactSearch(self.problem, self.grid, tables, self.bound_s, self.excess.copy(tables))
        search.pieces_by_box, search.true_times_s = self.pieces_by_box, self.true_times_s
        search.excess.update_estimates()
        known_partitions = {frozenset(best_partition)}
        for min_ratio, max_ratio in TIME_RANGES:
            range_s = (min_ratio * self.least_s, max_ratio * self.least_s)
            boxes = search._find_partition_within_limits(range_s)
            if boxes and frozenset(boxes) not in known_partitions:
                known_partitions.add(frozenset(boxes))
                yield {box: self.cut_box(box) for box in boxes}

    def compute_mean_s(self, partition: Mapping[Box, Sequence[Piece]]) -> float:
        """Compute a lower bound on the mean true time of the pieces of a priced partition, in seconds.

        Only the slowest piece of each box is priced.
        """
        total_s = sum(self.true_times_s[box] for box in partition)
        return total_s / sum(len(pieces) for pieces in partition.values())

    def _find_partition_within_limits(self, range_s: Range) -> list[Box]:
        """Find a partition with about the least total print time among those whose boxes meet two limits.

        At true prices, its boxes may take a little less than the minimum or more than the maximum. The list
        is empty if there is no such partition.
        """
        best_boxes: list[Box] = []
        best_s, round_count = math.inf, 0
        search = LeastWorkSearch(self.excess.estimates, self.problem.executor)
        for _ in range(MAX_ROUNDS):
            if self.problem.effort.is_spent() or round_count == MAX_LOOSER_ROUNDS:
                break
            previous_sum_count = search.sum_count
            boxes = search.find_boxes(range_s, len(self.problem.printers))
            self.problem.effort.record(Work.SUM, WORK_RATIO * (search.sum_count - previous_sum_count))
            if not boxes:
                break
            if self._correct_piece_counts(boxes) or self._exclude_faulty_boxes(boxes):
                continue
            round_count += 1
            longest_s = self._compute_true_makespan_s(boxes)
            if longest_s < best_s:
                best_boxes, best_s = boxes, longest_s
            if longest_s <= RETRY_RATIO * range_s[1]:
                break
            self.excess.update_estimates()
        return best_boxes

    def _estimate_prices(self) -> None:
        """Estimate prices again; they may rise and fall, so the last makespan is no lower bound any more."""
        self.excess.update_estimates()
        self.min_s = self.bound_s

    def _solve(self, printer_count: int, tolerance_s: float, max_s: float = math.inf) -> float | None:
        """Find the least makespan at estimated prices (`find_min_makespan_s`), and record the work."""
        previous_sum_count = self.solver.sum_count
        least_s = self.solver.find_min_makespan_s(printer_count, self.min_s, tolerance_s, max_s, self.guess_s)
        self.guess_s = least_s
        self.problem.effort.record(Work.SUM, self.solver.sum_count - previous_sum_count)
        return least_s

    def _improve_partition(self, partition: list[Box]) -> list[Box]:
        """Improve a partition at true prices by neighbourhood search, not limited to guillotine cuts."""
        for _ in range(MAX_ROUNDS):
            if len(self.rejections) >= MAX_REJECTIONS or self.problem.effort.is_spent():
                break
            boxes = improve_locally(
                self.excess.estimates, partition, len(self.problem.printers), effort=self.problem.effort
            )
            if boxes == partition:
                break
            if self._correct_piece_counts(boxes) or self._exclude_faulty_boxes(boxes):
                continue
            self._compute_true_makespan_s(boxes)
            estimates = self.excess.estimates
            if sort_times_s(estimates, boxes) < sort_times_s(estimates, partition):
                partition = boxes
        return partition

    def cut_box(self, box: Box) -> list[Piece]:
        """Cut out the pieces in a box; return the kept ones if they were cut in an earlier round."""
        if box not in self.pieces_by_box:
            self.problem.effort.record(Work.FACE_CUT, self.problem.model.solid.face_count)
            self.pieces_by_box[box] = cut_cells(self.problem.model.solid, self.grid, box)
        return self.pieces_by_box[box]

    def _drop_pieces(self, boxes: Sequence[Box]) -> None:
        """Drop the oldest pieces outside these boxes until at most `MAX_KEPT_FACES` faces are kept."""
        counts = {box: sum(p.solid.face_count for p in pieces) for box, pieces in self.pieces_by_box.items()}
        excess_face_count = sum(counts.values()) - MAX_KEPT_FACES
        for box, count in counts.items():
            if excess_face_count <= 0:
                break
            if box not in boxes:
                excess_face_count -= count
                del self.pieces_by_box[box]

    def _correct_piece_counts(self, boxes: list[Box]) -> bool:
        """Record the true numbers of pieces in the table; return whether one is higher than before."""
        has_more = False
        for box in boxes:
            count, index = len(self.cut_box(box)), index_box(box, self.tables.shape)
            has_more = has_more or count > int(self.tables.piece_counts[index])
            self.tables.piece_counts[index] = count
        return has_more

    def _exclude_faulty_boxes(self, boxes: list[Box]) -> bool:
        """Exclude boxes with a piece that cannot be glued well; return whether there was such a box."""
        owners = [box for box in boxes for _ in self.cut_box(box)]
        pieces = [piece for box in boxes for piece in self.cut_box(box)]
        faults = find_faults(pieces, self.problem.options.min_glue_mm2)
        for fault in faults:
            self._exclude_box(owners[fault.piece_number])
        self.rejections += [faults[0].reason] if faults else []
        return bool(faults)

    def _exclude_box(self, box: Box) -> None:
        """Exclude a box from the tables."""
        self.excess.exclude(box)

    def _compute_true_makespan_s(self, boxes: list[Box]) -> float:
        """Compute the true makespan of boxes in seconds, and raise prices in the table that are too low."""
        new_pieces = [
            (box, piece) for box in boxes if box not in self.true_times_s for piece in self.cut_box(box)
        ]
        poses = self.problem.find_poses([piece for _, piece in new_pieces])
        for (box, _), pose in zip(new_pieces, poses, strict=True):
            seconds = math.inf if pose is None else pose.price_s
            self.true_times_s[box] = max(self.true_times_s.get(box, 0.0), seconds)
        for box in dict.fromkeys(box for box, _ in new_pieces):
            self.excess.record(box, self.true_times_s[box])
        self._drop_pieces(boxes)
        return max(self.true_times_s[box] for box in boxes)

    def _make_no_fit_error(self) -> NoFit:
        """Build the error that explains why there is no partition for these printers."""
        problem, model = self.problem, self.problem.model
        if self.rejections:
            return NoFit(
                f"no partition was found whose parts can all be glued well; in the last of "
                f"{len(self.rejections)} that were tried, one part {self.rejections[-1]}: use more printers, "
                "a larger --longest-side, or (farm decompose) a lower --min-glue"
            )
        # The limit is finite, because inf means no fit.
        needed_printer_count = self.solver.solve(sys.float_info.max)
        if needed_printer_count >= UNREACHABLE_COUNT:
            min_mm = max(float(np.diff(planes).max()) for planes in self.grid.planes)
            return NoFit(
                f"a model of {format_size(model.extents_mm)} mm is cut into blocks of at least "
                f"{min_mm:.0f} mm, but the printers have room for "
                f"{format_size(problem.max_part_sides_mm)} mm (without clips and brim): printers with room "
                f"for {math.ceil(min_mm)} mm along each axis would be enough",
                is_too_large=True,
            )
        if needed_printer_count <= len(problem.printers):
            return NoFit(
                "in each partition that was tried, a part fits its printer in no pose: use more printers"
            )
        return NoFit.from_shortage(model.extents_mm, needed_printer_count, len(problem.printers))
