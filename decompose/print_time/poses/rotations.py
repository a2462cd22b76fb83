"""Rotations of a part in which it may be printed: candidates for its orientation.

In the candidates, an axis of the model's frame points up, or the part lies on a facet of its convex hull or
on a large flat face.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from decompose.arrays import Floats, Ints
from decompose.build_volumes import fits_all, list_build_volumes
from decompose.geometry import find_convex_outline, find_smallest_rectangle_angle_rad, measure_rectangles
from decompose.jit import jit
from decompose.print_time.pose_prices import POSE_ROTATIONS
from decompose.print_time.surfaces import measure_surfaces
from decompose.printers import TargetPrinter

MAX_HULL_FACETS, MAX_FLAT_FACES = 24, 12  # maximum number of candidates of each kind, the largest first
DIRECTION_STEPS = 1000  # coordinates of directions are compared after rounding to 1 / DIRECTION_STEPS
MIN_DIFFERENCE_DEG = 2.0  # minimum angle between two candidates
YAWS_RAD: Floats = np.radians(np.arange(90.0))
"""Yaws that are tried, relative to the yaw of the smallest rectangle around the outline."""


class Hull(NamedTuple):
    """Convex hull of a part.

    Attributes
    ----------
    points
        (h, 3) vertices of the hull in mm; all vertices of the part if it has no volume.
    facet_vectors_mm2
        (f, 3) outward unit normals of the facets times their areas; none if the hull has no volume.
    """

    points: Floats
    facet_vectors_mm2: Floats


def build_hull(vertices: Floats) -> Hull:
    """Build the convex hull of vertices (n, 3) in mm."""
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        return Hull(vertices, np.zeros((0, 3)))
    areas_mm2 = measure_surfaces(vertices, hull.simplices.astype(np.int64)).areas_mm2
    return Hull(vertices[hull.vertices], areas_mm2[:, None] * hull.equations[:, :3])


def list_directions(vertices: Floats, faces: Ints, hull: Hull) -> Floats:
    """List candidates for the direction up: the axes, then the inward normals of hull facets and large faces.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    hull
        Convex hull of the vertices.

    Returns
    -------
    ndarray
        (k, 3) unit vectors.
    """
    surfaces = measure_surfaces(vertices, faces)
    area_vectors = surfaces.areas_mm2[:, None] * surfaces.normals
    directions = POSE_ROTATIONS[[4, 5, 0, 1, 2, 3], 2]
    for normals, max_count in ((hull.facet_vectors_mm2, MAX_HULL_FACETS), (area_vectors, MAX_FLAT_FACES)):
        directions = _append_distinct_directions(
            directions, -_find_flat_directions(normals), max_count, math.cos(math.radians(MIN_DIFFERENCE_DEG))
        )
    return directions


@jit
def _append_distinct_directions(
    known_directions: Floats, candidates: Floats, max_count: int, min_same_cos: float
) -> Floats:
    """Append candidates to a list of directions, except those close to a direction that is in the list.

    Parameters
    ----------
    known_directions
        (k, 3) float64 unit vectors.
    candidates
        (m, 3) float64 unit vectors, in the order of precedence.
    max_count
        Maximum number of candidates to append.
    min_same_cos
        Minimum cosine of the angle between directions that count as the same.

    Returns
    -------
    ndarray
        (k + appended, 3) float64.
    """
    directions = np.zeros((len(known_directions) + max_count, 3))
    count = len(known_directions)
    directions[:count] = known_directions
    for i in range(len(candidates)):
        if count == len(directions):
            break
        is_distinct = True
        for k in range(count):
            cos = 0.0
            for axis in range(3):
                cos += directions[k, axis] * candidates[i, axis]
            if cos >= min_same_cos:
                is_distinct = False
        if is_distinct:
            directions[count] = candidates[i]
            count += 1
    return directions[:count].copy()


def _find_flat_directions(area_vectors: Floats) -> Floats:
    """Sum area vectors (m, 3) by direction, and return the directions (k, 3), the largest sum first."""
    sizes_mm2 = np.linalg.norm(area_vectors, axis=1)
    area_vectors = area_vectors[sizes_mm2 > 0.0]
    if not len(area_vectors):
        return area_vectors
    x, y, z = np.rint(area_vectors / sizes_mm2[sizes_mm2 > 0.0, None] * DIRECTION_STEPS).astype(np.int64).T
    _, group = np.unique(
        ((x + DIRECTION_STEPS) * (2 * DIRECTION_STEPS + 1) + y + DIRECTION_STEPS) * (2 * DIRECTION_STEPS + 1)
        + z,
        return_inverse=True,
    )
    sums = np.zeros((group.max() + 1, 3))
    np.add.at(sums, group.reshape(-1), area_vectors)
    sizes_mm2 = np.linalg.norm(sums, axis=1)
    sums = sums[np.argsort(-np.round(sizes_mm2, 6), kind="stable")]
    directions: Floats = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    return directions


def find_fitting_rotations(
    vertices: Floats, faces: Ints, hull: Hull, printers: Sequence[TargetPrinter]
) -> Floats:
    """Find the rotations in which a part lies on a flat side and fits all printers.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    hull
        Convex hull of the vertices.
    printers
        Printers to fit; empty for a printer without limits.

    Returns
    -------
    ndarray
        (k, 3, 3) rotations, whose rows are the bed's x, y and z in the model's frame.
    """
    directions = list_directions(vertices, faces, hull)
    return _find_rotations(directions, np.ascontiguousarray(hull.points), list_build_volumes(printers))


@jit
def _find_rotations(directions: Floats, hull: Floats, build_volumes: Floats) -> Floats:
    """Find the rotations that turn each direction up, and in which the part fits every printer.

    Axis-aligned poses keep their yaw if it fits. Any other pose is rotated so that the smallest rectangle
    around its outline is parallel to the bed's axes, and further if that yaw does not fit.

    Parameters
    ----------
    directions
        (k, 3) float64 unit vectors.
    hull
        (h, 3) float64 vertices of the convex hull in mm.
    build_volumes
        (build volumes, boxes, 3) float64 in mm, from `list_build_volumes`.

    Returns
    -------
    ndarray
        (m, 3, 3) float64, in the order of the directions; directions without a fitting yaw are left out.
    """
    rotations, count = np.zeros((len(directions), 3, 3)), 0
    points, bed_axes, yaw_rad = np.zeros((len(hull), 2)), np.zeros((2, 3)), np.zeros(1)
    for direction in range(len(directions)):
        up = directions[direction]
        pose = _find_axis_pose(up)
        if pose >= 0:
            bed_axes[:] = POSE_ROTATIONS[pose, :2]
        else:
            bed_axes[0], bed_axes[1] = _choose_bed_axes(up)
        low_z, high_z = np.inf, -np.inf
        for i in range(len(hull)):
            for k in range(2):
                points[i, k] = _compute_dot_product(hull[i], bed_axes[k])
            z = _compute_dot_product(hull[i], up)
            low_z, high_z = min(low_z, z), max(high_z, z)
        outline = find_convex_outline(points)
        angle_rad = find_smallest_rectangle_angle_rad(outline)
        for yaw in range(-1 if pose >= 0 else 0, len(YAWS_RAD)):
            yaw_rad[0] = angle_rad + YAWS_RAD[yaw] if yaw >= 0 else 0.0
            sides_mm = measure_rectangles(outline, yaw_rad)
            if fits_all(build_volumes, sides_mm[0, 0], sides_mm[0, 1], high_z - low_z):
                cos, sin = np.cos(yaw_rad[0]), np.sin(yaw_rad[0])
                rotations[count, 0] = cos * bed_axes[0] + sin * bed_axes[1]
                rotations[count, 1] = cos * bed_axes[1] - sin * bed_axes[0]
                rotations[count, 2] = up
                count += 1
                break
    return rotations[:count].copy()


@jit
def _find_axis_pose(up: Floats) -> int:
    """Find the axis-aligned pose with a direction (3,) float64 up; -1 if the direction is along no axis."""
    for pose in range(len(POSE_ROTATIONS)):
        is_same = True
        for axis in range(3):
            is_same = is_same and POSE_ROTATIONS[pose, 2, axis] == up[axis]
        if is_same:
            return pose
    return -1


@jit
def _compute_dot_product(vector: Floats, other: Floats) -> float:
    """Compute the dot product of two vectors (3,) float64."""
    product: float = vector[0] * other[0] + vector[1] * other[1] + vector[2] * other[2]
    return product


@jit
def _choose_bed_axes(up: Floats) -> tuple[Floats, Floats]:
    """Choose the x and y axes of the bed, perpendicular to an upward direction.

    Parameters
    ----------
    up
        (3,) float64 unit vector that points up.

    Returns
    -------
    tuple
        (3,) float64 unit vectors x and y.
    """
    across = 0
    for axis in range(1, 3):
        if abs(up[axis]) < abs(up[across]):
            across = axis
    x, y = np.zeros(3), np.zeros(3)
    b, c = (across + 1) % 3, (across + 2) % 3
    length = np.sqrt(up[b] ** 2 + up[c] ** 2)
    x[b], x[c] = up[c] / length, -up[b] / length
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        y[axis] = up[b] * x[c] - up[c] * x[b]
    return x, y
