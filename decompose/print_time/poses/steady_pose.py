"""Search for a more stable pose, with a larger foot and less height, of a part that has time to spare.

A part that ends before the slowest one need not be printed in its fastest pose. If its first layer, its foot,
has only a few square millimetres, it is more likely to come off the bed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats
from decompose.print_time.cost import CostModel
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.pose_prices import sum_pose_features
from decompose.print_time.poses.footing import FIRST_LAYER_MIDDLE_MM
from decompose.print_time.poses.pose import COLUMN_INDEX, Pose, measure_pose_from_features
from decompose.print_time.poses.rotations import build_hull, find_fitting_rotations
from decompose.printers import TargetPrinter

# A part with at most this `Pose.slenderness`, that of a cube, keeps its fastest pose.
MAX_STEADY_SLENDERNESS = 1.0
MAX_SLENDERNESS_RATIO = 0.8  # maximum slenderness of a steadier pose, as a share of that of the fastest pose
# Maximum time of a steadier pose, as a multiple of that of the fastest pose; a part on a small foot may take
# more.
MAX_TIME_RATIO = 1.02
MAX_MEASURED_POSES = 4  # maximum number of measured poses, those with the least estimated slenderness first


def compute_steady_limit_s(fastest_pose: Pose, spare_limit_s: float) -> float:
    """Compute the time that a part may take in a steadier pose.

    Parameters
    ----------
    fastest_pose
        Fastest pose of the part.
    spare_limit_s
        Price at which the print of the part would finish at the same time as that of the slowest part.

    Returns
    -------
    float
        Time in seconds. A part on a small foot may use all of its spare time, or 2 % more than in the fastest
        pose if that is longer. Any other part may use its spare time, but at most 2 % more than in the
        fastest pose.
    """
    max_s = MAX_TIME_RATIO * fastest_pose.price_s
    return max(spare_limit_s, max_s) if fastest_pose.has_small_foot else min(spare_limit_s, max_s)


def find_steady_pose(
    mesh: PartMesh, printers: Sequence[TargetPrinter], cost: CostModel, fastest_pose: Pose, limit_s: float
) -> Pose:
    """Find a pose with a larger foot and less height than the fastest one, within a time limit.

    Parameters
    ----------
    mesh
        Closed mesh of the part, facing outward.
    printers
        Printers, all of which the part has to fit.
    cost
        Cost model of the print time.
    fastest_pose
        Fastest pose of the part. If its brim width was chosen for the part, the brim widths of other poses
        are chosen too; if not (None), that of the print settings applies to all poses.
    limit_s
        Maximum price of the pose.

    Returns
    -------
    Pose
        A pose with much less slenderness, in which the part stays upright as well (`Pose.rank`), and support
        touches no more cut faces. If there is none within the limit, the fastest pose.
    """
    if fastest_pose.slenderness <= MAX_STEADY_SLENDERNESS or limit_s < fastest_pose.price_s:
        return fastest_pose
    hull = build_hull(mesh.vertices)
    rotations = find_fitting_rotations(mesh.vertices, mesh.faces, hull, printers)
    slenderness = np.array([_estimate_slenderness(mesh, rotation) for rotation in rotations])
    max_slenderness = MAX_SLENDERNESS_RATIO * fastest_pose.slenderness
    order = [i for i in np.argsort(slenderness, kind="stable") if slenderness[i] < max_slenderness]
    cost_without_brim, measured_count = replace(cost, brim_mm=0.0), 0
    for i in order:
        (features,), (extents_mm,) = sum_pose_features(
            mesh.vertices, mesh.faces, rotations[i : i + 1], cost, is_cut=mesh.is_cut
        )
        if cost_without_brim.price_part_s([*features[:COLUMN_INDEX], 0.0], extents_mm) > limit_s:
            continue
        pose = measure_pose_from_features(
            mesh, rotations[i], features, cost, fastest_pose.brim_width_mm is not None
        )
        if (
            pose.slenderness < max_slenderness
            and pose.price_s <= limit_s
            and pose.rank[:3] <= fastest_pose.rank[:3]
        ):
            return pose
        measured_count += 1
        if measured_count == MAX_MEASURED_POSES:
            break
    return fastest_pose


def _estimate_slenderness(mesh: PartMesh, rotation: Floats) -> float:
    """Estimate the slenderness of a part in a pose (3, 3) from its flat faces on the bed."""
    z_mm = mesh.vertices @ rotation[2]
    low_mm = float(z_mm.min())
    bottom_faces = mesh.faces[(z_mm[mesh.faces] < low_mm + FIRST_LAYER_MIDDLE_MM).all(axis=1)]
    a, b, c = (mesh.vertices[bottom_faces[:, corner]] for corner in range(3))
    foot_mm2 = -float((np.cross(b - a, c - a) @ rotation[2]).sum()) / 2.0
    return (float(z_mm.max()) - low_mm) / math.sqrt(foot_mm2) if foot_mm2 > 0.0 else math.inf
