"""The engine `parallelobox`: blocks that grow from seeds on a grid, as in the paper.

The engine follows the sections of the paper: orientation and symmetry cut (`alignment`), then, for each half,
seeds, growth and filling of voids (`growth`), repeated in many attempts (`attempts`).

With `--faithful`, the result is the best attempt by the paper's prices. Otherwise more attempts are made:
from the same seeds with prices in seconds and with both interpretations of the score, on a finer grid, and
without the symmetry cut. On each grid, with the symmetry cut and without it, the best partition by the
paper's prices and the fastest one are cut. Of all these, the engine takes the one whose pieces have the
shortest makespan in their printing poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, product

import numpy as np

from decompose.arrays import Floats
from decompose.engines.parallelobox.alignment import AlignedModel, align_model
from decompose.engines.parallelobox.attempts import BlockPartition, SeedSource, draw_seed_sets, run_attempts
from decompose.engines.parallelobox.growth_tables import (
    OVERHANG_TOLERANCE_DEG,
    GrowthTables,
    make_paper_tables,
    make_time_tables,
)
from decompose.errors import NoFit
from decompose.grid import VOLUME, Box, BoxTables, Grid
from decompose.options import Options, ParalleloboxOptions, Score
from decompose.pieces import Piece, cut_cells, find_faults
from decompose.problem import Partition, Problem, Work

MAX_CUT_PARTITIONS = 12  # maximum number of partitions that are cut to count their pieces, the best first
# Maximum number of attempts on each half, the best first, that are combined with those on the other half.
MAX_HALF_ATTEMPTS = 100


def apply_paper_settings(options: Options) -> Options:
    """Set options to those of the table in the paper.

    The speeds and the overhang tolerance of the table are in `growth_tables`. The table does not define
    whether high or low scores are better; by default, high scores are better, as in the text of the paper.
    """
    interpretation = Score.HIGH if options.parallelobox.score is Score.BOTH else options.parallelobox.score
    return replace(
        options, granularity="vfine", parallelobox=ParalleloboxOptions(tries=3, score=interpretation)
    )


def cut_by_parallelobox(problem: Problem) -> Partition:
    """Cut a problem's model by the best attempt that has no more pieces than there are printers.

    Raises
    ------
    NoFit
        No attempt covers the model, or, without `--faithful`, each of the examined attempts has a part that
        cannot be glued well.
    """
    spaces = _build_search_spaces(problem)
    candidates: list[_Candidate] = []
    for space in spaces:
        if not candidates or not problem.effort.is_spent():
            candidates += _find_candidates(space, problem)
    problem.on_stage("search")
    if not candidates:
        raise NoFit(
            f"no attempt of parallelobox covers the model with {len(problem.printers)} parts that fit: "
            f"free more printers, or choose --engine guillotine, which finds a partition if there is one"
        )
    best = min(candidates, key=_Candidate.make_sort_key)
    if best.fault and not problem.options.faithful:
        raise NoFit(
            f"every attempt of parallelobox that was examined has a part that cannot be glued well; in "
            f"the best attempt, that part {best.fault}: free more printers, or choose --engine guillotine or "
            f"a lower --min-glue"
        )
    figures = problem.compute_grid_figures(
        best.space.grid, best.space.box_tables, list(best.pieces_by_box), best.pieces
    )
    problem.on_stage("bound")
    aligned_model = best.space.aligned_model
    return Partition(best.pieces, aligned_model.model, aligned_model.rotation, figures)


@dataclass(frozen=True, slots=True, eq=False)
class _SearchSpace:
    """Frame in which the model is cut, the grid in this frame, and the growth tables of the grid.

    Attributes
    ----------
    aligned_model
        Model in its frame.
    grid, box_tables
        Grid over the model, and the tables of its boxes.
    table_sets
        Growth tables with the paper's prices and, without `--faithful`, with times in seconds.
    pieces_by_box
        Pieces of each box that has been cut out.
    """

    aligned_model: AlignedModel
    grid: Grid
    box_tables: BoxTables
    table_sets: tuple[GrowthTables, ...]
    pieces_by_box: dict[Box, list[Piece]] = field(default_factory=dict)

    def cut_box(self, box: Box) -> list[Piece]:
        """Cut a box out of the model, unless it has been cut before."""
        if box not in self.pieces_by_box:
            self.pieces_by_box[box] = cut_cells(self.aligned_model.model.solid, self.grid, box)
        return self.pieces_by_box[box]


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """Cut partition, its makespan, and the reason why it cannot be glued well (empty if it can)."""

    space: _SearchSpace
    pieces_by_box: dict[Box, list[Piece]]
    makespan_s: float
    fault: str

    def make_sort_key(self) -> tuple[bool, float]:
        """Make the sort key; a lower one is better."""
        return bool(self.fault), self.makespan_s

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Pieces of all boxes."""
        return tuple(piece for box_pieces in self.pieces_by_box.values() for piece in box_pieces)


