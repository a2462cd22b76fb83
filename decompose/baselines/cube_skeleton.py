"""The engine `cube-skeleton`: CSSS, a hollow model cut by the sides of a cube inside (Li et al. 2021).

The model is hollowed to the least wall; the planes of the largest cube in the hollow cut the shell into up
to 26 regions; small loose pieces of a region are joined to their smallest neighbours, and pieces are merged
while they fit. With the interior kept, the cube is printed too, with cubes from its faces outwards: the
skeleton.

`--faithful` merges pairs, once, by volume, whatever the number of printers. Otherwise regions larger than a
printer are cut on a grid, and neighbours that are printed soonest are merged until each piece has a printer.
Where nothing can be hollowed, the cube is the largest deep inside, and a piece of its own.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.baselines.hollow import Block, cubes_about, hollow, largest_cube
from decompose.baselines.rooms import (
    blocks_needed,
    clear_of_faces,
    connected,
    refuse_misfits,
)
from decompose.cost import pose_costs
from decompose.errors import NoFit
from decompose.grid import Cell, Grid, build_grid
from decompose.joints import joints
from decompose.piece import Piece, box_planes
from decompose.problem import Found, Problem
from decompose.report import Interior
from decompose.solid import Solid

Floats = npt.NDArray[np.float64]

CELLS = 24  # the cube root of the number of cells that the model is hollowed by
TOUCH_MM2 = 1.0  # pieces that share less are no neighbours


def search(problem: Problem) -> Found:
    """The pieces of CSSS.

    Raises
    ------
    NoFit
        There is no cube inside, a piece fits no printer, or the pieces are more than the printers.
    """
    model, options, faithful = problem.model, problem.options, problem.options.faithful
    vertices, faces = model.solid.arrays()
    cost = problem.cost
    settings = (options.min_wall_mm, False, cost.overhang_cos, cost.skin_cos)
    grid = build_grid(vertices[faces], CELLS, *settings)
    shell = hollow(model.solid, grid)
    hollowed = bool(shell.cavity.any())
    cube = largest_cube(shell.cavity if hollowed else grid.cells == Cell.INTERNAL)
    if cube is None and faithful:
        raise NoFit("there is no room for a cube inside the model: take --engine guillotine")
    problem.lap("hollow")
    skeleton: list[Piece] = []
    if cube is not None and hollowed and options.interior is Interior.KEEP:
        skeleton = _skeleton([cube, *cubes_about(cube, shell.cavity)], grid, problem)
    pieces = _regions(Piece(shell.solid, shell.planes, shell.boxes_mm), cube, grid)
    if not faithful:
        pieces = [part for piece in pieces for part in _fitting(piece, problem)]
    problem.lap("regions")
    merged = _merged(pieces, len(problem.printers) - len(skeleton), problem)
    problem.lap("merge")
    found = tuple(merged + skeleton)
    refuse_misfits("cube-skeleton", found, problem, would_do=len(found))
    return Found(found, model, np.eye(3))


def _skeleton(cubes: list[Block], grid: Grid, problem: Problem) -> list[Piece]:
    found = []
    for cube in cubes:
        box = np.array(grid.bounds_mm(cube))
        found += _fitting(Piece(Solid.box(*box), box_planes(box), box[None]), problem)
    return found


def _regions(whole: Piece, cube: Block | None, grid: Grid) -> list[Piece]:
    """What is between the planes of a cube's sides; each of it may be in several pieces."""
    parts = [whole]
    if cube is None:
        return parts
    for axis in range(3):
        for side in (axis, axis + 3):
            at_mm = float(grid.planes[axis][cube[side]])
            parts = [half for part in parts for half in _split(part, axis, at_mm)]
    return parts


def _split(piece: Piece, axis: int, at_mm: float) -> list[Piece]:
    planes = np.vstack([piece.planes, [*np.eye(3)[axis], at_mm]])
    sides = piece.solid.split(axis, at_mm)
    return [Piece(side, planes, piece.boxes_mm) for side in sides if side.volume_mm3 > 0.0]


