"""Wake-ups on APScheduler (its word "job" stays in this file), in memory: each is set anew at start."""

from __future__ import annotations

import inspect
from collections.abc import Callable

from apscheduler.executors.asyncio import AsyncIOExecutor
from apscheduler.schedulers.asyncio import AsyncIOScheduler
from apscheduler.triggers.interval import IntervalTrigger


class Timers:
    """Runs functions on the daemon's event loop at wall-clock intervals."""

    def __init__(self) -> None:
        # A stalled loop delays a timer, it never drops one; several missed turns are made up by one.
        defaults = {"misfire_grace_time": None, "coalesce": True, "max_instances": 1}
        self._scheduler = AsyncIOScheduler(executors={"default": AsyncIOExecutor()}, job_defaults=defaults)

    def every(self, wall_seconds: float, name: str, work: Callable[[], object]) -> None:
        """Call a function, plain or async, again and again until the timers are stopped."""

        async def on_the_loop() -> None:  # APScheduler runs a plain function in a thread
            done = work()
            if inspect.isawaitable(done):
                await done

        trigger = IntervalTrigger(seconds=wall_seconds)
        self._scheduler.add_job(on_the_loop, trigger, id=name, replace_existing=True)

    def start(self) -> None:
        self._scheduler.start()

    def stop(self) -> None:
        self._scheduler.shutdown(wait=False)