def _build_search_spaces(problem: Problem) -> list[_SearchSpace]:
    """Build the search spaces of the paper's grid and, without `--faithful`, of the problem's grid.

    If a granularity is given, only the problem's grid is used, except with `--faithful`.
    """
    options = problem.options
    overhang_cos = math.sin(math.radians(OVERHANG_TOLERANCE_DEG))  # as in the paper
    spaces = []
    if options.faithful or options.granularity == "auto":
        paper_problem = replace(problem, options=apply_paper_settings(options))
        aligned_model = align_model(problem.model, options.seed, overhang_cos)
        grid = paper_problem.build_grid(aligned_model.model, aligned_model.mirror)
        tables = problem.price_boxes(grid)
        paper_tables = make_paper_tables(
            paper_problem.build_grid(aligned_model.model, aligned_model.mirror, overhang_cos), tables
        )
        table_sets = (paper_tables,) if options.faithful else (paper_tables, make_time_tables(grid, tables))
        spaces.append(_SearchSpace(aligned_model, grid, tables, table_sets))
    if not options.faithful:
        aligned_model = align_model(problem.model, options.seed, problem.cost.overhang_cos)
        grid = problem.build_grid(aligned_model.model, aligned_model.mirror)
        if not any(_is_same_space(aligned_model, grid, space) for space in spaces):
            tables = problem.price_boxes(grid)
            table_sets = (make_paper_tables(grid, tables), make_time_tables(grid, tables))
            spaces.append(_SearchSpace(aligned_model, grid, tables, table_sets))
    problem.on_stage("boxes")
    return spaces


def _is_same_space(aligned_model: AlignedModel, grid: Grid, space: _SearchSpace) -> bool:
    """Check whether a space has the same frame and as many cells."""
    return (aligned_model.rotation == space.aligned_model.rotation).all() and grid.shape == space.grid.shape


def _find_candidates(space: _SearchSpace, problem: Problem) -> list[_Candidate]:
    """Find the best partitions in a space: the paper's choice and, without `--faithful`, the fastest one."""
    points = np.unique(space.aligned_model.model.solid.arrays()[0], axis=0)
    candidates: list[_Candidate] = []
    for halves in _list_halves(space, points, len(problem.printers)):
        attempts_by_half = [_grow_half(half, space, problem) for half in halves]
        interpretation = problem.options.parallelobox.score if problem.options.faithful else Score.HIGH
        paper_attempts = [grown_half.get((0, interpretation), []) for grown_half in attempts_by_half]
        candidates += _find_first_candidate(
            _rank_partitions(paper_attempts, lambda a: a.max_price), space, problem
        )
        if problem.options.faithful:
            if candidates:
                break
            continue
        attempts = [
            [attempt for group in grown_half.values() for attempt in group] for grown_half in attempts_by_half
        ]
        candidates += _find_fastest_candidate(
            _rank_partitions(attempts, lambda a: space.box_tables.find_longest_time_s(a.blocks)),
            space,
            problem,
        )
    return candidates


# Growth tables of a half, points to cluster for its seeds, and number of printers.
Half = tuple[tuple[GrowthTables, ...], Floats, int]
# Attempts on a half, by the number of the table set and the interpretation of the score.
GrownHalf = dict[tuple[int, Score], list[BlockPartition]]
# Prices of partitions (the paper's P, or times in s) in ascending order, and the boxes of each partition.
RankedPartitions = list[tuple[float, list[Box]]]


def _list_halves(space: _SearchSpace, points: Floats, printer_count: int) -> Iterator[list[Half]]:
    """Yield the halves of a symmetric model, then the uncut model.

    If the number of printers is odd, the larger half gets the extra one.
    """
    if space.aligned_model.mirror is not None and printer_count > 1:
        axis, at_mm = space.aligned_model.mirror
        for plane in np.flatnonzero(space.grid.planes[axis][1:-1] == at_mm)[:1] + 1:
            sides = [
                tuple(t.restrict_to_half(axis, int(plane), upper) for t in space.table_sets)
                for upper in (False, True)
            ]
            volumes_mm3 = [float(space.grid.sums[side[0].is_needed][:, VOLUME].sum()) for side in sides]
            extra_printer_count = printer_count % 2
            printer_counts = [
                printer_count // 2 + extra_printer_count * (volumes_mm3[0] >= volumes_mm3[1]),
                printer_count // 2 + extra_printer_count * (volumes_mm3[0] < volumes_mm3[1]),
            ]
            is_on_side = [points[:, axis] < at_mm, points[:, axis] >= at_mm]
            yield [
                (side, points[mask], count)
                for side, mask, count in zip(sides, is_on_side, printer_counts, strict=True)
            ]
    yield [(space.table_sets, points, printer_count)]


