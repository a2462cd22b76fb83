"""Print time of a part: its price in a pose, and the pose in which it is printed."""

from __future__ import annotations

from decompose.print_time.columns import measure_columns
from decompose.print_time.cost import CostModel
from decompose.print_time.face_slopes import measure_face_slopes
from decompose.print_time.feature_shares import TERM_GROUPS, build_group_cost, estimate_feature_shares
from decompose.print_time.hidden_faces import MEAN_SIDE_SHARE, MIN_VISIBLE_MM2
from decompose.print_time.part_mesh import PartMesh
from decompose.print_time.pose_prices import POSE_ROTATIONS, price_axis_poses_s, sum_pose_features
from decompose.print_time.poses import (
    MIN_TOUCHED_MM2,
    REFERENCE_SHRINKAGE,
    Pose,
    compute_steady_limit_s,
    find_best_pose,
    find_steady_pose,
    measure_pose,
)
from decompose.print_time.price_formula import MAX_INSET_SHARE, Prices, compute_price_s
from decompose.print_time.time_settings import (
    ADDITIVE_FEATURES,
    FACTORS,
    FEATURES,
    SUPPORT_TERMS,
    PrintTimeSettings,
    compute_time_terms,
)

__all__ = [
    "ADDITIVE_FEATURES",
    "FACTORS",
    "FEATURES",
    "MAX_INSET_SHARE",
    "MEAN_SIDE_SHARE",
    "MIN_TOUCHED_MM2",
    "MIN_VISIBLE_MM2",
    "POSE_ROTATIONS",
    "REFERENCE_SHRINKAGE",
    "SUPPORT_TERMS",
    "TERM_GROUPS",
    "CostModel",
    "PartMesh",
    "Pose",
    "Prices",
    "PrintTimeSettings",
    "build_group_cost",
    "compute_price_s",
    "compute_steady_limit_s",
    "compute_time_terms",
    "estimate_feature_shares",
    "find_best_pose",
    "find_steady_pose",
    "measure_columns",
    "measure_face_slopes",
    "measure_pose",
    "price_axis_poses_s",
    "sum_pose_features",
]
