"""Simulated time that advances only while the event loop waits, so that timers of days fire at once."""

import asyncio
import selectors
from datetime import datetime

HOST_TIME_MODULES = (
    "apscheduler.schedulers.base",
    "apscheduler.triggers.interval",
    "apscheduler.executors.base",
    "farm.control.timers",
)


class FakeTime:
    """Simulated time of a clock, an event loop and APScheduler, in seconds since the epoch.

    A test sets the offset of the host's clock, `host_offset_s`; `host_shift_s` is the offset that the farm's
    clock has adopted.
    """

    scale = 1.0
    host_shift_s = 0.0
    host_offset_s = 0.0

    def __init__(self, monkeypatch, now_s):
        self.now_s = self.started_s = now_s
        clock = self

        class Datetime(datetime):
            @classmethod
            def now(cls, tz=None):
                return datetime.fromtimestamp(clock.now_s + clock.host_offset_s, tz)

        for module in HOST_TIME_MODULES:
            monkeypatch.setattr(f"{module}.datetime", Datetime)

        async def run_in_place(work, *args):
            return work(*args)

        monkeypatch.setattr("asyncio.to_thread", run_in_place)

    def now(self):
        return self.now_s + self.host_shift_s

    def to_wall_duration_s(self, farm_duration_s):
        return farm_duration_s

    def follow_host(self):
        step_s, self.host_shift_s = self.host_offset_s - self.host_shift_s, self.host_offset_s
        return step_s

    def stall(self, seconds):
        """Advance the time without running timers, as if the host slept or swapped."""
        self.now_s += seconds

    def run(self, work):
        """Run a coroutine to its end."""
        loop = asyncio.SelectorEventLoop(_ClockSelector(self))
        loop.time = lambda: self.now_s - self.started_s
        try:
            return loop.run_until_complete(work)
        finally:
            loop.close()


class _ClockSelector(selectors.SelectSelector):
    """A selector that advances the clock instead of waiting."""

    def __init__(self, clock):
        super().__init__()
        self._clock = clock

    def select(self, timeout=None):
        events = super().select(0)
        if not events:
            assert timeout is not None, "no timer is set"
            self._clock.now_s += timeout
        return events
