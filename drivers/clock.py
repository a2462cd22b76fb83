"""The farm's one clock: wall time, or a multiple of it where every printer is simulated.

Daemon, agents, emulators and timers all read this clock, so attended hours, time-outs, `eta` and the dead-man
mean the same everywhere, and a night can run in minutes.

Nobody's setting of the host's clock may end a heat-up or a print by its time-outs: a process reads the wall's
time once, and goes on by the time since the host was started, which also counts while the host sleeps.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


def wall_s() -> float:
    """Wall time in seconds since the epoch, as it was when this process began and steady from then on."""
    return _BOOTED_S + time.clock_gettime(time.CLOCK_BOOTTIME)


_BOOTED_S = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


@dataclass(frozen=True, slots=True)
class Clock:
    """Maps wall time to farm time: ``farm = anchor_s + (wall - anchor_s) * scale``.

    Parameters
    ----------
    scale
        Farm seconds in a wall second; 1 on real printers.
    anchor_s
        The moment (seconds since the epoch) at which both clocks agreed.
    """

    scale: float = 1.0
    anchor_s: float = 0.0

    def now(self) -> float:
        """Farm time in seconds since the epoch."""
        return self.farm(wall_s())

    def farm(self, wall_s: float) -> float:
        """Farm time of a wall time, both in seconds since the epoch."""
        return self.anchor_s + (wall_s - self.anchor_s) * self.scale

    def wall(self, farm_s: float) -> float:
        """Wall time of a farm time, both in seconds since the epoch."""
        return self.anchor_s + (farm_s - self.anchor_s) / self.scale

    def wall_seconds(self, farm_seconds: float) -> float:
        """How many wall seconds a span of farm seconds takes."""
        return farm_seconds / self.scale
