"""The engine `symmetry`: symmetry-based decomposition (SBD) by recursive cuts (Hatton et al. 2023).

First a tree of cuts with a depth of three is built, and its leaves are chosen so that the highest price of a
part is as low as possible. Then one part after another is cut further as long as printers remain.

With `--faithful`, the engine follows the authors' program: planes come from one sample of random normals, the
price of a part is its volume, the least symmetric part is cut first, cuts with too small a half are refused,
and build volumes are ignored. Otherwise planes are refined and used only if the part is nearly symmetric
about them, the price of a part is its print time, the costliest part is cut first, and parts that do not fit
a build volume are cut.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.errors import NoFit
from decompose.geometry import Mirror, Solid, find_good_mirrors, sample_mirrors
from decompose.pieces import Piece
from decompose.print_time import price_axis_poses_s
from decompose.problem import Partition, Problem
from decompose.problem.fitting import (
    count_blocks,
    count_parts,
    find_clear_offset_mm,
    refuse_misfits,
    split_connected_pieces,
)

TREE_DEPTH = 3  # depth of the tree of cuts
MAX_DRAWN_PLANES = 5  # maximum number of random planes that are tried for a part
MAX_REFINED_PLANES = 3  # maximum number of refined planes of a part
REFINEMENT_SAMPLES = 25  # number of normals in a round of the refinement
# Minimum volume of a half in the authors' program, as a share of the mean volume of the parts.
MIN_HALF_SHARE = 1.0 / 1.5
# Offsets of a plane from the boundary between two blocks, as shares of the length of a block. Blocks are the
# equal lengths, at least two, into which a side of a part is divided so that each fits every printer.
OFFSET_SHARES: Floats = np.array([0.0, 0.05, -0.05, 0.1, -0.1, 0.15, -0.15, 0.2, -0.2, 0.3, -0.3])
# Minimum volume of a part, as a share of the mean volume of the parts or of the volume of the piece being
# cut, whichever is smaller.
MIN_VOLUME_SHARE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Piece, its price (volume in mm3, or time in s), and the minimum number of printers that it needs."""

    piece: Piece
    price: float
    needed_printer_count: int = 1


Leaves = tuple[float, tuple[_Part, ...]]  # the highest price among parts, and the parts
NO_LEAVES: Leaves = (math.inf, ())


