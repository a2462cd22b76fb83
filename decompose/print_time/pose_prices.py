"""Price of a closed mesh in a pose, from sums over its faces alone, and the extra time of short layers.

Supports are counted as if they went down to the bed. A slicer slows down short layers, which would otherwise
not cool before the next layer.
"""

from __future__ import annotations

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.geometry.rays import find_bounds
from decompose.jit import jit
from decompose.print_time.cost import CostModel
from decompose.print_time.hidden_faces import find_hidden_faces
from decompose.print_time.price_formula import MAX_INSET_SHARE
from decompose.print_time.surfaces import Surfaces, measure_surfaces, sum_volume_mm3
from decompose.print_time.time_settings import ADDITIVE_FEATURES

LATERAL_INDEX = ADDITIVE_FEATURES.index("lateral_mm2")
SKIN_INDEX = ADDITIVE_FEATURES.index("skin_mm2")

# In an axis-aligned pose, an axis of the model points up or down. The number of the pose gives the direction
# of the model that points up: +x, -x, +y, -y, +z, -z.
POSE_COUNT = 6

SLAB_COUNT = 32  # number of slabs into which the height is divided; the layers of a slab are treated as equal
MAX_SLOWDOWN = 4.0  # short layers are slowed down by at most this factor, such as from 40 to 10 mm/s


def find_pose_axes(pose: int) -> tuple[int, int, int]:
    """Find the model axes that become width, depth and height in a pose."""
    up = pose // 2
    return ((up + 1) % 3, (up + 2) % 3, up)


def _build_pose_rotation(pose: int) -> Floats:
    """Build the rotation (3, 3) of an axis-aligned pose: rows are the bed's axes.

    Odd poses are upside down.
    """
    rotation = np.eye(3)[list(find_pose_axes(pose))]
    if pose % 2:
        rotation[1:] *= -1.0
    return rotation


POSE_ROTATIONS: Floats = np.array([_build_pose_rotation(pose) for pose in range(POSE_COUNT)])
"""Rotations (6, 3, 3) of the axis-aligned poses, for `price_poses_s`."""


