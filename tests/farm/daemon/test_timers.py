"""Timers on the event loop."""

from __future__ import annotations

import asyncio
import threading

import pytest

from farm.daemon.timers import Timers


@pytest.mark.parametrize("plain", [True, False])
def test_work_runs_on_the_event_loop(plain):
    """The daemon's state belongs to one thread: a timer in another would change it in mid-turn."""

    async def run() -> threading.Thread:
        ran: asyncio.Future[threading.Thread] = asyncio.get_running_loop().create_future()

        def work() -> None:
            if not ran.done():
                ran.get_loop().call_soon_threadsafe(ran.set_result, threading.current_thread())

        async def patient_work() -> None:
            work()

        timers = Timers()
        timers.every(0.01, "work", work if plain else patient_work)
        timers.start()
        try:
            return await ran
        finally:
            timers.stop()

    assert asyncio.run(run()) is threading.current_thread()
