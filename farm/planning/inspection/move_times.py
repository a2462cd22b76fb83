"""Time of moves on a printer, for a person's own G-code."""

from __future__ import annotations

from drivers.emulator.firmware.planner import CAPACITY, Limits, Planner
from drivers.printers import Profile


class FirmwareTime:
    """Stopwatch for moves that never wait for the host, by the planner of the firmware."""

    def __init__(self, profile: Profile) -> None:
        self._planner = Planner(Limits.of(profile), (*profile.ready_mm, 0.0), lambda _e_mm, _z_mm: None)
        self._now_s = 0.0

    def move(self, x: float, y: float, z: float, e: float, speed_mm_s: float) -> None:
        """Add a move to a position in mm."""
        planner = self._planner
        if len(planner) >= CAPACITY:
            self._now_s = planner.free_s()
            planner.advance(self._now_s)
        planner.add((x, y, z, e), speed_mm_s, self._now_s)

    def wait(self, seconds: float) -> None:
        """Add a pause after all moves."""
        self._now_s = self.seconds(finish=True) + seconds

    def seconds(self, finish: bool = False) -> float:
        """Return the time so far; with `finish`, until the last move has ended."""
        while finish and len(self._planner):
            self._now_s = self._planner.end_s
            self._planner.advance(self._now_s)
        return self._now_s
