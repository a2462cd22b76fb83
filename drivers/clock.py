"""The farm's clock: wall time, or a multiple of it if every printer is simulated.

Daemon, agents, emulators and timers all read this clock, so attended hours, timeouts, forecasts and the
dead-man timer agree everywhere, and a simulated night can run in minutes.

A change of the host's clock must not end a heat-up or a print by a timeout: a process reads wall time once
and adds the time since boot, which also advances while the host sleeps. The daemon, which enforces attended
hours, follows such a change (`Clock.follow_host`); agents, which enforce timeouts, never do.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


def read_wall_s() -> float:
    """Return wall time in seconds since the epoch, unaffected by changes of the host's clock."""
    return _BOOT_TIME_S + time.clock_gettime(time.CLOCK_BOOTTIME)


_BOOT_TIME_S = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)
_SMALLEST_STEP_S = 1.0  # smaller changes add up until they reach this size


@dataclass(slots=True)
class Clock:
    """Conversion of wall time to farm time: ``farm = anchor_s + (wall - anchor_s) * scale + host_shift_s``.

    Wall time comes from `read_wall_s`.

    Attributes
    ----------
    scale
        Farm seconds per wall second; 1 on real printers.
    anchor_s
        Time at which both clocks agreed, in seconds since the epoch.
    host_shift_s
        Seconds by which the host's clock was set ahead since this process began, as found by `follow_host`.
    """

    scale: float = 1.0
    anchor_s: float = 0.0
    host_shift_s: float = 0.0

    def follow_host(self) -> float:
        """Follow a change of the host's clock, and return its size in seconds; 0 without a change.

        A clock with a scale other than 1 belongs to simulated printers, and never follows.
        """
        step_s = time.time() - read_wall_s() - self.host_shift_s
        if self.scale != 1.0 or abs(step_s) < _SMALLEST_STEP_S:
            return 0.0
        self.host_shift_s += step_s
        return step_s

    def now(self) -> float:
        """Return farm time in seconds since the epoch."""
        return self.to_farm_s(read_wall_s())

    def to_farm_s(self, wall_s: float) -> float:
        """Convert a wall time to farm time, both in seconds since the epoch."""
        return self.anchor_s + (wall_s - self.anchor_s) * self.scale + self.host_shift_s

    def to_wall_s(self, farm_s: float) -> float:
        """Convert a farm time to wall time, both in seconds since the epoch."""
        return self.anchor_s + (farm_s - self.host_shift_s - self.anchor_s) / self.scale

    def to_wall_duration_s(self, farm_duration_s: float) -> float:
        """Convert a duration in farm seconds to wall seconds."""
        return farm_duration_s / self.scale
