"""Moves of cut planes: groups of faces that move together, and the partitions that remain.

Two faces that touch each other move together. Where four boxes meet along an edge, or two diagonally
opposite boxes touch only there, one of the two planes through that edge must be continuous. So the faces of
that plane on both sides of the edge also move together. Otherwise a corner would belong to no box, or to two
boxes.
"""

from __future__ import annotations

import itertools

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.disjoint_sets import DisjointSets
from decompose.grid import SAME_PLANE_MM, FlatFaces, Grid, NeededCells, refine_cells
from decompose.options import Interior
from decompose.problem import Problem

# Maximum number of fine cells. The needed cells are refined only up to it, because finding them takes time
# and memory. It is just above the number for the largest grid of the search, so only other grids reach it.
MAX_NEEDED_CELLS = 2_000_000


def extend_boxes(boxes_mm: Floats) -> Floats:
    """Extend boxes over space that no box covers, so that more faces of neighbours touch each other.

    A face can only move into a neighbour that covers the whole face. Nothing has to be printed in the added
    space, because the boxes cover all needed cells.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) corners of disjoint boxes.

    Returns
    -------
    ndarray
        (n, 2, 3) corners in mm of disjoint boxes that contain the former ones.
    """
    boxes_mm = boxes_mm.copy()
    touching_boxes = [
        (int(i), int(j), axis)
        for axis in range(3)
        for i, j in np.argwhere(
            np.abs(boxes_mm[:, None, 1, axis] - boxes_mm[None, :, 0, axis]) < SAME_PLANE_MM
        )
    ]
    for _ in range(2):
        for i, j, axis in touching_boxes:
            other_axes = [a for a in range(3) if a != axis]
            low_mm, high_mm = (
                np.maximum(boxes_mm[i, 0], boxes_mm[j, 0])[other_axes],
                np.minimum(boxes_mm[i, 1], boxes_mm[j, 1])[other_axes],
            )
            if (high_mm - low_mm <= SAME_PLANE_MM).any():
                continue
            for box, neighbour in ((i, j), (j, i)):
                for side, other_axis in itertools.product((0, 1), other_axes):
                    _extend_face(boxes_mm, box, (side, other_axis), boxes_mm[neighbour, side, other_axis])
    return boxes_mm


def grow_boxes(boxes_mm: Floats, margin_mm: float) -> Floats:
    """Move each face of the boxes outward by a margin, unless another box is in the way.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) corners of disjoint boxes.
    margin_mm
        Length by which a face moves.

    Returns
    -------
    ndarray
        (n, 2, 3) corners in mm of disjoint boxes that contain the former ones.
    """
    grown_mm = boxes_mm.copy()
    for box, side, axis in np.ndindex(*boxes_mm.shape):
        limit_mm = float(boxes_mm[box, side, axis]) + (margin_mm if side else -margin_mm)
        _extend_face(grown_mm, box, (side, axis), limit_mm)
    return grown_mm


def _extend_face(boxes_mm: Floats, box: int, face: tuple[int, int], limit_mm: float) -> None:
    """Extend a face of a box outward to a coordinate, unless another box is in the way; changes the boxes."""
    extended_mm = boxes_mm[box].copy()
    extended_mm[face] = (max if face[0] else min)(extended_mm[face], limit_mm)
    if extended_mm[face] == boxes_mm[box][face]:
        return
    overlap_mm = np.minimum(extended_mm[1], boxes_mm[:, 1]) - np.maximum(extended_mm[0], boxes_mm[:, 0])
    is_overlapping = (overlap_mm > SAME_PLANE_MM).all(axis=1)
    is_overlapping[box] = False
    if not is_overlapping.any():
        boxes_mm[box] = extended_mm


def refine_needed_cells(problem: Problem, grid: Grid) -> NeededCells:
    """Refine the needed cells, up to the limit on their number.

    Parameters
    ----------
    problem
        Problem with the model.
    grid
        Grid over the model.
    """
    vertices, faces = problem.model.solid.arrays()
    keeps_interior = problem.options.interior is Interior.KEEP
    return refine_cells(grid, vertices[faces], problem.options.min_wall_mm, keeps_interior, MAX_NEEDED_CELLS)


def group_faces(boxes_mm: Floats) -> Ints:
    """Divide the faces of boxes into groups that have to move together.

    All faces of a group have the same axis and the same coordinate. A group is fixed if no two of its faces
    touch each other, because its move could not pass volume from one box to another.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) lower and upper corners.

    Returns
    -------
    ndarray
        (n, 2, 3) int64 number of the group of each face; -1 if the group is fixed.
    """
    count = len(boxes_mm)
    groups = DisjointSets(count * 6)
    low_mm, high_mm = boxes_mm[:, 0], boxes_mm[:, 1]
    overlap_mm = np.minimum(high_mm[:, None], high_mm[None]) - np.maximum(
        low_mm[:, None], low_mm[None]
    )  # (n, n, 3)
    is_shared = np.zeros(count * 6, dtype=np.bool_)
    for axis in range(3):
        other_axes = [i for i in range(3) if i != axis]
        is_touching = np.abs(high_mm[:, None, axis] - low_mm[None, :, axis]) < SAME_PLANE_MM
        for i, j in np.argwhere(is_touching & (overlap_mm[:, :, other_axes] > SAME_PLANE_MM).all(axis=2)):
            groups.join(_number_face(i, 1, axis), _number_face(j, 0, axis))
            is_shared[[_number_face(i, 1, axis), _number_face(j, 0, axis)]] = True
    for i, j, axes in _find_crossings(boxes_mm, overlap_mm):
        pairs = [
            (_find_facing_face(boxes_mm, i, j, axis), _find_facing_face(boxes_mm, j, i, axis))
            for axis in axes
        ]
        if all(groups.find(a) != groups.find(b) for a, b in pairs):
            groups.join(*min(pairs, key=lambda pair: groups.compute_joined_size(*pair)))
    labels = np.array([groups.find(face) for face in range(count * 6)])
    is_moving = np.isin(labels, labels[is_shared])
    _, numbers = np.unique(labels[is_moving], return_inverse=True)
    labels[:] = np.where(is_moving, 0, -1)
    labels[is_moving] = numbers.reshape(-1)
    return np.asarray(labels.reshape(count, 2, 3), dtype=np.int64)


