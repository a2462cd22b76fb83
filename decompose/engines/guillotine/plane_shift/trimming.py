"""Trimming of boxes on a grid to the needed cells in them, which are finer than the cells of the grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats
from decompose.engines.guillotine.plane_shift.plane_moves import find_clear_position_mm
from decompose.grid import FlatFaces, NeededCells, find_flat_faces
from decompose.pieces import SLIVER_MM, Piece, cut_box, find_faults
from decompose.problem import Problem, Work

# Distance up to which needed cells outside a box count as if they were in it. If the sides of the box move by
# less, the part need not grow along other axes, so its time does not jump.
MARGIN_MM = 3.0
SAME_BOUNDS_MM = 1e-6  # maximum difference between equal bounds of a solid


def trim_boxes(problem: Problem, cells: NeededCells, pieces: Sequence[Sequence[Piece]]) -> list[list[Piece]]:
    """Trim boxes to their needed cells, and cut the parts in them again.

    Parameters
    ----------
    problem, cells
        Problem, and the cells that the boxes have to cover.
    pieces
        Pieces in each box.

    Returns
    -------
    list of list of Piece
        As many pieces in each trimmed box; the same pieces if the slowest part would be slower, or if a part
        could not be glued well.
    """
    vertices, faces = problem.model.solid.arrays()
    flat_faces = [find_flat_faces(vertices[faces], axis) for axis in range(3)]
    new_pieces = [list(box_pieces) for box_pieces in pieces]
    numbers, boxes_mm = [], []
    for i, box_pieces in enumerate(pieces):
        box_mm = _trim_box(box_pieces[0].boxes_mm[0], cells, flat_faces)
        if any(_extends_beyond(piece, box_mm) for piece in box_pieces):
            numbers.append(i)
            boxes_mm.append(box_mm)
    problem.effort.record(Work.FACE_CUT, problem.model.solid.face_count * len(numbers))
    for i, trimmed_pieces in zip(
        numbers, problem.map(lambda box_mm: cut_box(problem.model.solid, *box_mm), boxes_mm), strict=True
    ):
        if len(trimmed_pieces) == len(pieces[i]):
            new_pieces[i] = [
                replace(trimmed_piece, printer=piece.printer, time_ratio=piece.time_ratio)
                for trimmed_piece, piece in zip(trimmed_pieces, pieces[i], strict=True)
            ]
    all_pieces = [piece for box_pieces in new_pieces for piece in box_pieces]
    if not numbers or find_faults(all_pieces, problem.options.min_glue_mm2):
        return [list(box_pieces) for box_pieces in pieces]
    old_s = _find_longest_time_s(problem, [piece for box_pieces in pieces for piece in box_pieces])
    is_slower = _find_longest_time_s(problem, all_pieces) > old_s
    return [list(box_pieces) for box_pieces in pieces] if is_slower else new_pieces


def _trim_box(box_mm: Floats, cells: NeededCells, flat_faces: Sequence[FlatFaces]) -> Floats:
    """Trim a box (2, 3) in mm to the needed cells in it.

    Sides stay clear of flat faces, and a box of which only a sliver would remain along an axis stays as long
    as it is.
    """
    trimmed_mm = cells.find_needed_bounds_mm(box_mm, MARGIN_MM)
    for side, axis in np.argwhere(trimmed_mm != box_mm).tolist():
        trimmed_mm[side, axis] = find_clear_position_mm(
            flat_faces[axis], box_mm[side, axis], trimmed_mm[side, axis]
        )
    return np.where(trimmed_mm[1] - trimmed_mm[0] < SLIVER_MM, box_mm, trimmed_mm)


def _extends_beyond(piece: Piece, box_mm: Floats) -> bool:
    """Check whether the solid of a piece extends beyond a box (2, 3) in mm."""
    low_mm, high_mm = piece.solid.bounds_mm
    return bool((low_mm < box_mm[0] - SAME_BOUNDS_MM).any() or (high_mm > box_mm[1] + SAME_BOUNDS_MM).any())


def _find_longest_time_s(problem: Problem, pieces: Sequence[Piece]) -> float:
    """Find the time of the slowest piece in its best pose, in seconds; inf if a piece has no pose."""
    poses = zip(pieces, problem.find_poses(pieces), strict=True)
    return max(math.inf if pose is None else pose.price_s * piece.time_factor for piece, pose in poses)
