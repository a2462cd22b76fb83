"""Seconds of each kind of line in G-code, with acceleration and jerk as CuraEngine plans them.

Each layer starts and ends at a stop. A retraction counts separately, and a move without filament counts as
travel. Speeds are propagated over all moves, as in CuraEngine; `slicing.checks.feature_times` is an estimate
from the few moves around each junction.
"""

from __future__ import annotations

import re

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit

ACCELERATION_MM_S2 = 3000.0
MAX_ACCELERATION_MM_S2 = np.array([9000.0, 9000.0, 100.0, 10000.0])
MAX_FEED_MM_S = np.array([300.0, 300.0, 40.0, 45.0])
JERK_MM_S = np.array([20.0, 20.0, 0.4, 5.0])
STANDSTILL_MM_S = 0.05

KINDS = (
    "travel",
    "retraction",
    "SKIRT",
    "WALL-OUTER",
    "WALL-INNER",
    "SKIN",
    "FILL",
    "SUPPORT",
    "SUPPORT-INTERFACE",
)
_WORD = re.compile(r"([XYZEF])(-?[\d.]+)")


def compute_times_by_kind_s(gcode: str) -> dict[str, float]:
    """Compute the time of each kind of move, keyed by its name in `KINDS`."""
    moves, kinds, stops = read_moves(gcode)
    seconds = plan_moves_s(moves, stops)
    first_stop = stops[0]
    sums = np.bincount(kinds[first_stop:], weights=seconds[first_stop:], minlength=len(KINDS))
    return dict(zip(KINDS, sums.tolist(), strict=True))


def read_moves(gcode: str) -> tuple[Floats, Ints, Ints]:
    """Read the moves (n, 5) for `plan_moves_s`, the index of each in `KINDS` (n,), and the stops."""
    position, feed_mm_s, kind = dict.fromkeys("XYZE", 0.0), 1.0, 0
    moves, kinds, stops = [], [], []
    for line in gcode.splitlines():
        if line.startswith(("G0 ", "G1 ")):
            values = {letter: float(value) for letter, value in _WORD.findall(line)}
            feed_mm_s = values.pop("F", 60.0 * feed_mm_s) / 60.0
            delta = [values.get(axis, position[axis]) - position[axis] for axis in "XYZE"]
            position.update(values)
            if any(delta):
                moves.append((*delta, feed_mm_s))
                is_still = delta[0] == delta[1] == 0.0
                kinds.append(1 if is_still and delta[3] else kind if delta[3] > 0.0 else 0)
        elif line.startswith("G92 "):
            position.update({letter: float(value) for letter, value in _WORD.findall(line)})
        elif line.startswith(";TYPE:"):
            kind = KINDS.index(line[6:])
        elif line.startswith(";LAYER:"):
            stops.append(len(moves))
    stops.append(len(moves))
    return np.array(moves), np.array(kinds), np.array(stops)