class _Method(ABC):
    """Base class of the published and the corrected method, with the steps in which they differ."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.rng = np.random.default_rng(problem.options.seed)
        self.mean_mm3 = problem.model.solid.volume_mm3 / len(problem.printers)

    @abstractmethod
    def price_part(self, piece: Piece) -> _Part:
        """Price a piece as a part."""

    @abstractmethod
    def list_cuts(self, part: _Part) -> Iterator[list[_Part]]:
        """Yield the parts that each plane cuts a part into, the best plane first."""

    @abstractmethod
    def cut_parts_further(self, parts: list[_Part]) -> list[_Part]:
        """Cut parts further as long as printers remain."""

    def price_model(self) -> _Part:
        """Price the whole model as a part."""
        return self.price_part(Piece(self.problem.model.solid, np.zeros((0, 4)), np.zeros((0, 2, 3))))


def cut_by_symmetry(problem: Problem) -> Partition:
    """Cut a problem's model by symmetry-based decomposition.

    Raises
    ------
    NoFit
        A part does not fit the printers, or the parts consist of more pieces than there are printers.
    """
    method = _PublishedMethod(problem) if problem.options.faithful else _CorrectedMethod(problem)
    printer_count = len(problem.printers)
    uncut_part = method.price_model()
    if uncut_part.needed_printer_count > printer_count:
        raise NoFit(
            f"the model needs at least {uncut_part.needed_printer_count} parts to fit the build volumes, but "
            f"there are only {printer_count} printers",
            uncut_part.needed_printer_count,
        )
    parts = list(_find_best_leaves(method, uncut_part, printer_count, TREE_DEPTH)[printer_count][1])
    problem.on_stage("tree")
    parts = method.cut_parts_further(parts)
    problem.on_stage("greedy")
    pieces = tuple(piece for part in parts for piece in split_connected_pieces(part.piece))
    # With more printers, the engine would make more parts, so no number is known to be enough.
    refuse_misfits("symmetry", pieces, problem, sufficient_printer_count=None)
    return Partition(pieces, problem.model, np.eye(3))


def _find_best_leaves(method: _Method, part: _Part, printer_count: int, depth: int) -> list[Leaves]:
    """Find the leaves of the tree of cuts with the lowest maximum price, for 0, 1, ... printers."""
    best_leaves = [
        NO_LEAVES if k < part.needed_printer_count else (part.price, (part,))
        for k in range(printer_count + 1)
    ]
    if depth == 0 or printer_count < 2:
        return best_leaves
    for children in method.list_cuts(part):
        combinations: list[Leaves] = [(0.0, ())] * (printer_count + 1)
        for child in children:
            child_leaves = _find_best_leaves(method, child, printer_count, depth - 1)
            combinations = [_join_leaves(combinations, child_leaves, k) for k in range(printer_count + 1)]
        best_leaves = [
            min(a, b, key=lambda leaves: (leaves[0], len(leaves[1])))
            for a, b in zip(best_leaves, combinations, strict=True)
        ]
    return best_leaves


def _join_leaves(first_leaves: list[Leaves], second_leaves: list[Leaves], printer_count: int) -> Leaves:
    """Join the leaves of both sides of a cut into the best leaves for a number of printers."""
    shares = [(first_leaves[k], second_leaves[printer_count - k]) for k in range(printer_count + 1)]
    a, b = min(shares, key=lambda pair: (max(pair[0][0], pair[1][0]), len(pair[0][1]) + len(pair[1][1])))
    return (max(a[0], b[0]), a[1] + b[1]) if max(a[0], b[0]) < math.inf else NO_LEAVES


def _split_piece(piece: Piece, normal: Floats, at_mm: float) -> list[Piece]:
    """Split a piece at a plane; return the sides that are not empty, connected or not."""
    planes = np.vstack([piece.planes, [*normal, at_mm]])
    sides = piece.solid.split_by_plane(normal, at_mm)
    return [Piece(side, planes, piece.boxes_mm) for side in sides if not side.is_empty]


def _sum_needed_printers(parts: list[_Part]) -> int:
    """Sum the minimum number of printers of some parts."""
    return sum(part.needed_printer_count for part in parts)


class _PublishedMethod(_Method):
    """The method of the authors' program, including its errors."""

    def price_part(self, piece: Piece) -> _Part:
        """Price a piece by its volume."""
        return _Part(piece, piece.solid.volume_mm3)

    def draw_planes(self, part: _Part, max_count: int) -> list[Mirror]:
        """Draw random planes through a part, and return the most symmetric ones."""
        return sample_mirrors(part.piece.solid.arrays()[0], self.rng, max_count)

    def list_cuts(self, part: _Part) -> Iterator[list[_Part]]:
        """Yield the halves of cuts at random planes, the most symmetric first, unless a half is too small."""
        for mirror in self.draw_planes(part, MAX_DRAWN_PLANES):
            halves = self.cut_in_half(part, mirror)
            if halves:
                yield halves

    def cut_in_half(self, part: _Part, mirror: Mirror) -> list[_Part]:
        """Cut a part into two halves, connected or not; empty if one of them is too small."""
        halves = [
            self.price_part(piece) for piece in _split_piece(part.piece, mirror.normal, mirror.offset_mm)
        ]
        are_large = len(halves) == 2 and all(half.price >= MIN_HALF_SHARE * self.mean_mm3 for half in halves)
        return halves if are_large else []

    def cut_parts_further(self, parts: list[_Part]) -> list[_Part]:
        """Cut the parts in half, the least symmetric part first, as long as printers remain."""
        has_cut = True
        while has_cut and len(parts) < len(self.problem.printers):
            has_cut = False
            planes = [(self.draw_planes(part, 1)[0], part) for part in parts]
            for mirror, part in sorted(planes, key=lambda pair: -pair[0].error_mm):
                if len(parts) == len(self.problem.printers):
                    break
                halves = self.cut_in_half(part, mirror)
                if halves:
                    parts = [p for p in parts if p is not part] + halves
                    has_cut = True
        return parts


