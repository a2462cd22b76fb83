"""Orientation of a part: the pose that prints fastest among those in which the part stays upright.

Each candidate (`rotations`) is priced with its supports. It is also checked whether the part stays upright
while it grows, and whether support would stick to a cut face, which will be glued.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Bools, Floats, Ints
from decompose.print_time.columns import estimate_supports
from decompose.print_time.cost import CostModel
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.pose_prices import sum_pose_features
from decompose.print_time.poses.pose import COLUMN_INDEX, Pose, measure_pose_from_features
from decompose.print_time.poses.rotations import build_hull, find_fitting_rotations
from decompose.printers import TargetPrinter

# Maximum number of candidates that are measured, those with the lowest prices first. More are measured only
# while the part does not stay upright, or support touches a cut face, in the best candidate so far.
MAX_MEASURED_POSES = 24
ESTIMATE_COLUMN_COUNT = 1_500  # approximate number of columns for an estimate of the support
CERTAIN_SUPPORT_SHARE = 0.8  # a support takes at least this share of its estimated time


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
    rotations = find_fitting_rotations(vertices, faces, hull, printers)
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


def _estimate_support_s(mesh: PartMesh, hull: Floats, rotation: Floats, cost: CostModel) -> float:
    """Estimate the time of the support in a pose from a few columns, without the travel to its islands."""
    triangles = (mesh.vertices @ rotation.T - (hull @ rotation.T).min(axis=0))[mesh.faces]
    overhang_cos = cost.find_overhang_cos(mesh.surfaces, rotation[2])
    return cost.price_support_s(*estimate_supports(triangles, overhang_cos, ESTIMATE_COLUMN_COUNT))