@jit
def plan_moves_s(moves: Floats, stops: Ints) -> Floats:
    """Plan moves (n, 5) of dx, dy, dz, de in mm and a feed in mm/s; return their seconds (n,).

    Parameters
    ----------
    stops
        Indices of moves that begin at a stop.
    """
    n = len(moves)
    length_mm, nominal_mm_s, acceleration_mm_s2 = np.zeros(n), np.zeros(n), np.zeros(n)
    limit_mm_s, entry_mm_s, seconds = np.zeros(n), np.zeros(n), np.zeros(n)
    speed_mm_s, previous_speed_mm_s = np.zeros(4), np.zeros(4)
    stop, last_mm_s = 0, 0.0
    for i in range(n):
        d = moves[i, :4]
        length_mm[i] = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
        if length_mm[i] == 0.0:
            length_mm[i] = abs(d[3])
        factor, limit_mm_s2 = 1.0, ACCELERATION_MM_S2
        for axis in range(4):
            speed_mm_s[axis] = d[axis] * moves[i, 4] / length_mm[i]
            if abs(speed_mm_s[axis]) > MAX_FEED_MM_S[axis]:
                factor = min(factor, MAX_FEED_MM_S[axis] / abs(speed_mm_s[axis]))
        for axis in range(4):
            speed_mm_s[axis] *= factor
            if limit_mm_s2 * abs(d[axis]) / length_mm[i] > MAX_ACCELERATION_MM_S2[axis]:
                limit_mm_s2 = MAX_ACCELERATION_MM_S2[axis] * length_mm[i] / abs(d[axis])
        nominal_mm_s[i], acceleration_mm_s2[i] = moves[i, 4] * factor, limit_mm_s2
        junction_mm_s, share = JERK_MM_S[0] / 2.0, 1.0
        if abs(speed_mm_s[2]) > JERK_MM_S[2] / 2.0:
            junction_mm_s = min(junction_mm_s, JERK_MM_S[2] / 2.0)
        if abs(speed_mm_s[3]) > JERK_MM_S[3] / 2.0:
            junction_mm_s = min(junction_mm_s, JERK_MM_S[3] / 2.0)
        junction_mm_s = min(junction_mm_s, nominal_mm_s[i])
        while stop < len(stops) and stops[stop] < i:
            stop += 1
        is_at_rest = i == 0 or (stop < len(stops) and stops[stop] == i)
        if not is_at_rest and last_mm_s > 0.0001:
            jerk_mm_s = np.sqrt(
                (speed_mm_s[0] - previous_speed_mm_s[0]) ** 2 + (speed_mm_s[1] - previous_speed_mm_s[1]) ** 2
            )
            if jerk_mm_s > JERK_MM_S[0]:
                share = JERK_MM_S[0] / jerk_mm_s
            for axis in (2, 3):
                change_mm_s = abs(speed_mm_s[axis] - previous_speed_mm_s[axis])
                if change_mm_s > JERK_MM_S[axis]:
                    share = min(share, JERK_MM_S[axis] / change_mm_s)
            junction_mm_s = min(last_mm_s, nominal_mm_s[i] * share)
        limit_mm_s[i] = STANDSTILL_MM_S if is_at_rest else junction_mm_s
        last_mm_s = nominal_mm_s[i]
        previous_speed_mm_s[:] = speed_mm_s
    next_mm_s = STANDSTILL_MM_S
    for i in range(n - 1, -1, -1):
        entry_mm_s[i] = min(limit_mm_s[i], np.sqrt(next_mm_s**2 + 2.0 * acceleration_mm_s2[i] * length_mm[i]))
        next_mm_s = entry_mm_s[i]
    for i in range(n):
        if i > 0:
            reached_mm_s = np.sqrt(
                entry_mm_s[i - 1] ** 2 + 2.0 * acceleration_mm_s2[i - 1] * length_mm[i - 1]
            )
            entry_mm_s[i] = min(entry_mm_s[i], reached_mm_s)
    for i in range(n):
        exit_mm_s = entry_mm_s[i + 1] if i + 1 < n else STANDSTILL_MM_S
        a, v = acceleration_mm_s2[i], nominal_mm_s[i]
        ramps_mm = (2.0 * v * v - entry_mm_s[i] ** 2 - exit_mm_s**2) / (2.0 * a)
        if ramps_mm <= length_mm[i]:
            seconds[i] = (2.0 * v - entry_mm_s[i] - exit_mm_s) / a + (length_mm[i] - ramps_mm) / v
        else:
            top_mm_s = np.sqrt(
                max(
                    a * length_mm[i] + (entry_mm_s[i] ** 2 + exit_mm_s**2) / 2.0,
                    max(entry_mm_s[i], exit_mm_s) ** 2,
                )
            )
            seconds[i] = (2.0 * top_mm_s - entry_mm_s[i] - exit_mm_s) / a
    return seconds
