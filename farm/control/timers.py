"""Timers based on APScheduler, in memory only; the daemon sets them again at each start.

APScheduler uses the host's clock; after that clock is set, `on_clock_set` recalculates every timer.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime, timedelta

from apscheduler.executors.asyncio import AsyncIOExecutor
from apscheduler.schedulers.asyncio import AsyncIOScheduler
from apscheduler.triggers.date import DateTrigger
from apscheduler.triggers.interval import IntervalTrigger

from drivers.clock import Clock


class Timers:
    """Timers that call functions on the event loop, at real-time intervals or once at a farm time."""

    def __init__(self, clock: Clock) -> None:
        # If the loop is blocked, a timer is delayed but never dropped; several missed calls become one.
        defaults = {"misfire_grace_time": None, "coalesce": True, "max_instances": 1}
        self._scheduler = AsyncIOScheduler(executors={"default": AsyncIOExecutor()}, job_defaults=defaults)
        self._clock = clock
        self._times_s: dict[str, float] = {}  # farm times of the timers set by `call_at`

    def call_every(self, interval_s: float, name: str, callback: Callable[[], object]) -> None:
        """Call a function, plain or async, at an interval in wall seconds until the timers are stopped."""
        trigger = IntervalTrigger(seconds=interval_s)
        self._scheduler.add_job(_wrap_coroutine(callback), trigger, id=name, replace_existing=True)

    def call_at(self, at_s: float, name: str, callback: Callable[[], object]) -> None:
        """Call a function once at a farm time, or later if that time is missed.

        A timer of the same name is replaced.
        """
        self._times_s[name] = at_s
        self._scheduler.add_job(
            _wrap_coroutine(callback), self._make_trigger(at_s), id=name, replace_existing=True
        )

    def on_clock_set(self) -> None:
        """Recalculate all timers after the host's clock was set; a clock set back would delay them."""
        for job in self._scheduler.get_jobs():
            trigger = job.trigger
            if isinstance(trigger, DateTrigger):
                trigger = self._make_trigger(self._times_s[job.id])
            elif isinstance(trigger, IntervalTrigger):
                trigger = IntervalTrigger(seconds=trigger.interval_length)
            job.reschedule(trigger)

    def _make_trigger(self, at_s: float) -> DateTrigger:
        """Return a trigger for a farm time, converted to the host's clock."""
        delay = timedelta(seconds=self._clock.to_wall_duration_s(at_s - self._clock.now()))
        return DateTrigger(datetime.now(UTC) + delay)

    def start(self) -> None:
        self._scheduler.start()

    def stop(self) -> None:
        self._scheduler.shutdown(wait=False)


def _wrap_coroutine(callback: Callable[[], object]) -> Callable[[], Awaitable[None]]:
    """Wrap a function in a coroutine function, because APScheduler would run a plain one in a thread."""

    async def run() -> None:
        result = callback()
        if inspect.isawaitable(result):
            await result

    return run
