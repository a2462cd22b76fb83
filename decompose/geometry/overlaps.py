"""Surfaces that overlap themselves, made one solid.

Where two limbs of one surface run through each other, their common volume counts twice. Upright rays find
such places. The surface is cut there, so that the limbs are separate pieces, and the pieces are united.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from decompose.arrays import Floats
from decompose.errors import ModelNotSolid
from decompose.geometry.rays import Rays, compute_unit_normals, find_bounds, find_crossings
from decompose.geometry.solid import Solid

RAYS = 40_000  # approximate number over the area of a solid seen from above
MARGIN_STEPS = 2.0  # between rays, about the place that they show
ROUNDING_SHARE = 1e-7  # of the height: solid that counts twice along less than this is rounding
HALVINGS = 4  # of a piece in which the limbs are still connected
LEFT_SHARE = 0.1  # of an overlap that may remain once its limbs are united: more is a fold, which is kept
MAX_PLACES = 64  # the largest ones
MAX_ROUNDS = 4  # each cuts the whole surface: a million faces take seconds
LOST_SHARE = 0.1  # of the overlaps: the volume may also change by this, plus 0.001 of the solid


@dataclass(frozen=True, slots=True)
class Overlaps:
    """Places where a solid counts more than once.

    Attributes
    ----------
    volume_mm3
        Volume of the solid that counts too often, by the rays that meet it.
    boxes_mm
        (k, 2, 3) corners of a box around each place, the largest overlap first.
    """

    volume_mm3: float
    boxes_mm: Floats


def find_overlaps(solid: Solid) -> Overlaps:
    """Find the places where a closed surface overlaps itself, by upright rays.

    Parameters
    ----------
    solid
        Solid whose surface may run through itself.

    Returns
    -------
    Overlaps
        The places, none of them where no ray meets an overlap.
    """
    vertices, faces = solid.arrays()
    triangles = np.ascontiguousarray(vertices[faces])
    lo, hi = find_bounds(triangles)
    width, depth, height = (hi - lo).tolist()
    step_mm = max(math.sqrt(width * depth / RAYS), max(width, depth) / RAYS)  # a sliver has few rays too
    shape = math.ceil(width / step_mm), math.ceil(depth / step_mm)
    # Off the middle by an irregular share: a ray through an edge of the mesh could count twice.
    origin_mm = lo[:2] + step_mm * (0.5 + np.array([0.0123, 0.0271]))
    normals = compute_unit_normals(triangles)
    crossings = find_crossings(triangles, normals, Rays(origin_mm, step_mm, shape))
    ray = np.repeat(np.arange(len(crossings.start) - 1), np.diff(crossings.start))
    counts = np.concatenate([[0], np.cumsum(np.where(normals[crossings.face, 2] < 0.0, 1, -1))])
    inside_of = counts[1:] - counts[crossings.start[ray]]
    is_whole = (counts[crossings.start[1:]] == counts[crossings.start[:-1]])[ray]  # else it met a sliver
    length_mm = np.append(np.diff(crossings.z_mm), 0.0)
    is_twice = is_whole & (inside_of > 1) & (length_mm > ROUNDING_SHARE * height)
    excess_mm = ((inside_of - 1) * length_mm)[is_twice]
    low_mm = np.full(shape[0] * shape[1], np.inf)
    high_mm = np.full(shape[0] * shape[1], -np.inf)
    np.minimum.at(low_mm, ray[is_twice], crossings.z_mm[is_twice])
    np.maximum.at(high_mm, ray[is_twice], (crossings.z_mm + length_mm)[is_twice])
    places = label(np.isfinite(low_mm).reshape(shape), structure=np.ones((3, 3)))[0]
    boxes = np.zeros((places.max(initial=0), 2, 3))
    sizes_mm = np.zeros(len(boxes))
    for number in range(len(boxes)):
        columns = np.flatnonzero(places.ravel() == number + 1)
        rays_mm = origin_mm + step_mm * np.stack(np.divmod(columns, shape[1]), axis=1)
        boxes[number, 0] = [*rays_mm.min(axis=0), low_mm[columns].min()]
        boxes[number, 1] = [*rays_mm.max(axis=0), high_mm[columns].max()]
        sizes_mm[number] = (high_mm - low_mm)[columns].sum()
    boxes += MARGIN_STEPS * step_mm * np.array([[-1.0], [1.0]])
    return Overlaps(float(excess_mm.sum()) * step_mm**2, boxes[np.argsort(-sizes_mm, kind="stable")])


def resolve_overlaps(solid: Solid) -> tuple[Solid, float]:
    """Unite the limbs of a solid that run through each other.

    Parameters
    ----------
    solid
        Solid whose surface may overlap itself.

    Returns
    -------
    tuple
        The solid that counts once where limbs overlapped, and the volume in mm3 that had counted more than
        once; the same solid and 0 if nothing overlaps, if all overlaps are folds of one limb, or if more
        than the overlaps would be lost.
    """
    before = find_overlaps(solid)
    united, remaining = solid, list(before.boxes_mm[:MAX_PLACES])
    try:
        for _ in range(MAX_ROUNDS):
            chosen_numbers = _choose_apart(remaining)
            united = _unite_places(united, [remaining[i] for i in chosen_numbers])
            remaining = [box_mm for i, box_mm in enumerate(remaining) if i not in chosen_numbers]
        if united is solid:
            return solid, 0.0
        resolved_mm3 = before.volume_mm3 - find_overlaps(united).volume_mm3
        is_same = resolved_mm3 > 0.0 and _is_same_but_for(resolved_mm3, solid, united)
    except ModelNotSolid:  # an operation failed: the solid is what it was without it
        is_same = False
    return (united, resolved_mm3) if is_same else (solid, 0.0)


def _is_same_but_for(resolved_mm3: float, solid: Solid, united: Solid) -> bool:
    """Check that uniting has lost no body, no volume besides, and none of the size."""
    besides_mm3 = abs(solid.volume_mm3 - united.volume_mm3 - resolved_mm3)
    return (
        besides_mm3 <= LOST_SHARE * resolved_mm3 + 1e-3 * solid.volume_mm3
        and np.allclose(united.bounds_mm, solid.bounds_mm)
        and len(united.pieces()) <= len(solid.pieces())
    )


def _choose_apart(boxes_mm: list[Floats]) -> list[int]:
    """Choose boxes (2, 3) of which none touches another, the first ones first."""
    numbers: list[int] = []
    for i, box in enumerate(boxes_mm):
        if all(((box[0] > boxes_mm[k][1]) | (box[1] < boxes_mm[k][0])).any() for k in numbers):
            numbers.append(i)
    return numbers


def _unite_places(solid: Solid, boxes_mm: list[Floats]) -> Solid:
    """Unite the limbs in boxes that do not touch; the same solid if all hold folds of one limb."""
    results = [(box_mm, _unite_limbs(solid.clip(*box_mm))) for box_mm in boxes_mm]
    found = [(box_mm, united) for box_mm, united in results if united is not None]
    if not found:
        return solid
    rest = solid.subtract(Solid.union([Solid.box(*box_mm) for box_mm, _ in found]))
    return Solid.union([rest, *(united for _, united in found)])


def _unite_limbs(inner: Solid) -> Solid | None:
    """Unite the limbs in a box around an overlap; None if it is a fold of one limb."""
    limbs = [limb for piece in inner.pieces() for limb in _split_limbs(piece, HALVINGS)]
    if len(limbs) < 2:
        return None
    united = Solid.union(limbs)
    is_fold = find_overlaps(united).volume_mm3 > LEFT_SHARE * find_overlaps(inner).volume_mm3
    return None if is_fold else united


def _split_limbs(piece: Solid, halvings: int) -> list[Solid]:
    """Halve a piece that overlaps itself repeatedly until its limbs are separate pieces."""
    boxes_mm = find_overlaps(piece).boxes_mm
    if not len(boxes_mm) or not halvings:
        return [piece]
    lo, hi = boxes_mm[:, 0].min(axis=0), boxes_mm[:, 1].max(axis=0)
    axis = int(np.argmax(hi - lo))
    halves = piece.split(axis, float(lo[axis] + hi[axis]) / 2.0)
    return [limb for half in halves for part in half.pieces() for limb in _split_limbs(part, halvings - 1)]
