"""Loops of the walls in a toolpath, and the hidden sides along which they lie.

For notches and grooves of a side, see `glued_parts.sides`; `checks.walls` calls the same loops rings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from slicing.checks import Toolpath
from slicing.checks.section import Floats
from slicing.glued_parts.sides import (
    CLOSURE_TOLERANCE_MM,
    MAX_NOTCH_LENGTH_MM,
    Bools,
    HiddenSide,
    Indices,
    find_notch_moves,
    list_side_runs,
)


@dataclass(frozen=True, slots=True)
class Loop:
    """Successive moves (k,) of a wall in one layer: a closed loop or a part of one."""

    moves: Indices
    is_closed: bool


def list_loops(path: Toolpath, wall_moves: Indices, points_mm: tuple[Floats, Floats]) -> list[Loop]:
    """Divide the moves (k,) of a wall into loops.

    A closed loop begins at its longest move, because CuraEngine may begin it in a notch of a hidden side.
    """
    starts_mm, ends_mm = points_mm
    is_first = (np.diff(wall_moves) != 1) | (np.diff(path.layer[wall_moves]) != 0)
    loops = []
    for moves in np.split(wall_moves, np.flatnonzero(is_first) + 1):
        is_closed = bool(np.hypot(*(ends_mm[moves[-1]] - starts_mm[moves[0]])) < CLOSURE_TOLERANCE_MM)
        if is_closed:
            longest = int(np.argmax(np.hypot(*(ends_mm[moves] - starts_mm[moves]).T)))
            moves = np.roll(moves, -longest)
        loops.append(Loop(moves, is_closed))
    return loops


def join_loops(loops: Sequence[Loop]) -> tuple[Indices, Indices]:
    """Concatenate the moves (k,) of loops, and number them (k,) with a gap after each loop."""
    counts = [len(loop.moves) for loop in loops]
    moves = np.concatenate([loop.moves for loop in loops])
    return moves, np.arange(len(moves)) + np.repeat(np.arange(len(loops)), counts)


def find_sides(
    loops: Sequence[Loop],
    points_mm: tuple[Floats, Floats],
    sides: Sequence[HiddenSide],
    wall_depth_mm: float,
) -> npt.NDArray[np.int_]:
    """Find the number of the hidden side along which each move (n,) lies; -1 for none.

    Parameters
    ----------
    loops
        Loops of a wall.
    points_mm
        (n, 2) bed-centred starts and ends of all moves of the toolpath.
    sides
        Hidden sides of the part.
    wall_depth_mm
        Depth of the wall along a side without notches.
    """
    moves, numbers = join_loops(loops)
    end_points_mm = points_mm[0][moves], points_mm[1][moves]
    side_numbers = np.full(len(points_mm[0]), -1)
    is_near = np.zeros((len(sides), len(points_mm[0])), np.bool_)
    for number, side in enumerate(sides):
        is_near[number, moves] = find_notch_moves(end_points_mm, side, wall_depth_mm)
        for run in list_side_runs(numbers, end_points_mm, side, wall_depth_mm):
            side_numbers[moves[run]] = number
    lengths_mm = np.hypot(*(points_mm[1] - points_mm[0]).T)
    for loop in loops:
        _assign_notched_corners(loop, side_numbers, is_near, lengths_mm)
    return side_numbers


def _assign_notched_corners(
    loop: Loop, side_numbers: npt.NDArray[np.int_], is_near: Bools, lengths_mm: Floats
) -> None:
    """Assign the moves of a notch at the corner of two hidden sides to the first of them.

    Parameters
    ----------
    loop
        Loop with moves on hidden sides.
    side_numbers
        (n,) number of the side of each move, -1 for none; changed in place.
    is_near
        (sides, n) moves along each side and in its notches.
    lengths_mm
        (n,) lengths of the moves.
    """
    moves = loop.moves
    if loop.is_closed:
        moves = np.roll(moves, -int(np.argmax(side_numbers[moves] >= 0)))
        moves = np.append(moves, moves[0])
    on_side = np.flatnonzero(side_numbers[moves] >= 0)
    for before, after in pairwise(on_side.tolist()):
        corner = moves[before + 1 : after]
        pair = side_numbers[moves[[before, after]]]
        if (
            len(corner)
            and lengths_mm[corner].sum() < MAX_NOTCH_LENGTH_MM
            and is_near[pair][:, corner].any(axis=0).all()
        ):
            side_numbers[corner] = pair[0]


def list_loop_runs(loop: Loop, is_hidden: Bools) -> Iterator[Indices]:
    """Yield runs of successive hidden moves of a loop; a run of a closed loop may pass its start."""
    order = np.arange(len(is_hidden))
    if loop.is_closed and not is_hidden.all():
        order = np.roll(order, -int(np.argmin(is_hidden)))
    changes = np.flatnonzero(np.diff(is_hidden[order].astype(np.int8), prepend=0, append=0))
    for begin, end in changes.reshape(-1, 2):
        yield loop.moves[order[begin:end]]