class _CorrectedMethod(_Method):
    """The method as the authors intended it, in which all parts fit the printers."""

    def price_part(self, piece: Piece) -> _Part:
        """Price a piece by its print time, divided by the number of printers that it needs."""
        needed_printer_count = count_parts(piece.solid, self.problem.distinct_printers)
        seconds = float(price_axis_poses_s(*piece.solid.arrays(), self.problem.cost).min())
        return _Part(piece, seconds / needed_printer_count, needed_printer_count)

    def list_cuts(self, part: _Part) -> Iterator[list[_Part]]:
        """Yield the parts of each cut: at planes of symmetry, then at a plane across the longest side."""
        solid = part.piece.solid
        vertices = solid.arrays()[0]
        for mirror in find_good_mirrors(vertices, self.rng, MAX_REFINED_PLANES, REFINEMENT_SAMPLES):
            yield from self.split_at_plane(part.piece, mirror.normal, mirror.offset_mm)
        normal, positions_mm = self.find_planes_across_longest_side(solid)
        part_count, best_children = max(2, part.needed_printer_count), None
        for at_mm in positions_mm:
            for children in self.split_at_plane(part.piece, normal, at_mm):
                if best_children is None or _sum_needed_printers(children) < _sum_needed_printers(
                    best_children
                ):
                    best_children = children
            if best_children is not None and _sum_needed_printers(best_children) <= part_count:
                break
        if best_children is not None:
            yield best_children

    def split_at_plane(self, piece: Piece, normal: Floats, at_mm: float) -> Iterator[list[_Part]]:
        """Yield the connected pieces on both sides of a plane near `at_mm`, unless a piece is too small."""
        at_mm = find_clear_offset_mm(piece.solid, normal, at_mm)
        pieces = [p for half in _split_piece(piece, normal, at_mm) for p in split_connected_pieces(half)]
        min_mm3 = MIN_VOLUME_SHARE * min(self.mean_mm3, piece.solid.volume_mm3)
        if len(pieces) > 1 and all(fragment.solid.volume_mm3 >= min_mm3 for fragment in pieces):
            yield [self.price_part(fragment) for fragment in pieces]

    def find_planes_across_longest_side(self, solid: Solid) -> tuple[Floats, list[float]]:
        """Find planes across the longest side, or across the side that exceeds the build volume most.

        The first plane is at a boundary between blocks: the equal lengths into which the side is divided so
        that each fits every printer. If the whole side fits, the plane is in the middle. The other planes
        lie near the first one.

        Returns
        -------
        tuple
            Normal (3,) of the planes, and their positions along it in mm.
        """
        low_mm, high_mm = solid.bounds_mm
        counts = count_blocks(high_mm - low_mm, self.problem.distinct_printers)
        axis = int(np.lexsort((high_mm - low_mm, counts))[-1])
        shares = (
            (counts[axis] // 2 + OFFSET_SHARES) / counts[axis]
            if counts[axis] > 1
            else (1.0 + OFFSET_SHARES) / 2.0
        )
        return np.eye(3)[axis], (low_mm[axis] + shares * (high_mm - low_mm)[axis]).tolist()

    def cut_parts_further(self, parts: list[_Part]) -> list[_Part]:
        """Cut the costliest part as long as printers remain and its pieces are cheaper.

        A part that is too large for one printer is cut first, whatever its price.
        """
        while True:
            costliest_part = max(parts, key=lambda part: (part.needed_printer_count > 1, part.price))
            other_parts = [part for part in parts if part is not costliest_part]
            free_printer_count = len(self.problem.printers) - _sum_needed_printers(other_parts)
            for children in self.list_cuts(costliest_part):
                is_costlier = (
                    costliest_part.needed_printer_count == 1
                    and max(child.price for child in children) >= costliest_part.price
                )
                if _sum_needed_printers(children) <= free_printer_count and not is_costlier:
                    parts = other_parts + children
                    break
            else:
                return parts
