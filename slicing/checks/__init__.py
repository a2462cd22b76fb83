"""Checks of CuraEngine's output: its log, its G-code, and each layer's outline against the model."""

from slicing.checks.feature_times import (
    FeatureTimes,
    MotionLimits,
    estimate_move_seconds,
    measure_feature_times,
)
from slicing.checks.outline import UnprintedWall, check_outline
from slicing.checks.output import GcodeFacts
from slicing.checks.time_comments import add_times, change_times, remove_reset_times
from slicing.checks.toolpath import Toolpath, read_toolpath
from slicing.checks.walls import WallLayout, read_wall_layout

__all__ = [
    "FeatureTimes",
    "GcodeFacts",
    "MotionLimits",
    "Toolpath",
    "UnprintedWall",
    "WallLayout",
    "add_times",
    "change_times",
    "check_outline",
    "estimate_move_seconds",
    "measure_feature_times",
    "read_toolpath",
    "read_wall_layout",
    "remove_reset_times",
]
