"""Time of the layers of a slice by feature: walls, infill, skins, supports and travel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from slicing.checks.section import Floats
from slicing.checks.toolpath import Toolpath

_STANDSTILL_MM_S = 0.05
_JUNCTION_PASSES = 8
"""Number of moves before and after a junction that may limit its speed."""
_FIELD_BY_FEATURE = {
    "WALL-OUTER": "walls_s",
    "WALL-INNER": "walls_s",
    "FILL": "infill_s",
    "SKIN": "skins_s",
    "SUPPORT": "supports_s",
    "SUPPORT-INTERFACE": "supports_s",
    "SKIRT": "supports_s",
}


@dataclass(frozen=True, slots=True)
class FeatureTimes:
    """Seconds of the layers of a slice by feature; their sum is the time of the layers.

    Supports include the brim or skirt. Travel includes all moves without extrusion, and retractions.
    """

    walls_s: float
    infill_s: float
    skins_s: float
    supports_s: float
    travel_s: float


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits with which CuraEngine plans moves; arrays are (4,), for X, Y, Z and E."""

    acceleration_mm_s2: float
    max_acceleration_mm_s2: Floats
    max_feed_mm_s: Floats
    jerk_mm_s: Floats

    @classmethod
    def from_settings(cls, settings: Mapping[str, str]) -> MotionLimits:
        """Read the limits from Cura's settings of a machine, by their keys."""

        def read_axes(key: str, axes: str) -> Floats:
            return np.array([float(settings[f"machine_max_{key}_{axis}"]) for axis in axes.split()])

        jerk_xy, jerk_z, jerk_e = read_axes("jerk", "xy z e")
        return cls(
            acceleration_mm_s2=float(settings["machine_acceleration"]),
            max_acceleration_mm_s2=read_axes("acceleration", "x y z e"),
            max_feed_mm_s=read_axes("feedrate", "x y z e"),
            jerk_mm_s=np.array([jerk_xy, jerk_xy, jerk_z, jerk_e]),
        )


def measure_feature_times(toolpath: Toolpath, limits: MotionLimits) -> FeatureTimes:
    """Divide CuraEngine's time of each layer among its features, in proportion to estimated times of moves.

    Parameters
    ----------
    toolpath
        Moves and comments of CuraEngine's output.
    limits
        Limits with which it was sliced.
    """
    names = [item.name for item in fields(FeatureTimes)]
    ends, first = toolpath.list_layer_ends(), toolpath.first_layer_move
    if first is None or not ends:
        return FeatureTimes(*(0.0 for _ in names))
    bounds = np.array([first, *(move for move, _ in ends)])
    seconds = estimate_move_seconds(toolpath, limits)
    sums = np.concatenate(([0.0], np.cumsum(seconds)))
    layer_s = np.diff(np.array([0.0, *(elapsed_s for _, elapsed_s in ends)]))
    estimated_s = np.diff(sums[bounds])
    scales = np.divide(layer_s, estimated_s, out=np.zeros_like(layer_s), where=estimated_s > 0.0)
    layer_moves = slice(int(bounds[0]), int(bounds[-1]))
    scaled_s = seconds[layer_moves] * np.repeat(scales, np.diff(bounds))
    groups = [names.index(_FIELD_BY_FEATURE.get(feature, "travel_s")) for feature in toolpath.features]
    extrudes = (toolpath.extruded_mm > 0.0) & toolpath.is_head_move
    group = np.where(extrudes, np.array(groups)[toolpath.feature], names.index("travel_s"))
    return FeatureTimes(*np.bincount(group[layer_moves], weights=scaled_s, minlength=len(names)).tolist())


def estimate_move_seconds(toolpath: Toolpath, limits: MotionLimits) -> Floats:
    """Estimate the seconds (n,) of each move with acceleration and jerk.

    The speed at a junction is bounded by the jerk, and by the few moves on both sides of it.

    Parameters
    ----------
    toolpath
        The n moves of a file.
    limits
        Limits of acceleration, speed and jerk.
    """
    delta_mm = toolpath.end - toolpath.start
    length_mm = np.linalg.norm(delta_mm[:, :3], axis=1)
    length_mm = np.maximum(np.where(length_mm > 0.0, length_mm, np.abs(delta_mm[:, 3])), 1e-9)
    direction = delta_mm / length_mm[:, None]
    share = np.maximum(np.abs(direction), 1e-9)
    feed_mm_s = np.maximum(toolpath.feed_mm_min, 1.0) / 60.0
    top_mm_s = np.minimum(feed_mm_s, (limits.max_feed_mm_s / share).min(axis=1))
    acceleration_mm_s2 = np.minimum(
        limits.acceleration_mm_s2, (limits.max_acceleration_mm_s2 / share).min(axis=1)
    )
    gain_mm2_s2 = 2.0 * acceleration_mm_s2 * length_mm  # largest change of the squared speed over a move
    junction_mm2_s2 = _limit_junctions(direction * top_mm_s[:, None], top_mm_s, limits.jerk_mm_s) ** 2
    for _ in range(_JUNCTION_PASSES):
        junction_mm2_s2[1:] = np.minimum(junction_mm2_s2[1:], junction_mm2_s2[:-1] + gain_mm2_s2)
        junction_mm2_s2[:-1] = np.minimum(junction_mm2_s2[:-1], junction_mm2_s2[1:] + gain_mm2_s2)
    entry_mm2_s2, exit_mm2_s2 = junction_mm2_s2[:-1], junction_mm2_s2[1:]
    peak_mm_s = np.minimum(
        top_mm_s,
        np.sqrt(
            np.maximum(
                (gain_mm2_s2 + entry_mm2_s2 + exit_mm2_s2) / 2.0, np.maximum(entry_mm2_s2, exit_mm2_s2)
            )
        ),
    )
    ramps_mm = np.maximum(2.0 * peak_mm_s**2 - entry_mm2_s2 - exit_mm2_s2, 0.0) / (2.0 * acceleration_mm_s2)
    ramps_s = (2.0 * peak_mm_s - np.sqrt(entry_mm2_s2) - np.sqrt(exit_mm2_s2)) / acceleration_mm_s2
    seconds: Floats = ramps_s + np.maximum(length_mm - ramps_mm, 0.0) / peak_mm_s
    return np.where(np.any(delta_mm != 0.0, axis=1), seconds, 0.0)


def _limit_junctions(velocity_mm_s: Floats, top_mm_s: Floats, jerk_mm_s: Floats) -> Floats:
    """Compute the highest speeds (n + 1,) before, between and after moves; X and Y share one jerk."""
    change_mm_s = np.abs(np.diff(velocity_mm_s, axis=0))
    change_mm_s[:, 0] = change_mm_s[:, 1] = np.hypot(change_mm_s[:, 0], change_mm_s[:, 1])
    share = np.minimum(1.0, (jerk_mm_s / np.maximum(change_mm_s, 1e-9)).min(axis=1))
    between_mm_s = np.minimum(top_mm_s[:-1], top_mm_s[1:]) * share
    return np.concatenate(([_STANDSTILL_MM_S], between_mm_s, [_STANDSTILL_MM_S]))