def _grow_half(half: Half, space: _SearchSpace, problem: Problem) -> GrownHalf:
    """Grow blocks in one half, from the same seeds for all tables; empty if the budget is too small."""
    table_sets, points, printer_count = half
    options = problem.options
    clustered_count = len(points) * options.parallelobox.tries * printer_count * (printer_count + 1) // 2
    if not problem.effort.can_afford(Work.POINT_CLUSTERED, clustered_count):
        return {}
    run = map if problem.executor is None else problem.executor.map
    source = SeedSource(points, space.grid, table_sets[0].is_excluded)
    seed_sets = draw_seed_sets(source, printer_count, options.parallelobox.tries, options.seed, run)
    problem.effort.record(Work.POINT_CLUSTERED, clustered_count)
    attempt_count = len(seed_sets) * len(table_sets) * len(options.parallelobox.score.interpretations)
    problem.effort.record(Work.CELL_GROWN, attempt_count * space.grid.is_needed.size)
    return {
        (number, interpretation): run_attempts(seed_sets, tables, printer_count, interpretation, run)
        for number, tables in enumerate(table_sets)
        for interpretation in options.parallelobox.score.interpretations
    }


def _rank_partitions(
    groups: Sequence[Sequence[BlockPartition]], key: Callable[[BlockPartition], float]
) -> RankedPartitions:
    """Combine the attempts on the halves into partitions, the best first."""
    best = [sorted((key(a), a.part_count, a.blocks) for a in half)[:MAX_HALF_ATTEMPTS] for half in groups]
    combined_partitions = [
        (max(max_price for max_price, _, _ in picks), sum(parts for _, parts, _ in picks), picks)
        for picks in product(*best)
    ]
    combined_partitions.sort(key=lambda ranked: ranked[:2])
    return [
        (max_price, [box for *_, blocks in picks for box in blocks])
        for max_price, _, picks in combined_partitions
    ]


def _find_first_candidate(
    ranked_partitions: RankedPartitions, space: _SearchSpace, problem: Problem
) -> list[_Candidate]:
    """Find the first partition with no more pieces than there are printers; empty if there is none."""
    candidates = (
        _cut_candidate(boxes, space, problem) for _, boxes in ranked_partitions[:MAX_CUT_PARTITIONS]
    )
    return list(islice((candidate for candidate in candidates if candidate is not None), 1))


def _find_fastest_candidate(
    ranked_partitions: RankedPartitions, space: _SearchSpace, problem: Problem
) -> list[_Candidate]:
    """Find the partition with the shortest makespan; empty if there is none.

    The search stops when no other partition can be faster.
    """
    best: list[_Candidate] = []
    for expected_s, boxes in ranked_partitions[:MAX_CUT_PARTITIONS]:
        is_optimal = best and not best[0].fault and expected_s >= best[0].makespan_s
        if is_optimal or (best and problem.effort.is_spent()):
            break
        candidate = _cut_candidate(boxes, space, problem)
        if candidate is not None and candidate.makespan_s < math.inf:
            best = sorted([*best, candidate], key=_Candidate.make_sort_key)[:1]
    return best


def _cut_candidate(boxes: list[Box], space: _SearchSpace, problem: Problem) -> _Candidate | None:
    """Cut a partition, and find the poses of its pieces; None if there are more pieces than printers."""
    new_box_count = sum(box not in space.pieces_by_box for box in boxes)
    problem.effort.record(Work.FACE_CUT, new_box_count * space.aligned_model.model.solid.face_count)
    pieces_by_box = {box: space.cut_box(box) for box in boxes}
    pieces = [piece for box_pieces in pieces_by_box.values() for piece in box_pieces]
    if len(pieces) > len(problem.printers):
        return None
    makespan_s = max(math.inf if pose is None else pose.price_s for pose in problem.find_poses(pieces))
    faults = find_faults(pieces, problem.options.min_glue_mm2)
    return _Candidate(space, pieces_by_box, makespan_s, faults[0].reason if faults else "")
