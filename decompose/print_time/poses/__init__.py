"""Poses of a part on the bed: the fastest one, a more stable one if there is time, and its footing."""

from __future__ import annotations

from decompose.print_time.poses.footing import REFERENCE_SHRINKAGE
from decompose.print_time.poses.orientation import find_best_pose
from decompose.print_time.poses.pose import MIN_TOUCHED_MM2, Pose, measure_pose
from decompose.print_time.poses.steady_pose import compute_steady_limit_s, find_steady_pose

__all__ = [
    "MIN_TOUCHED_MM2",
    "REFERENCE_SHRINKAGE",
    "Pose",
    "compute_steady_limit_s",
    "find_best_pose",
    "find_steady_pose",
    "measure_pose",
]
