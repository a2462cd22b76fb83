"""The engine `cube-skeleton`: a hollowed model cut by the sides of a cube in its cavity (Li et al. 2021).

The model is hollowed until a wall of the minimum thickness remains. The planes of the largest cube in its
cavity cut this shell into up to 26 regions. If a region consists of several pieces, all but the largest one
are islands, and each island is joined to its smallest neighbour. Then neighbouring pieces are merged while
they fit the printers. If the interior is kept, the skeleton is printed too: the cube, and further cubes on
its faces.

With `--faithful`, the cube consists of whole cells, and each piece is merged at most once, in order of
volume, whatever the number of printers. Otherwise the engine also tries a cube that is refined against the
mesh, and uses the one whose pieces have the shorter makespan. Regions that are too large for a printer are
cut on a grid, and the neighbours that print fastest are merged until there is a printer for each piece. If
nothing can be hollowed, the largest cube deep inside the model is a separate piece.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.engines.baselines.hollow import (
    Shell,
    find_largest_cube,
    hollow_model,
    list_cubes_around,
    move_planes_to_cube,
    refine_cube,
)
from decompose.errors import NoFit
from decompose.geometry import Solid, round_triangles
from decompose.grid import Box, Cell, Grid, GridRules, build_grid, fill_grid
from decompose.options import Interior
from decompose.pieces import Piece, find_joints, list_box_planes
from decompose.print_time import price_axis_poses_s
from decompose.problem import Partition, Problem
from decompose.problem.fitting import (
    count_blocks,
    find_clear_offset_mm,
    refuse_misfits,
    split_connected_pieces,
)

GRANULARITY = 24  # granularity of the grid on which the model is hollowed
MIN_JOINT_MM2 = 1.0  # minimum area of the joint between neighbours


def cut_by_cube_skeleton(problem: Problem) -> Partition:
    """Cut a problem's model by the planes of a cube in its cavity.

    Raises
    ------
    NoFit
        A piece does not fit the printers, or there are more pieces than printers; with `--faithful` also if
        there is no room for a cube inside the model.
    """
    model, options, faithful = problem.model, problem.options, problem.options.faithful
    vertices, faces = model.solid.arrays()
    cost = problem.cost
    rules = GridRules(options.min_wall_mm, False, cost.overhang_cos, cost.skin_cos)
    grid = build_grid(vertices[faces], GRANULARITY, rules)
    shell = hollow_model(model.solid, grid)
    is_hollow = bool(shell.cavity.any())
    cube = find_largest_cube(shell.cavity if is_hollow else grid.cells == Cell.INTERNAL)
    if cube is None and faithful:
        raise NoFit("there is no room for a cube inside the model: choose --engine guillotine")
    problem.on_stage("hollow")
    best_pieces = _cut_shell(problem, grid, shell, cube)
    if cube is not None and is_hollow and not faithful:
        cell_mm = max(float(np.diff(planes).max()) for planes in grid.planes)
        cube_mm = refine_cube(model.solid, np.array(grid.find_bounds_mm(cube)), cell_mm, options.min_wall_mm)
        planes, cube = move_planes_to_cube(model.solid, grid, cube_mm)
        grid = fill_grid(vertices[faces], planes, rules)
        refined_pieces = _cut_shell(problem, grid, hollow_model(model.solid, grid, cube), cube)
        best_pieces = min(
            refined_pieces,
            best_pieces,
            key=lambda pieces: (len(pieces) > len(problem.printers), problem.compute_makespan_s(pieces)),
        )
    problem.on_stage("cut")
    refuse_misfits("cube-skeleton", best_pieces, problem, sufficient_printer_count=len(best_pieces))
    return Partition(best_pieces, model, np.eye(3))


def _cut_shell(problem: Problem, grid: Grid, shell: Shell, cube: Box | None) -> tuple[Piece, ...]:
    """Cut a shell by the sides of a cube, merge the pieces, and add the pieces of the skeleton."""
    skeleton: list[Piece] = []
    if cube is not None and shell.cavity.any() and problem.options.interior is Interior.KEEP:
        skeleton = _cut_skeleton([cube, *list_cubes_around(cube, shell.cavity)], grid, problem)
    pieces = _split_regions(Piece(shell.solid, shell.planes, shell.boxes_mm), cube, grid)
    if not problem.options.faithful:
        pieces = [part for piece in pieces for part in _cut_to_fit(piece, problem)]
    return (*_merge_regions(pieces, len(problem.printers) - len(skeleton), problem), *skeleton)


def _cut_skeleton(cubes: list[Box], grid: Grid, problem: Problem) -> list[Piece]:
    """Cut the cubes of the skeleton into pieces that fit the printers."""
    pieces = []
    for cube in cubes:
        box = np.array(grid.find_bounds_mm(cube))
        pieces += _cut_to_fit(Piece(Solid.box(*box), list_box_planes(box), box[None]), problem)
    return pieces


def _split_regions(piece: Piece, cube: Box | None, grid: Grid) -> list[Piece]:
    """Split a piece by the planes of a cube's sides; a region may consist of several pieces."""
    parts = [piece]
    if cube is None:
        return parts
    for axis in range(3):
        for side in (axis, axis + 3):
            at_mm = float(grid.planes[axis][cube[side]])
            parts = [half for part in parts for half in _split_piece(part, axis, at_mm)]
    return parts


