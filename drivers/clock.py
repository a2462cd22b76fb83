"""The farm's one clock: wall time, or a multiple of it where every printer is simulated.

Daemon, agents, emulators and timers all read this clock, so attended hours, time-outs, `eta` and the dead-man
mean the same everywhere, and a night can run in minutes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass


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
        return self.farm(time.time())

    def farm(self, wall_s: float) -> float:
        """Farm time of a wall time, both in seconds since the epoch."""
        return self.anchor_s + (wall_s - self.anchor_s) * self.scale

    def wall(self, farm_s: float) -> float:
        """Wall time of a farm time, both in seconds since the epoch."""
        return self.anchor_s + (farm_s - self.anchor_s) / self.scale

    def wall_seconds(self, farm_seconds: float) -> float:
        """How many wall seconds a span of farm seconds takes."""
        return farm_seconds / self.scale
