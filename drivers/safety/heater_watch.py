"""Heater watch: it compares both heaters with their targets at every report. Pure.

It finds faults that the firmware misses or ignores (docs/explanation/ultimaker2-serial.md, section 3.2): an
M109 that would succeed with a dead heater, an M190 that would wait forever, a heater that fails during a
print, and a heater that still heats when off. Reports have no checksum, so every value is the median of
three. At most `MAX_GAP_S` between two reports counts, as a longer gap is not a fault: reports wait behind
long moves, and the host may sleep.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from statistics import median

from drivers.errors import Fault
from drivers.gcode import HeaterName
from drivers.link import Report

MIN_PROGRESS_C = 1.0  # minimum progress within `HeaterRule.stall_timeout_s`
MAX_GAP_S = 15.0
# A heater is stuck on if it has risen by this much after this time without power: [assumed] to exceed any
# overshoot.
STUCK_RISE_C, MIN_OFF_S = 10.0, 10.0
# Below any room temperature: the reading of a shorted bed sensor, which the firmware does not report.
BROKEN_SENSOR_C = 0.0


@dataclass(frozen=True, slots=True)
class HeaterRule:
    """Limits of a healthy heater. [assumed; those of the nozzle allow for the part cooling fan]

    Attributes
    ----------
    band_c
        Distance from the target within which the target counts as reached.
    stall_timeout_s
        Time within which the heater must come `MIN_PROGRESS_C` nearer to a target that is not reached.
    max_deviation_c, max_deviation_s
        Maximum distance from a reached target, and the maximum time for which the heater may exceed it.
    cold_threshold_c
        Temperature below which a heater counts as off, since it may not cool any further.
    min_cooling_c, cooling_timeout_s
        Degrees by which a heater that was switched off above `cold_threshold_c` must cool, which proves that
        it is off, and the time for that.
    """

    band_c: float
    stall_timeout_s: float
    max_deviation_c: float
    max_deviation_s: float
    cold_threshold_c: float
    min_cooling_c: float
    cooling_timeout_s: float


RULES = {
    HeaterName.NOZZLE: HeaterRule(3.0, 60.0, 10.0, 30.0, 50.0, 2.0, 90.0),
    HeaterName.BED: HeaterRule(2.0, 150.0, 6.0, 120.0, 45.0, 0.5, 90.0),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """Fault of a heater.

    Attributes
    ----------
    fault
        The fault.
    text
        User-facing clause.
    is_off
        True if the target is 0 already: no command can switch the heater off.
    """

    fault: Fault
    text: str
    is_off: bool = False


class HeaterWatch:
    """Watch over both heaters during a print, from the cold start until they have cooled.

    Parameters
    ----------
    min_duration_s
        Lower bound of the times in every rule, in seconds: with an accelerated clock, the host's scheduling
        must not look like a fault.
    """

    def __init__(self, min_duration_s: float) -> None:
        self._gap_s = max(MAX_GAP_S, min_duration_s / 4)
        self._reported_s = math.nan
        self._watched_s = 0.0  # seconds covered by reports
        self._heaters = {name: _Heater(name, rule, min_duration_s) for name, rule in RULES.items()}

    def judge_report(
        self, report: Report, expected_targets_c: dict[HeaterName, float], now_s: float
    ) -> Finding | None:
        """Judge a report.

        Parameters
        ----------
        report
            The report.
        expected_targets_c
            Target that the farm has set for each heater.
        now_s
            Time of the report, in seconds of a monotonic clock.

        Returns
        -------
        Finding or None
            The first fault found.
        """
        if not math.isnan(self._reported_s):
            self._watched_s += min(max(now_s - self._reported_s, 0.0), self._gap_s)
        self._reported_s = now_s
        reported_c = {
            HeaterName.NOZZLE: (report.nozzle_c, report.nozzle_target_c),
            HeaterName.BED: (report.bed_c, report.bed_target_c),
        }
        findings = [
            heater.check(*reported_c[name], expected_targets_c[name], self._watched_s)
            for name, heater in self._heaters.items()
        ]
        return next((finding for finding in findings if finding is not None), None)

    def compute_median_c(self, name: HeaterName) -> float:
        """Compute the median of the last three reports; NaN before the first."""
        return self._heaters[name].current_c

    @property
    def is_cooling(self) -> bool:
        """True if both heaters are off, and each was seen cooling or cold since then."""
        return all(heater.is_cooling for heater in self._heaters.values())

    def reset(self) -> None:
        """Reset the observations, as both heaters have just been switched off."""
        for heater in self._heaters.values():
            heater.reset()


class _Heater:
    """Observations of one heater since its target was set."""

    def __init__(self, name: HeaterName, rule: HeaterRule, min_duration_s: float) -> None:
        self._name, self._rule, self._min_duration_s = name, rule, min_duration_s
        self._last_readings_c: deque[float] = deque(maxlen=3)
        self._rise_detector = _RiseDetector(rule, min_duration_s)
        self.set_target(0.0)

    def reset(self) -> None:
        """Reset the observations, as the heater has just been switched off."""
        self._last_readings_c.clear()
        self.set_target(0.0)

    def set_target(self, expected_target_c: float) -> None:
        """Set the target to compare with."""
        self.is_cooling = False
        self._expected_target_c = expected_target_c
        self._is_reached = False
        self._since_s = math.nan  # time of the first report after the target was set
        self._min_distance_c, self._progress_s = math.inf, math.nan
        self._off_target_since_s = math.inf  # time at which it left the range around the target
        self._hottest_c = -math.inf  # since the heater was switched off
        self._coolest_c = math.inf  # since the heater was seen to cool

    @property
    def current_c(self) -> float:
        """Median of the last three readings; NaN before the first."""
        return median(self._last_readings_c) if self._last_readings_c else math.nan

    def check(
        self, reading_c: float, reported_target_c: float, expected_target_c: float, now_s: float
    ) -> Finding | None:
        """Check a reading, and return the fault that it shows, if any."""
        self._last_readings_c.append(reading_c)
        if expected_target_c != self._expected_target_c:
            self.set_target(expected_target_c)
        if math.isnan(self._since_s):
            self._since_s = now_s
        if len(self._last_readings_c) < 3:
            return None
        current_c = self.current_c
        rises = self._rise_detector.check(current_c, max(reported_target_c, expected_target_c), now_s)
        if current_c <= BROKEN_SENSOR_C:
            self.is_cooling = False
            return self._make_finding(Fault.MINTEMP, f"reads {current_c:g} C: its sensor is broken")
        if expected_target_c == 0.0:
            if rises:
                self.is_cooling = False
                start_c = self._rise_detector.coolest_c
                return self._make_stuck_finding(
                    f"is off, but is getting hotter: from {start_c:g} to {current_c:g} C"
                )
            return self._check_off(current_c, now_s)
        if abs(current_c - expected_target_c) <= self._rule.band_c:
            self._is_reached = True
        return (
            self._check_hold(current_c, now_s) if self._is_reached else self._check_approach(current_c, now_s)
        )

    def _check_approach(self, current_c: float, now_s: float) -> Finding | None:
        distance_c = abs(current_c - self._expected_target_c)
        if distance_c < self._min_distance_c - MIN_PROGRESS_C:
            self._min_distance_c, self._progress_s = distance_c, now_s
        elif now_s - self._progress_s > max(self._rule.stall_timeout_s, self._min_duration_s):
            if current_c > self._expected_target_c:
                return self._make_finding(
                    Fault.HEATER_STUCK_ON, f"stays at {current_c:g} C, above {self._expected_target_c:g}"
                )
            progress_text = f"reached only {current_c:g} of {self._expected_target_c:g} C"
            return self._make_finding(Fault.HEATER_TIMEOUT, progress_text)
        return None

    def _check_hold(self, current_c: float, now_s: float) -> Finding | None:
        if abs(current_c - self._expected_target_c) <= self._rule.max_deviation_c:
            self._off_target_since_s = math.inf
            return None
        self._off_target_since_s = min(self._off_target_since_s, now_s)
        if now_s - self._off_target_since_s <= max(self._rule.max_deviation_s, self._min_duration_s):
            return None
        if current_c > self._expected_target_c:
            return self._make_finding(
                Fault.HEATER_STUCK_ON, f"went up to {current_c:g} C, above {self._expected_target_c:g}"
            )
        return self._make_finding(
            Fault.THERMAL_RUNAWAY, f"fell from {self._expected_target_c:g} to {current_c:g} C"
        )

    def _check_off(self, current_c: float, now_s: float) -> Finding | None:
        rule = self._rule
        if self.is_cooling:
            self._coolest_c = max(rule.cold_threshold_c, min(self._coolest_c, current_c))
            if current_c > self._coolest_c + rule.max_deviation_c:  # more than the other heater can cause
                self.is_cooling, self._since_s, self._hottest_c = False, now_s, current_c
        elif current_c < rule.cold_threshold_c or current_c <= self._hottest_c - rule.min_cooling_c:
            self.is_cooling, self._coolest_c = True, current_c
        else:
            self._hottest_c = max(self._hottest_c, current_c)
            if now_s - self._since_s > max(rule.cooling_timeout_s, self._min_duration_s):
                return self._make_stuck_finding(f"is off, and does not cool from {current_c:g} C")
        return None

    def _make_stuck_finding(self, detail: str) -> Finding:
        return replace(self._make_finding(Fault.HEATER_STUCK_ON, detail), is_off=True)

    def _make_finding(self, fault: Fault, detail: str) -> Finding:
        return Finding(fault, f"the {self._name} {detail}")


class _RiseDetector:
    """Detector of a heater that gets hotter after it was switched off.

    Time counts from the first report that shows the target 0, so that a command on its way is not a fault. A
    reset of the board does not restart it.
    """

    def __init__(self, rule: HeaterRule, min_duration_s: float) -> None:
        self._cold_threshold_c, self._min_off_s = rule.cold_threshold_c, max(MIN_OFF_S, min_duration_s)
        self._last_targets_c: deque[float] = deque(maxlen=3)
        self._since_s = math.nan
        self.coolest_c = math.inf  # since a report showed the target 0

    def check(self, current_c: float, target_c: float, now_s: float) -> bool:
        """Return True if this report shows that the heater is stuck on."""
        self._last_targets_c.append(target_c)
        if median(self._last_targets_c) != 0.0:
            self._since_s, self.coolest_c = math.nan, math.inf
            return False
        if math.isnan(self._since_s):
            self._since_s = now_s
        self.coolest_c = min(self.coolest_c, current_c)
        is_hotter = current_c > max(self._cold_threshold_c, self.coolest_c) + STUCK_RISE_C
        return is_hotter and now_s - self._since_s >= self._min_off_s
