"""Orientation of a part: the pose that prints fastest among those in which the part stays upright.

Candidates are the six axis-aligned poses, and poses in which the part lies on a facet of its convex hull or
on a large flat face. Each candidate is priced with its supports. It is also checked whether the part stays
upright while it grows, and whether support would stick to a cut face, which will be glued.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from decompose.arrays import Bools, Floats, Ints
from decompose.geometry import find_convex_outline, find_smallest_rectangle_angle_rad, measure_rectangles
from decompose.jit import jit
from decompose.print_time.columns import measure_columns
from decompose.print_time.cost import CostModel
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.pose_prices import POSE_ROTATIONS, sum_pose_features
from decompose.print_time.poses.pose import COLUMN_INDEX, Pose, measure_pose_from_features
from decompose.print_time.surfaces import measure_surfaces
from decompose.printers import TargetPrinter

MAX_HULL_FACETS, MAX_FLAT_FACES = 24, 12  # maximum number of candidates of each kind, the largest first
DIRECTION_STEPS = 1000  # coordinates of directions are compared after rounding to 1 / DIRECTION_STEPS
MIN_DIFFERENCE_DEG = 2.0  # minimum angle between two candidates
# Maximum number of candidates that are measured, those with the lowest prices first. More are measured only
# while the part does not stay upright, or support touches a cut face, in the best candidate so far.
MAX_MEASURED_POSES = 24
ESTIMATE_COLUMN_COUNT = 1_500  # approximate number of columns for an estimate of the support
CERTAIN_SUPPORT_SHARE = 0.8  # a support takes at least this share of its estimated time
YAWS_RAD: Floats = np.radians(np.arange(90.0))
"""Yaws that are tried, relative to the yaw of the smallest rectangle around the outline."""


def find_best_pose(
    vertices: Floats,
    faces: Ints,
    is_cut: Bools,
    printers: Sequence[TargetPrinter],
    cost: CostModel,
    fit_first_layer: bool = True,
) -> Pose | None:
    """Find the best pose for printing a part.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    is_cut
        (m,) bool, true for cut faces, which no support should touch.
    printers
        Printers, all of which the part has to fit; empty for a printer without limits.
    cost
        Cost model of the print time.
    fit_first_layer
        Whether the brim and the first layer's expansion are chosen for the part; if not, those of the print
        settings apply.

    Returns
    -------
    Pose or None
        Pose of the lowest rank; None if no pose fits.
    """
    hull = build_hull(vertices)
    rotations = _list_rotations(list_directions(vertices, faces, hull), hull, printers)
    if not len(rotations):
        return None
    features, extents_mm = sum_pose_features(vertices, faces, rotations, cost, hull.points, is_cut)
    min_s, max_s = _bound_prices_s(features, extents_mm, cost, fit_first_layer)
    mesh = PartMesh(vertices, faces, is_cut)
    best_pose: Pose | None = None
    measured_count = 0
    for i in np.argsort(max_s, kind="stable"):
        if best_pose is not None and best_pose.rank[:3] == (0, 0.0, 0.0):
            if min_s[i] >= best_pose.price_s or measured_count >= MAX_MEASURED_POSES:
                continue
            support_s = _estimate_support_s(mesh, hull.points, rotations[i], cost)
            if min_s[i] + CERTAIN_SUPPORT_SHARE * support_s >= best_pose.price_s:
                continue
        pose = measure_pose_from_features(mesh, rotations[i], features[i], cost, fit_first_layer)
        measured_count += 1
        if best_pose is None or pose.rank < best_pose.rank:
            best_pose = pose
    return best_pose


def _bound_prices_s(
    features: Floats, extents_mm: Floats, cost: CostModel, fit_first_layer: bool
) -> tuple[Floats, Floats]:
    """Bound the prices (k,) of poses with features (k, 5): lower bounds without, upper bounds with supports.

    If the brim is chosen for each pose, the lower bounds do not include it.
    """
    cost_without_brim = replace(cost, brim_mm=0.0) if fit_first_layer else cost
    features_without_support = features.copy()
    features_without_support[:, COLUMN_INDEX] = 0.0
    min_s = cost_without_brim.price_poses_s(features_without_support, extents_mm)
    return min_s, cost.price_poses_s(features, extents_mm)


def find_fitting_rotations(vertices: Floats, faces: Ints, printers: Sequence[TargetPrinter]) -> Floats:
    """Find the rotations in which a part lies on a flat side and fits all printers.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    printers
        Printers to fit; empty for a printer without limits.

    Returns
    -------
    ndarray
        (k, 3, 3) rotations, whose rows are the bed's x, y and z in the model's frame.
    """
    hull = build_hull(vertices)
    return _list_rotations(list_directions(vertices, faces, hull), hull, printers)


def _list_rotations(directions: Floats, hull: Hull, printers: Sequence[TargetPrinter]) -> Floats:
    """List the rotations (m, 3, 3) that turn each direction (k, 3) up, if the part fits at some yaw."""
    rotations = [_find_rotation(up, hull.points, printers) for up in directions]
    return np.array([rotation for rotation in rotations if rotation is not None]).reshape(-1, 3, 3)


def _estimate_support_s(mesh: PartMesh, hull: Floats, rotation: Floats, cost: CostModel) -> float:
    """Estimate the time of the support in a pose from a few columns, without the travel to its islands."""
    triangles = (mesh.vertices @ rotation.T - (hull @ rotation.T).min(axis=0))[mesh.faces]
    overhang_cos = cost.find_overhang_cos(mesh.surfaces, rotation[2])
    columns = measure_columns(
        triangles, np.zeros(len(mesh.faces), np.bool_), overhang_cos, ESTIMATE_COLUMN_COUNT
    )
    return cost.price_support_s(columns.support_mm3, columns.support_side_mm2, columns.towers_mm)


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


def _find_rotation(up: Floats, hull: Floats, printers: Sequence[TargetPrinter]) -> Floats | None:
    """Find a rotation that turns a direction (3,) up and in which the part fits every printer, or None.

    Axis-aligned poses keep their yaw if it fits. Any other pose is rotated so that the smallest rectangle
    around its outline is parallel to the bed's axes, and further if that yaw does not fit.
    """
    axis = np.flatnonzero((POSE_ROTATIONS[:, 2] == up).all(axis=1))
    if len(axis):
        x, y = POSE_ROTATIONS[axis[0], :2]
    else:
        x, y = _choose_bed_axes(up)
    points = hull @ np.array([x, y]).T
    height_mm = float(np.ptp(hull @ up))
    outline = find_convex_outline(points)
    angles_rad = find_smallest_rectangle_angle_rad(outline) + YAWS_RAD
    if len(axis):
        angles_rad = np.insert(angles_rad, 0, 0.0)
    for some_angles_rad in (angles_rad[:1], angles_rad[1:]):  # the first one almost always fits
        sizes_mm = measure_rectangles(outline, some_angles_rad).tolist()
        for angle_rad, (width_mm, depth_mm) in zip(some_angles_rad, sizes_mm, strict=True):
            if all(printer.fits(width_mm, depth_mm, height_mm) for printer in printers):
                return np.vstack([_build_yaw(angle_rad) @ np.array([x, y]), up])
    return None


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


def _build_yaw(angle_rad: float) -> Floats:
    """Build the matrix (2, 2) whose rows are the axes x and y, rotated by an angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, sin], [-sin, cos]])
