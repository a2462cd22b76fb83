"""Time that passes only while an event loop waits: days of timers in a moment."""

import asyncio
import selectors
from datetime import datetime

APSCHEDULER = ("apscheduler.schedulers.base", "apscheduler.triggers.interval", "apscheduler.executors.base")


class FakeTime:
    """A clock and an event loop that live on one time, in seconds since the epoch; APScheduler too."""

    scale = 1.0

    def __init__(self, monkeypatch, now_s):
        self.now_s = self.begun_s = now_s
        time = self

        class Datetime(datetime):
            @classmethod
            def now(cls, tz=None):
                return datetime.fromtimestamp(time.now_s, tz)

        for module in APSCHEDULER:
            monkeypatch.setattr(f"{module}.datetime", Datetime)

        async def at_once(work, *args):
            return work(*args)

        monkeypatch.setattr("asyncio.to_thread", at_once)

    def now(self):
        return self.now_s

    def wall(self, farm_s):
        return farm_s

    def stall(self, seconds):
        """The process stands still, as when its host sleeps or swaps."""
        self.now_s += seconds

    def run(self, work):
        """Run a coroutine to its end."""
        loop = asyncio.SelectorEventLoop(_Patient(self))
        loop.time = lambda: self.now_s - self.begun_s
        try:
            return loop.run_until_complete(work)
        finally:
            loop.close()


class _Patient(selectors.SelectSelector):
    """What waits for files, and lets time pass instead."""

    def __init__(self, time):
        super().__init__()
        self._time = time

    def select(self, timeout=None):
        ready = super().select(0)
        if not ready:
            assert timeout is not None, "nothing will ever happen"
            self._time.now_s += timeout
        return ready
