"""Repair of a surface that intersects itself: its branches are united into one solid.

Branches are regions of one connected solid, such as two limbs of a figure, that pass through each other.
Their common volume counts twice. Vertical rays find the places of overlap. The solid is cut there, so that
the branches become separate pieces, and the pieces are united.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from decompose.arrays import Floats
from decompose.errors import ModelNotSolid
from decompose.geometry.rays import compute_unit_normals, find_bounds, find_crossings, place_rays
from decompose.geometry.solid import Solid

RAY_COUNT = 40_000  # approximate number of rays over the area of a solid seen from above
MARGIN_STEPS = 2.0  # margin around the rays that meet an overlap, as a multiple of the distance between rays
ROUNDING_SHARE = 1e-7  # overlaps lower than this share of the solid's height are rounding errors
MAX_HALVINGS = 4  # maximum number of times that a piece is halved to separate its branches
# Maximum share of an overlap that remains after its branches are united; if more remains, the overlap is a
# fold of one branch, which is kept.
MAX_REMAINING_SHARE = 0.1
MAX_PLACES = 64  # maximum number of places that are repaired, the largest first
# Maximum number of rounds; each cuts the whole surface, which takes seconds for a million faces.
MAX_ROUNDS = 4
# Maximum loss of volume besides the overlaps: this share of the overlaps plus 0.001 of the solid. If more is
# lost, the solid is not changed.
MAX_LOST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Overlaps:
    """Places where the volume of a solid counts more than once.

    Attributes
    ----------
    volume_mm3
        Volume that is counted in excess, estimated from the rays that meet overlaps.
    boxes_mm
        (k, 2, 3) corners of a box around each place, the largest overlap first.
    """

    volume_mm3: float
    boxes_mm: Floats


def find_overlaps(solid: Solid) -> Overlaps:
    """Find the places where a closed surface overlaps itself, by vertical rays.

    Parameters
    ----------
    solid
        Solid whose surface may intersect itself.

    Returns
    -------
    Overlaps
        Places where rays meet overlaps; there may be smaller overlaps between the rays.
    """
    vertices, faces = solid.arrays()
    triangles = np.ascontiguousarray(vertices[faces])
    lo_mm, hi_mm = find_bounds(triangles)
    width_mm, depth_mm, height_mm = (hi_mm - lo_mm).tolist()
    step_mm = max(
        math.sqrt(width_mm * depth_mm / RAY_COUNT), max(width_mm, depth_mm) / RAY_COUNT
    )  # the second term limits the number of rays over a narrow solid
    rays, normals = place_rays(lo_mm, hi_mm, step_mm), compute_unit_normals(triangles)
    origin_mm, _, shape = rays
    crossings = find_crossings(triangles, normals, rays)
    ray = np.repeat(np.arange(len(crossings.start) - 1), np.diff(crossings.start))
    counts = np.concatenate([[0], np.cumsum(np.where(normals[crossings.face, 2] < 0.0, 1, -1))])
    winding = counts[1:] - counts[crossings.start[ray]]
    # A ray that does not leave the solid as often as it enters it has met a sliver.
    is_whole = (counts[crossings.start[1:]] == counts[crossings.start[:-1]])[ray]
    length_mm = np.append(np.diff(crossings.z_mm), 0.0)
    is_overlap = is_whole & (winding > 1) & (length_mm > ROUNDING_SHARE * height_mm)
    excess_mm = ((winding - 1) * length_mm)[is_overlap]
    low_mm = np.full(shape[0] * shape[1], np.inf)
    high_mm = np.full(shape[0] * shape[1], -np.inf)
    np.minimum.at(low_mm, ray[is_overlap], crossings.z_mm[is_overlap])
    np.maximum.at(high_mm, ray[is_overlap], (crossings.z_mm + length_mm)[is_overlap])
    places = label(np.isfinite(low_mm).reshape(shape), structure=np.ones((3, 3)))[0]
    boxes_mm = np.zeros((places.max(initial=0), 2, 3))
    sizes_mm = np.zeros(len(boxes_mm))
    for number in range(len(boxes_mm)):
        columns = np.flatnonzero(places.ravel() == number + 1)
        rays_mm = origin_mm + step_mm * np.stack(np.divmod(columns, shape[1]), axis=1)
        boxes_mm[number, 0] = [*rays_mm.min(axis=0), low_mm[columns].min()]
        boxes_mm[number, 1] = [*rays_mm.max(axis=0), high_mm[columns].max()]
        sizes_mm[number] = (high_mm - low_mm)[columns].sum()
    boxes_mm += MARGIN_STEPS * step_mm * np.array([[-1.0], [1.0]])
    return Overlaps(float(excess_mm.sum()) * step_mm**2, boxes_mm[np.argsort(-sizes_mm, kind="stable")])


def resolve_overlaps(solid: Solid) -> tuple[Solid, float]:
    """Unite the branches of a solid that intersect each other.

    Parameters
    ----------
    solid
        Solid whose surface may overlap itself.

    Returns
    -------
    tuple
        Solid in which overlaps count once, and the volume in mm3 that was counted in excess before. The
        result is the unchanged solid and 0 if nothing overlaps, if all overlaps are folds of one branch, or
        if more volume than that of the overlaps would be lost.
    """
    overlaps_before = find_overlaps(solid)
    united_solid, remaining_boxes = solid, list(overlaps_before.boxes_mm[:MAX_PLACES])
    try:
        for _ in range(MAX_ROUNDS):
            chosen_numbers = _choose_separate_boxes(remaining_boxes)
            united_solid = _unite_branches_in_boxes(
                united_solid, [remaining_boxes[i] for i in chosen_numbers]
            )
            remaining_boxes = [box_mm for i, box_mm in enumerate(remaining_boxes) if i not in chosen_numbers]
        if united_solid is solid:
            return solid, 0.0
        resolved_mm3 = overlaps_before.volume_mm3 - find_overlaps(united_solid).volume_mm3
        is_resolved = resolved_mm3 > 0.0 and _has_lost_only_overlaps(resolved_mm3, solid, united_solid)
    except ModelNotSolid:  # an operation failed, so the solid is returned unchanged
        is_resolved = False
    return (united_solid, resolved_mm3) if is_resolved else (solid, 0.0)


def _has_lost_only_overlaps(resolved_mm3: float, solid: Solid, united_solid: Solid) -> bool:
    """Check whether a union kept its bounds, has no more pieces, and lost no volume but the overlaps."""
    unexplained_mm3 = abs(solid.volume_mm3 - united_solid.volume_mm3 - resolved_mm3)
    return (
        unexplained_mm3 <= MAX_LOST_SHARE * resolved_mm3 + 1e-3 * solid.volume_mm3
        and np.allclose(united_solid.bounds_mm, solid.bounds_mm)
        and len(united_solid.list_pieces()) <= len(solid.list_pieces())
    )


def _choose_separate_boxes(boxes_mm: list[Floats]) -> list[int]:
    """Choose boxes (2, 3) that do not touch each other; earlier boxes take precedence."""
    numbers: list[int] = []
    for i, box in enumerate(boxes_mm):
        if all(((box[0] > boxes_mm[k][1]) | (box[1] < boxes_mm[k][0])).any() for k in numbers):
            numbers.append(i)
    return numbers


def _unite_branches_in_boxes(solid: Solid, boxes_mm: list[Floats]) -> Solid:
    """Unite the branches in boxes that do not touch; return the same solid if all overlaps are folds."""
    results = [(box_mm, _unite_branches(solid.clip(*box_mm))) for box_mm in boxes_mm]
    united_boxes = [(box_mm, united_solid) for box_mm, united_solid in results if united_solid is not None]
    if not united_boxes:
        return solid
    other_solid = solid.subtract(Solid.union([Solid.box(*box_mm) for box_mm, _ in united_boxes]))
    return Solid.union([other_solid, *(united_solid for _, united_solid in united_boxes)])


def _unite_branches(solid_in_box: Solid) -> Solid | None:
    """Unite the branches in a box around an overlap; None if the overlap is a fold of one branch."""
    branches = [
        branch for piece in solid_in_box.list_pieces() for branch in _split_branches(piece, MAX_HALVINGS)
    ]
    if len(branches) < 2:
        return None
    united_solid = Solid.union(branches)
    is_fold = (
        find_overlaps(united_solid).volume_mm3 > MAX_REMAINING_SHARE * find_overlaps(solid_in_box).volume_mm3
    )
    return None if is_fold else united_solid


def _split_branches(piece: Solid, max_halvings: int) -> list[Solid]:
    """Repeatedly halve a piece that overlaps itself until its branches are separate pieces."""
    boxes_mm = find_overlaps(piece).boxes_mm
    if not len(boxes_mm) or not max_halvings:
        return [piece]
    lo_mm, hi_mm = boxes_mm[:, 0].min(axis=0), boxes_mm[:, 1].max(axis=0)
    axis = int(np.argmax(hi_mm - lo_mm))
    halves = piece.split(axis, float(lo_mm[axis] + hi_mm[axis]) / 2.0)
    return [
        branch
        for half in halves
        for part in half.list_pieces()
        for branch in _split_branches(part, max_halvings - 1)
    ]