def _find_crossings(boxes_mm: Floats, overlap_mm: Floats) -> list[tuple[int, int, tuple[int, int]]]:
    """Find pairs of boxes that meet only at an edge, and the two axes perpendicular to that edge.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) lower and upper corners.
    overlap_mm
        (n, n, 3) length in mm by which two boxes overlap along each axis.
    """
    is_touching = np.abs(overlap_mm) < SAME_PLANE_MM
    crossings = []
    for direction in range(3):
        a, b = (i for i in range(3) if i != direction)
        meets_at_edge = (
            is_touching[:, :, a] & is_touching[:, :, b] & (overlap_mm[:, :, direction] > SAME_PLANE_MM)
        )
        crossings += [(int(i), int(j), (a, b)) for i, j in np.argwhere(meets_at_edge) if i < j]
    return crossings


def _number_face(box: int, side: int, axis: int) -> int:
    """Compute the number of a face of a box; side 0 is the lower side."""
    return int(box * 6 + side * 3 + axis)


def _find_facing_face(boxes_mm: Floats, box: int, other_box: int, axis: int) -> int:
    """Find the face of a box that looks along an axis towards another box, as a number (`_number_face`)."""
    return _number_face(box, int(boxes_mm[box, 0, axis] < boxes_mm[other_box, 0, axis]), axis)


def move_groups(boxes_mm: Floats, groups: Ints, shifts_mm: Floats) -> Floats:
    """Move each group of faces of boxes along its axis.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) corners.
    groups
        (n, 2, 3) from `group_faces`.
    shifts_mm
        (groups,) shifts.

    Returns
    -------
    ndarray
        (n, 2, 3) corners in mm.
    """
    padded_shifts_mm = np.append(shifts_mm, 0.0)  # the last entry is for the fixed faces: group -1
    return np.asarray(boxes_mm + padded_shifts_mm[groups])


def find_free_directions(boxes_mm: Floats, groups: Ints, cells: NeededCells, step_mm: float) -> Bools:
    """Find the directions in which each group can move by a step while all other groups stay.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) corners.
    groups
        (n, 2, 3) from `group_faces`.
    cells
        Cells that have to remain covered.
    step_mm
        Length of the step.

    Returns
    -------
    ndarray
        (groups, 2) bool: whether the group can move down its axis, and up.
    """
    count = int(groups.max(initial=-1)) + 1
    is_free = np.zeros((count, 2), dtype=np.bool_)
    for group in range(count):
        for side, sign in enumerate((-1.0, 1.0)):
            shifts_mm = np.zeros(count)
            shifts_mm[group] = sign * step_mm
            is_free[group, side] = cells.is_partition(move_groups(boxes_mm, groups, shifts_mm))
    return is_free


def find_invalid_groups(
    groups: Ints, old_boxes_mm: Floats, new_boxes_mm: Floats, cells: NeededCells
) -> list[int]:
    """Find the groups whose moves break a partition.

    Parameters
    ----------
    groups
        (n, 2, 3) from `group_faces`.
    old_boxes_mm, new_boxes_mm
        (n, 2, 3) corners before and after the moves of all groups. The old boxes are a partition; the new
        ones are not.
    cells
        Cells that have to remain covered.

    Returns
    -------
    list of int
        Groups that break the partition if only they move. If there are none, those that break it after the
        groups with lower numbers have moved, except those that break it too.
    """
    moved_groups = np.unique(groups[old_boxes_mm != new_boxes_mm]).tolist()
    lone_groups = [
        group
        for group in moved_groups
        if not cells.is_partition(np.where(groups == group, new_boxes_mm, old_boxes_mm))
    ]
    if lone_groups:
        return lone_groups
    boxes_mm, invalid_groups = old_boxes_mm, []
    for group in moved_groups:
        moved_boxes_mm = np.where(groups == group, new_boxes_mm, boxes_mm)
        if cells.is_partition(moved_boxes_mm):
            boxes_mm = moved_boxes_mm
        else:
            invalid_groups.append(group)
    return invalid_groups


def find_clear_position_mm(flat_faces: FlatFaces, position_mm: float, target_mm: float) -> float:
    """Find the position of a plane that is clear of all flat faces and closest to the plane's target.

    Only positions between the current and the target position are considered. If none is clear, the current
    position is returned.

    Parameters
    ----------
    flat_faces
        Flat faces of the model along the axis.
    position_mm, target_mm
        Current and target position of the plane.
    """
    low_mm, high_mm = sorted((position_mm, target_mm))
    flats_mm, clearances_mm = flat_faces
    positions_mm = [target_mm, *(flats_mm - clearances_mm), *(flats_mm + clearances_mm)]
    for clear_mm in sorted(
        (p for p in positions_mm if low_mm <= p <= high_mm), key=lambda p: abs(p - target_mm)
    ):
        if flat_faces.measure_gaps_mm(clear_mm) >= -SAME_PLANE_MM:
            return float(clear_mm)
    return position_mm
