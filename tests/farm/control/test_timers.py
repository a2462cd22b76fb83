"""Timers on the event loop."""

from __future__ import annotations

import asyncio
import threading

import pytest

from drivers.clock import Clock
from farm.control.timers import Timers


@pytest.mark.parametrize("is_synchronous", [True, False])
def test_work_runs_on_the_event_loop(is_synchronous):
    """Check the thread, because a timer in another thread would change the daemon's state concurrently."""

    async def run() -> threading.Thread:
        result: asyncio.Future[threading.Thread] = asyncio.get_running_loop().create_future()

        def record_thread() -> None:
            if not result.done():
                result.get_loop().call_soon_threadsafe(result.set_result, threading.current_thread())

        async def record_thread_later() -> None:
            record_thread()

        timers = Timers(Clock())
        timers.call_every(0.01, "work", record_thread if is_synchronous else record_thread_later)
        timers.start()
        try:
            return await result
        finally:
            timers.stop()

    assert asyncio.run(run()) is threading.current_thread()


def test_late_timer_runs_once_and_a_timer_can_be_moved():
    async def run() -> list[str]:
        result: list[str] = []
        done = asyncio.Event()
        timers = Timers(Clock())
        timers.call_at(0.0, "long ago", lambda: result.append("long ago"))
        timers.call_at(4e9, "moved", lambda: result.append("far"))
        timers.start()
        timers.call_at(1.0, "moved", lambda: (result.append("near"), done.set()))
        try:
            await done.wait()
        finally:
            timers.stop()
        return result

    assert asyncio.run(run()) == ["long ago", "near"]
