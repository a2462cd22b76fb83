"""Trimming of boxes on a grid to the needed cells in them, which are finer than the cells of the grid."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from decompose.arrays import Floats
from decompose.engines.guillotine.plane_shift.box_part import compute_slowest_piece_s
from decompose.engines.guillotine.plane_shift.plane_moves import find_clear_position_mm
from decompose.grid import FlatFaces, NeededCells, find_flat_faces
from decompose.pieces import SLIVER_MM, Piece, copy_printers, cut_box, find_faults
from decompose.problem import Problem, Work

# Distance up to which needed cells outside a box count as if they were in it. If the sides of the box move by
# less, the part need not grow along other axes, so its time does not jump.
MARGIN_MM = 3.0
SAME_BOUNDS_MM = 1e-6  # maximum difference between equal bounds of a solid


def trim_boxes(
    problem: Problem, cells: NeededCells, boxes_mm: Floats, pieces: Sequence[Sequence[Piece]]
) -> tuple[Floats, list[list[Piece]]]:
    """Trim boxes to their needed cells, and cut the parts in them again.

    Parameters
    ----------
    problem, cells
        Problem, and the cells that the boxes have to cover.
    boxes_mm, pieces
        (n, 2, 3) corners of the boxes, and the pieces in each of them.

    Returns
    -------
    tuple
        (n, 2, 3) corners of the trimmed boxes, and as many pieces in each of them; the same boxes and pieces
        if the slowest part would be slower, or if a part could not be glued well.
    """
    vertices, faces = problem.model.solid.arrays()
    flat_faces = [find_flat_faces(vertices[faces], axis) for axis in range(3)]
    old_pieces = [list(box_pieces) for box_pieces in pieces]
    new_boxes_mm, new_pieces = boxes_mm.copy(), list(old_pieces)
    trimmed_boxes_mm = [_trim_box(box_mm, cells, flat_faces) for box_mm in boxes_mm]
    numbers = [
        i
        for i, box_mm in enumerate(trimmed_boxes_mm)
        if any(_extends_beyond(piece, box_mm) for piece in old_pieces[i])
    ]
    problem.effort.record(Work.FACE_CUT, problem.model.solid.face_count * len(numbers))
    cut_pieces = problem.map(lambda i: cut_box(problem.model.solid, *trimmed_boxes_mm[i]), numbers)
    for i, trimmed_pieces in zip(numbers, cut_pieces, strict=True):
        if len(trimmed_pieces) == len(old_pieces[i]):
            new_boxes_mm[i] = trimmed_boxes_mm[i]
            new_pieces[i] = copy_printers(trimmed_pieces, old_pieces[i])
    all_old_pieces, all_new_pieces = list(chain(*old_pieces)), list(chain(*new_pieces))
    if not numbers or find_faults(all_new_pieces, problem.options.min_glue_mm2):
        return boxes_mm, old_pieces
    old_s, new_s = (
        compute_slowest_piece_s(all_pieces, problem.find_poses(all_pieces))
        for all_pieces in (all_old_pieces, all_new_pieces)
    )
    return (boxes_mm, old_pieces) if new_s > old_s else (new_boxes_mm, new_pieces)


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
