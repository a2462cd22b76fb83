"""The farm's one clock: wall time, or a multiple of it where every printer is simulated.

Daemon, agents, emulators and timers all read this clock, so attended hours, time-outs, `eta` and the dead-man
mean the same everywhere, and a night can run in minutes.

Nobody's setting of the host's clock may end a heat-up or a print by its time-outs: a process reads the wall's
time once, and goes on by the time since the host was started, which also counts while the host sleeps. The
daemon keeps hours, and takes a step over (`Clock.follow_host`); agents keep time-outs, and never do.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


def wall_s() -> float:
    """Wall time in seconds since the epoch, as it was when this process began and steady from then on."""
    return _BOOTED_S + time.clock_gettime(time.CLOCK_BOOTTIME)


_BOOTED_S = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)
_LEAST_STEP_S = 1.0  # smaller ones add up until they are as large


@dataclass(slots=True)
class Clock:
    """Maps wall time to farm time: ``farm = anchor_s + (wall - anchor_s) * scale + ahead_s``.

    "Wall time" is that of `wall_s`: steady within a process.

    Parameters
    ----------
    scale
        Farm seconds in a wall second; 1 on real printers.
    anchor_s
        The moment (seconds since the epoch) at which both clocks agreed.
    ahead_s
        How far the host's clock was set ahead since this process began, as far as `follow_host` took it over.
    """

    scale: float = 1.0
    anchor_s: float = 0.0
    ahead_s: float = 0.0

    def follow_host(self) -> float:
        """Take over that the host's clock was set, and return by how many seconds; 0 where it was not.

        A clock of another scale than 1 belongs to simulated printers, shows no host's time and never steps.
        """
        step_s = time.time() - wall_s() - self.ahead_s
        if self.scale != 1.0 or abs(step_s) < _LEAST_STEP_S:
            return 0.0
        self.ahead_s += step_s
        return step_s

    def now(self) -> float:
        """Farm time in seconds since the epoch."""
        return self.farm(wall_s())

    def farm(self, wall_s: float) -> float:
        """Farm time of a wall time, both in seconds since the epoch."""
        return self.anchor_s + (wall_s - self.anchor_s) * self.scale + self.ahead_s

    def wall(self, farm_s: float) -> float:
        """Wall time of a farm time, both in seconds since the epoch."""
        return self.anchor_s + (farm_s - self.ahead_s - self.anchor_s) / self.scale

    def wall_seconds(self, farm_seconds: float) -> float:
        """Convert a span of farm seconds to wall seconds."""
        return farm_seconds / self.scale