def _split_piece(piece: Piece, axis: int, at_mm: float) -> list[Piece]:
    """Split a piece at a plane perpendicular to an axis; return the sides that are not empty."""
    planes = np.vstack([piece.planes, [*np.eye(3)[axis], at_mm]])
    sides = piece.solid.split(axis, at_mm)
    return [Piece(side, planes, piece.boxes_mm) for side in sides if side.volume_mm3 > 0.0]


def _cut_to_fit(piece: Piece, problem: Problem) -> list[Piece]:
    """Cut a piece on a grid until every block fits every printer."""
    low_mm, high_mm = piece.solid.bounds_mm
    counts = np.array(count_blocks(high_mm - low_mm, problem.distinct_printers))
    if counts.max() == 1:
        return [piece]
    axis = int(counts.argmax())
    share = (counts[axis] // 2) / counts[axis]
    at_mm = float(low_mm[axis] + share * (high_mm - low_mm)[axis])
    halves = _split_piece(piece, axis, find_clear_offset_mm(piece.solid, np.eye(3)[axis], at_mm))
    return [part for half in halves for part in _cut_to_fit(half, problem)] if len(halves) > 1 else [piece]


@dataclass(slots=True, eq=False)
class _Group:
    """Group of merged pieces: their numbers, their common solid, and the sum of their prices in seconds."""

    members: list[int]
    solid: Solid
    seconds: float

    @property
    def volume_mm3(self) -> float:
        """Volume of the pieces together."""
        return self.solid.volume_mm3

    def measure_common_size_mm(self, other: _Group) -> Floats:
        """Measure the size (3,) of the bounding box of both groups."""
        bounds_mm = np.array([self.solid.bounds_mm, other.solid.bounds_mm])
        return np.asarray(bounds_mm[:, 1].max(axis=0) - bounds_mm[:, 0].min(axis=0))


class _PieceMerger:
    """Merger of neighbouring pieces into groups, which it keeps by number."""

    def __init__(self, pieces: list[Piece], problem: Problem) -> None:
        self.pieces = pieces
        self.problem = problem
        self.groups: dict[int, _Group] = {}
        for i, piece in enumerate(pieces):
            seconds = float(price_axis_poses_s(*piece.solid.arrays(), problem.cost).min())
            self.groups[i] = _Group([i], piece.solid, seconds)
        self.touching_groups: dict[int, set[int]] = defaultdict(set)
        for joint in find_joints(pieces):
            if joint.area_mm2 >= MIN_JOINT_MM2:
                self.touching_groups[joint.a].add(joint.b)
                self.touching_groups[joint.b].add(joint.a)

    def can_merge(self, a: int, b: int) -> bool:
        """Check whether two groups together fit every printer."""
        size_mm = self.groups[a].measure_common_size_mm(self.groups[b])
        return max(count_blocks(size_mm, self.problem.distinct_printers)) == 1

    def merge_groups(self, a: int, b: int) -> bool:
        """Merge the second group into the first, and return whether that was possible.

        A merge is impossible if rounding leaves a gap at the cut between the groups. It is also impossible if
        they touch along an edge outside their common face, because an STL file of both would not be closed.
        """
        first, second = self.groups[a], self.groups[b]
        solid = Solid.union([first.solid, second.solid])
        if len(solid.list_pieces()) > 1 or round_triangles(*solid.arrays()) is None:
            self.touching_groups[a].discard(b)
            self.touching_groups[b].discard(a)
            return False
        self.groups[a] = _Group(first.members + second.members, solid, first.seconds + second.seconds)
        del self.groups[b]
        for neighbour in self.touching_groups.pop(b):
            self.touching_groups[neighbour].discard(b)
            if neighbour != a:
                self.touching_groups[neighbour].add(a)
                self.touching_groups[a].add(neighbour)
        return True

    def find_smallest_group(self, numbers: set[int]) -> int | None:
        """Find the group with the smallest volume among these numbers; None if there are no numbers."""
        return min(numbers, key=lambda i: (self.groups[i].volume_mm3, i), default=None)

    def join_islands(self, islands: list[int]) -> None:
        """Join each island, the smallest first, to the smallest neighbour with which it can be merged."""
        for island in sorted(islands, key=lambda i: self.groups[i].volume_mm3):
            is_finished = False
            while not is_finished:
                neighbour = self.find_smallest_group(
                    {i for i in self.touching_groups[island] if self.can_merge(i, island)}
                )
                is_finished = neighbour is None or self.merge_groups(neighbour, island)

    def pair_neighbours(self) -> None:
        """Merge each piece, the largest first, with its smallest unpaired neighbour if both together fit."""
        unpaired = set(self.groups)
        for number in sorted(self.groups, key=lambda i: (-self.groups[i].volume_mm3, i)):
            neighbour = self.find_smallest_group(self.touching_groups[number] & unpaired)
            if number not in unpaired or neighbour is None or not self.can_merge(number, neighbour):
                continue
            if self.merge_groups(number, neighbour):
                unpaired -= {number, neighbour}

    def merge_to_count(self, printer_count: int) -> None:
        """Merge the neighbours that print fastest until there is a printer for each group.

        If too many groups remain, these merges are undone, and the neighbours with the smallest common
        bounding box are merged instead.
        """
        groups, neighbours = dict(self.groups), {i: set(others) for i, others in self.touching_groups.items()}
        self._merge_cheapest_neighbours(printer_count, lambda a, b: a.seconds + b.seconds)
        if len(self.groups) > printer_count:
            self.groups, self.touching_groups = groups, defaultdict(set, neighbours)
            self._merge_cheapest_neighbours(
                printer_count, lambda a, b: float(a.measure_common_size_mm(b).prod())
            )

    def _merge_cheapest_neighbours(
        self, printer_count: int, compute_key: Callable[[_Group, _Group], float]
    ) -> None:
        """Merge the neighbours with the lowest key until there is a printer for each group."""
        while len(self.groups) > printer_count:
            pairs = [
                (a, b) for a in self.groups for b in self.touching_groups[a] if a < b and self.can_merge(a, b)
            ]
            if not pairs:
                return
            self.merge_groups(
                *min(pairs, key=lambda pair: (compute_key(*(self.groups[i] for i in pair)), pair))
            )

    def list_merged_pieces(self) -> list[Piece]:
        """List the pieces of all groups, split where they are not connected."""
        pieces = []
        for group in self.groups.values():
            members = [self.pieces[i] for i in group.members]
            planes = np.unique(np.concatenate([piece.planes for piece in members]), axis=0)
            pieces += split_connected_pieces(Piece(group.solid, planes, members[0].boxes_mm))
        return pieces


def _merge_regions(regions: list[Piece], printer_count: int, problem: Problem) -> list[Piece]:
    """Split regions into connected pieces, join islands to neighbours, and merge neighbours."""
    pieces: list[Piece] = []
    islands: list[int] = []
    for region in regions:
        parts = sorted(split_connected_pieces(region), key=lambda piece: -piece.solid.volume_mm3)
        islands += range(len(pieces) + 1, len(pieces) + len(parts))
        pieces += parts
    merger = _PieceMerger(pieces, problem)
    merger.join_islands(islands)
    if problem.options.faithful:
        merger.pair_neighbours()
    else:
        merger.merge_to_count(printer_count)
    return merger.list_merged_pieces()
