"""Wake-ups on APScheduler (its word "job" stays in this file), in memory: each is set anew at start."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime

from apscheduler.executors.asyncio import AsyncIOExecutor
from apscheduler.schedulers.asyncio import AsyncIOScheduler
from apscheduler.triggers.date import DateTrigger
from apscheduler.triggers.interval import IntervalTrigger


class Timers:
    """Runs functions on the daemon's event loop at wall-clock intervals."""

    def __init__(self) -> None:
        # A stalled loop delays a timer, it never drops one; several missed turns are made up by one.
        defaults = {"misfire_grace_time": None, "coalesce": True, "max_instances": 1}
        self._scheduler = AsyncIOScheduler(executors={"default": AsyncIOExecutor()}, job_defaults=defaults)

    def every(self, wall_seconds: float, name: str, work: Callable[[], object]) -> None:
        """Call a function, plain or async, again and again until the timers are stopped."""
        trigger = IntervalTrigger(seconds=wall_seconds)
        self._scheduler.add_job(_on_the_loop(work), trigger, id=name, replace_existing=True)

    def at(self, wall_s: float, name: str, work: Callable[[], object]) -> None:
        """Call a function once at a moment of wall time (since the epoch), late rather than never.

        A timer of the same name is put off or brought forward.
        """
        trigger = DateTrigger(datetime.fromtimestamp(wall_s, UTC))
        self._scheduler.add_job(_on_the_loop(work), trigger, id=name, replace_existing=True)

    def start(self) -> None:
        self._scheduler.start()

    def stop(self) -> None:
        self._scheduler.shutdown(wait=False)


def _on_the_loop(work: Callable[[], object]) -> Callable[[], Awaitable[None]]:
    """As a coroutine function: APScheduler would run a plain one in a thread."""

    async def run() -> None:
        done = work()
        if inspect.isawaitable(done):
            await done

    return run