@jit
def _sum_face_features(
    surfaces: Surfaces, up: Floats, bed_mm: float, cosines: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Sum the `ADDITIVE_FEATURES` of faces, without the volume.

    Parameters
    ----------
    surfaces
        Normals, areas and centres of the faces.
    up
        (3,) unit vector that points up.
    bed_mm
        Position of the bed along `up`.
    cosines
        `skin_cos` and `overhang_cos` of `CostModel`.

    Returns
    -------
    tuple
        `lateral_mm2`, `skin_mm2`, `slope_mm2` and `column_mm3`.
    """
    normals, areas_mm2, centres = surfaces
    skin_cos, overhang_cos = cosines
    lateral_mm2, skin_mm2, slope_mm2, column_mm3 = 0.0, 0.0, 0.0, 0.0
    for i in range(len(areas_mm2)):
        n = normals[i, 0] * up[0] + normals[i, 1] * up[1] + normals[i, 2] * up[2]
        face_lateral_mm2 = areas_mm2[i] * np.sqrt(max(0.0, 1.0 - n * n))
        lateral_mm2 += face_lateral_mm2
        if abs(n) > skin_cos:
            skin_mm2 += areas_mm2[i] * abs(n)
            slope_mm2 += face_lateral_mm2
        if n < -overhang_cos:
            z = centres[i, 0] * up[0] + centres[i, 1] * up[1] + centres[i, 2] * up[2]
            column_mm3 -= areas_mm2[i] * n * (z - bed_mm)
    return lateral_mm2, skin_mm2, slope_mm2, column_mm3


def sum_pose_features(
    vertices: Floats,
    faces: Ints,
    rotations: Floats,
    cost: CostModel,
    hull: Floats | None = None,
    is_cut: Bools | None = None,
) -> tuple[Floats, Floats]:
    """Sum the `ADDITIVE_FEATURES` of a closed mesh in k poses, and measure its extents.

    Hidden faces are printed faster than visible ones, so only a share of their skin and walls is counted.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward by the right-hand rule.
    rotations
        (k, 3, 3) rotations into the poses: rows are the bed's x, y and z in the model's frame, and
        ``v_bed = rotation @ v_model``.
    cost
        Cost model of the print time.
    hull
        (h, 3) vertices of the convex hull, with which extents are measured faster; None to use all vertices.
    is_cut
        (m,) bool, true for cut faces; None if there are none.

    Returns
    -------
    tuple
        (k, 5) features, and (k, 3) width, depth and height in mm.
    """
    surfaces = measure_surfaces(vertices, faces)
    has_savings = is_cut is not None and bool(is_cut.any()) and _saves_at_hidden_faces(cost)
    features, extents_mm = np.zeros((len(rotations), len(ADDITIVE_FEATURES))), np.zeros((len(rotations), 3))
    features[:, 0] = sum_volume_mm3(surfaces)
    cosines = (cost.skin_cos, cost.overhang_cos)
    for i, rotation in enumerate(np.ascontiguousarray(rotations, dtype=np.float64)):
        rotated_vertices = (vertices if hull is None else hull) @ rotation.T
        bottom, top = find_bounds(rotated_vertices[:, None])
        extents_mm[i] = top - bottom
        up, bed_mm = rotation[2], float(bottom[2])
        features[i, 1:] = _sum_face_features(surfaces, up, bed_mm, cosines)
        if has_savings and is_cut is not None:
            hidden_faces = find_hidden_faces(surfaces, is_cut, up, bed_mm, cost.skin_cos)
            saved_mm2 = hidden_faces.compute_saved_skin_mm2(cost.hidden_bed_share, cost.hidden_top_share)
            features[i, SKIN_INDEX] = max(0.0, features[i, SKIN_INDEX] - saved_mm2)
            features[i, LATERAL_INDEX] -= cost.hidden_side_share * hidden_faces.cut_side_mm2
    return features, extents_mm


def _saves_at_hidden_faces(cost: CostModel) -> bool:
    """Check whether hidden faces are printed faster than visible ones."""
    return cost.hidden_bed_share + cost.hidden_top_share + cost.hidden_side_share > 0.0


def price_poses_s(vertices: Floats, faces: Ints, rotations: Floats, cost: CostModel) -> Floats:
    """Price a closed mesh in each of k poses.

    Parameters
    ----------
    vertices, faces, rotations, cost
        As in `sum_pose_features`.

    Returns
    -------
    ndarray
        (k,) seconds.
    """
    features, extents_mm = sum_pose_features(vertices, faces, rotations, cost)
    return cost.price_poses_s(features, extents_mm)


def price_axis_poses_s(vertices: Floats, faces: Ints, cost: CostModel) -> Floats:
    """Price a closed mesh in each axis-aligned pose, in seconds (6,).

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh that faces outward.
    cost
        Cost model of the print time.
    """
    return price_poses_s(vertices, faces, POSE_ROTATIONS, cost)


def price_short_layers_s(triangles: Floats, cost: CostModel) -> float:
    """Compute the extra time in seconds of short layers that `CostModel.price_part_s` does not include.

    That method compares only the mean time of all layers with the minimum time of a layer. But in a part that
    tapers, only the layers at the tip are slowed down.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm of a closed mesh that faces outward, standing on z = 0.
    cost
        Cost model of the print time.
    """
    height_mm = float(triangles[:, :, 2].max())
    slab_mm = height_mm / SLAB_COUNT
    lateral_mm2, section_mm2 = _sum_slabs(np.ascontiguousarray(triangles), height_mm)
    walls_s = cost.lateral_s_per_mm2 * lateral_mm2
    inset_s = np.minimum(cost.inset_s_per_mm * slab_mm, MAX_INSET_SHARE * walls_s)
    lines_s = cost.volume_s_per_mm3 * slab_mm * section_mm2 + walls_s - inset_s
    min_s = np.minimum(cost.min_s_per_mm * slab_mm, MAX_SLOWDOWN * lines_s)
    covered_s = max(0.0, cost.min_s_per_mm * height_mm - float(lines_s.sum()))
    return max(0.0, float(np.maximum(0.0, min_s - lines_s).sum()) - covered_s)


@jit
def _sum_slabs(triangles: Floats, height_mm: float) -> tuple[Floats, Floats]:
    """Sum A sqrt(1 - n^2) over the faces in each slab, and compute the mean cross-section of the solid there.

    n is the upward component of a face's unit normal, and A is the area of the face. The area of the
    cross-section at a height is the sum of A n over all faces above that height.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, facing outward, standing on z = 0.
    height_mm
        Height of the mesh in mm.

    Returns
    -------
    tuple
        (SLAB_COUNT,) float64 sums, and (SLAB_COUNT,) float64 areas of cross-sections, in mm2.
    """
    # Sums of A sqrt(1 - n^2) below each plane between slabs, and of A n above it.
    lateral, section_sums = np.zeros(SLAB_COUNT + 1), np.zeros(SLAB_COUNT + 1)
    for t in range(len(triangles)):
        ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
        ux, uy, uz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
        vx, vy, vz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
        nx, ny, nz = (uy * vz - uz * vy) / 2.0, (uz * vx - ux * vz) / 2.0, (ux * vy - uy * vx) / 2.0
        face_lateral_mm2 = np.sqrt(nx * nx + ny * ny)
        low, high = min(az, az + uz, az + vz), max(az, az + uz, az + vz)
        middle = 3.0 * az + uz + vz - low - high
        for plane in range(SLAB_COUNT + 1):
            z = height_mm * plane / SLAB_COUNT
            if z >= high:
                share_below = 1.0
            elif z <= low:
                share_below = 0.0
            elif z < middle:
                share_below = (z - low) ** 2 / ((middle - low) * (high - low))
            else:
                share_below = 1.0 - (high - z) ** 2 / ((high - middle) * (high - low))
            lateral[plane] += share_below * face_lateral_mm2
            section_sums[plane] += (1.0 - share_below) * nz
    section_sums[0] = section_sums[1]  # the section at the bed itself would be 0
    return lateral[1:] - lateral[:-1], np.maximum(0.0, (section_sums[1:] + section_sums[:-1]) / 2.0)