def _fitting(piece: Piece, problem: Problem) -> list[Piece]:
    """A piece cut on a grid, if need be, into such as fit every printer."""
    lo, hi = piece.solid.bounds_mm
    counts = np.array(blocks_needed(hi - lo, problem.rooms))
    if counts.max() == 1:
        return [piece]
    axis = int(counts.argmax())
    share = (counts[axis] // 2) / counts[axis]
    at_mm = float(lo[axis] + share * (hi - lo)[axis])
    halves = _split(piece, axis, clear_of_faces(piece.solid, np.eye(3)[axis], at_mm))
    return [part for half in halves for part in _fitting(half, problem)] if len(halves) > 1 else [piece]


@dataclass(slots=True, eq=False)
class _Group:
    """Pieces that are to be one: their numbers, volume, seconds and bounds (2, 3) in mm."""

    members: list[int]
    volume_mm3: float
    seconds: float
    bounds_mm: Floats

    def with_other(self, other: _Group) -> _Group:
        lo = np.minimum(self.bounds_mm[0], other.bounds_mm[0])
        hi = np.maximum(self.bounds_mm[1], other.bounds_mm[1])
        members = self.members + other.members
        volume_mm3, seconds = self.volume_mm3 + other.volume_mm3, self.seconds + other.seconds
        return _Group(members, volume_mm3, seconds, np.array([lo, hi]))


class _Merging:
    """Groups of pieces by number, and which of them touch."""

    def __init__(self, pieces: list[Piece], problem: Problem) -> None:
        self.pieces = pieces
        self.problem = problem
        self.groups: dict[int, _Group] = {}
        for i, piece in enumerate(pieces):
            solid = piece.solid
            seconds = float(pose_costs(*solid.arrays(), problem.cost).min())
            self.groups[i] = _Group([i], solid.volume_mm3, seconds, solid.bounds_mm)
        self.touching: dict[int, set[int]] = defaultdict(set)
        for joint in joints(pieces):
            if joint.area_mm2 >= TOUCH_MM2:
                self.touching[joint.a].add(joint.b)
                self.touching[joint.b].add(joint.a)

    def fits(self, a: int, b: int) -> bool:
        lo, hi = self.groups[a].with_other(self.groups[b]).bounds_mm
        return max(blocks_needed(hi - lo, self.problem.rooms)) == 1

    def merge(self, a: int, b: int) -> None:
        """The second group becomes a part of the first."""
        self.groups[a] = self.groups[a].with_other(self.groups.pop(b))
        for other in self.touching.pop(b):
            self.touching[other].discard(b)
            if other != a:
                self.touching[other].add(a)
                self.touching[a].add(other)

    def smallest(self, numbers: set[int]) -> int | None:
        return min(numbers, key=lambda i: (self.groups[i].volume_mm3, i), default=None)

    def join_islands(self, islands: list[int]) -> None:
        """Each of these pieces, the smallest first, to its smallest neighbour with which it fits."""
        for island in sorted(islands, key=lambda i: self.groups[i].volume_mm3):
            neighbour = self.smallest({i for i in self.touching[island] if self.fits(i, island)})
            if neighbour is not None:
                self.merge(neighbour, island)

    def pair_once(self) -> None:
        """Each piece, the largest first, with its smallest neighbour that has no other, if both fit."""
        alone = set(self.groups)
        for number in sorted(self.groups, key=lambda i: (-self.groups[i].volume_mm3, i)):
            neighbour = self.smallest(self.touching[number] & alone)
            if number in alone and neighbour is not None and self.fits(number, neighbour):
                self.merge(number, neighbour)
                alone -= {number, neighbour}

    def merge_to(self, printers: int) -> None:
        """Neighbours that are printed soonest are merged, until there are no more groups than printers."""
        while len(self.groups) > printers:
            pairs = [(a, b) for a in self.groups for b in self.touching[a] if a < b and self.fits(a, b)]
            if not pairs:
                return
            self.merge(*min(pairs, key=lambda p: (self.groups[p[0]].seconds + self.groups[p[1]].seconds, p)))

    def merged(self) -> list[Piece]:
        found = []
        for group in self.groups.values():
            members = [self.pieces[i] for i in group.members]
            planes = np.unique(np.concatenate([piece.planes for piece in members]), axis=0)
            solid = members[0].solid if len(members) == 1 else Solid.union([p.solid for p in members])
            found += connected(Piece(solid, planes, members[0].boxes_mm))
        return found


def _merged(regions: list[Piece], printers: int, problem: Problem) -> list[Piece]:
    """The pieces of regions, islands joined to neighbours and neighbours merged."""
    pieces: list[Piece] = []
    islands: list[int] = []
    for region in regions:
        found = sorted(connected(region), key=lambda piece: -piece.solid.volume_mm3)
        islands += range(len(pieces) + 1, len(pieces) + len(found))
        pieces += found
    merging = _Merging(pieces, problem)
    merging.join_islands(islands)
    if problem.options.faithful:
        merging.pair_once()
    else:
        merging.merge_to(printers)
    return merging.merged()
