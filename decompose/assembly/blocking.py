"""Blocking of parts by other parts, for each direction in which a part could be moved away.

This is the directional blocking graph of Wilson and Latombe ("Geometric reasoning about mechanical assembly",
Artificial Intelligence 71, 1994): part i blocks part j along d if j, moved along d, would overlap i.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.assembly.shadow import MAX_TOUCH_OVERLAP_MM, cast_shadow
from decompose.geometry import Solid
from decompose.pieces import CutSolid, Joint

# Maximum sine of the angle between two directions along the same axis, and maximum cosine of that between two
# perpendicular directions.
SAME_AXIS_SIN = 1e-4
MAX_AXES = 9  # maximum number of normals that are used as axes


def find_axes(pieces: Sequence[CutSolid], joints: Sequence[Joint]) -> Floats:
    """List the axes along which parts may be separated: the normals of the joints, then those of other cuts.

    The first three axes are orthogonal: the normal of the largest face of a joint, and two axes that complete
    it to a frame. Of the other normals of joints, those of larger faces come first.

    Parameters
    ----------
    pieces
        Parts, cut at planes.
    joints
        Joints of the parts, in the same frame.

    Returns
    -------
    ndarray
        (k, 3) unit vectors.
    """
    faces = sorted((face for joint in joints for face in joint.faces), key=lambda face: -face.area_mm2)
    axes: list[Floats] = []
    normals = [face.normal for face in faces] + [plane[:3] for piece in pieces for plane in piece.planes]
    for normal in normals:
        if len(axes) < MAX_AXES and _is_new_axis(normal, axes):
            axes.append(normal)
    first = axes[0] if axes else np.array([0.0, 0.0, 1.0])
    frame_axes = [first, *_complete_frame(first, axes)]
    return np.array([*frame_axes, *(axis for axis in axes if _is_new_axis(axis, frame_axes))])


def find_blocking(solids: Sequence[Solid], axes: Floats) -> Bools:
    """Find the pairs of parts in which one part blocks the other.

    Parameters
    ----------
    solids
        Parts in one frame; n is their number.
    axes
        (k, 3) unit vectors.

    Returns
    -------
    Bools
        (2 k, n, n) bool: ``[d, i, j]`` is true if part i blocks part j along ``[axes, -axes][d]``. The
        bounding boxes of two parts, aligned with the axis, decide this unless they overlap. If they overlap,
        the shadows of the parts are compared (`shadow.Shadow`).
    """
    count = len(solids)
    blocking = np.zeros((2 * len(axes), count, count), dtype=np.bool_)
    corners = [solid.arrays()[0] for solid in solids]
    for k, axis in enumerate(axes):
        frame = make_frame(axis, axes)
        rotated_mm = [points_mm @ frame.T for points_mm in corners]
        lo_mm = np.array([points_mm.min(axis=0) for points_mm in rotated_mm])
        hi_mm = np.array([points_mm.max(axis=0) for points_mm in rotated_mm])
        overlap_mm = _compute_overlap_mm(lo_mm[:, 1:], hi_mm[:, 1:])
        overlaps_across = (overlap_mm > MAX_TOUCH_OVERLAP_MM).all(axis=2) & ~np.eye(count, dtype=np.bool_)
        # [i, j] is true if the whole of part i lies beyond part j along the axis.
        is_beyond = lo_mm[:, None, 0] >= hi_mm[None, :, 0] - MAX_TOUCH_OVERLAP_MM
        blocking[k] = overlaps_across & is_beyond
        blocking[k + len(axes)] = overlaps_across & is_beyond.T
        needs_shadows = overlaps_across & ~is_beyond & ~is_beyond.T
        shadows = {
            i: cast_shadow(solids[i], frame) for i in np.flatnonzero(needs_shadows.any(axis=0)).tolist()
        }
        for i, j in np.argwhere(needs_shadows).tolist():
            blocking[[k, k + len(axes)], i, j] = shadows[i].blocks(shadows[j])
    return blocking


def make_frame(axis: Floats, axes: Sequence[Floats] | Floats = ()) -> Floats:
    """Make a frame (3, 3) of unit vectors as rows: an axis, and two vectors perpendicular to it.

    The second row is one of `axes` if one of them is perpendicular to the axis.

    Parameters
    ----------
    axis
        (3,) unit vector.
    axes
        (k, 3) unit vectors.
    """
    return np.stack([axis, *_complete_frame(axis, axes)])


def _compute_overlap_mm(lo_mm: Floats, hi_mm: Floats) -> Floats:
    """Compute the overlap (n, n, k) in mm of every pair of boxes with corners (n, k) in mm."""
    overlap_mm: Floats = np.minimum(hi_mm[:, None], hi_mm[None]) - np.maximum(lo_mm[:, None], lo_mm[None])
    return overlap_mm


def _complete_frame(axis: Floats, axes: Sequence[Floats] | Floats) -> tuple[Floats, Floats]:
    """Choose two unit vectors (3,) perpendicular to an axis and to each other.

    The first one is the direction of one of `axes` if possible.
    """
    across = next((other for other in axes if abs(float(other @ axis)) < SAME_AXIS_SIN), None)
    if across is None:
        across = np.cross(np.eye(3)[int(np.abs(axis).argmin())], axis)
    second = across / np.linalg.norm(across)
    return second, np.cross(axis, second)


def _is_new_axis(axis: Floats, known_axes: Sequence[Floats]) -> bool:
    """Check whether an axis differs from all known axes."""
    return all(float(np.linalg.norm(np.cross(axis, other))) > SAME_AXIS_SIN for other in known_axes)
