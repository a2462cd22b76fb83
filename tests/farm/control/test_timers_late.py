"""Timers in a stalled loop and on nights when clocks change, with a fake clock."""

import asyncio
import itertools
from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

import pytest

from farm.control.timers import Timers
from farm.paths import StateFolder
from farm.state.storage.backups import NightlyBackup, list_backups, parse_backup_time_s
from farm.state.storage.store import Store
from hosts.fake_event_loop_clock import FakeTime

BERLIN = ZoneInfo("Europe/Berlin")
HOUR_S = 3600.0


def parse_time_s(text):
    return datetime.fromisoformat(text).replace(tzinfo=BERLIN).timestamp()


@pytest.fixture
def make_time(monkeypatch):
    def make_time(text):
        return FakeTime(monkeypatch, parse_time_s(text))

    return make_time


def test_missed_timer_runs_once(make_time):
    time = make_time("2026-11-20 22:00")
    times_s, alarms_s = [], []

    def tick():
        times_s.append(time.now_s - time.started_s)
        if len(times_s) == 10:
            time.stall(3 * HOUR_S)

    async def run_evening():
        timers = Timers(time)
        timers.call_every(60.0, "turn", tick)
        for hour in (1.0, 2.0, 6.0):
            timers.call_at(
                time.started_s + hour * HOUR_S, f"alarm {hour}", lambda: alarms_s.append(time.now_s)
            )
        timers.start()
        await asyncio.sleep(7 * HOUR_S - 30.0)
        timers.stop()
        await asyncio.sleep(0)

    time.run(run_evening())
    wake_up_s = 600.0 + 3 * HOUR_S
    assert times_s[:10] == pytest.approx([60.0 * n for n in range(1, 11)], abs=1e-3)
    # One run replaces all missed ones; then the timer continues as before.
    assert wake_up_s <= times_s[10] < times_s[11] <= wake_up_s + 61.0
    assert len(times_s) == 10 + 1 + (7 * HOUR_S - 30.0 - wake_up_s) // 60.0
    assert [alarm_s - time.started_s for alarm_s in alarms_s[:2]] == pytest.approx(
        [wake_up_s, wake_up_s], abs=1.0
    )
    assert alarms_s[2] - time.started_s == pytest.approx(6 * HOUR_S, abs=1e-3)


@pytest.mark.parametrize("step_h", [6.0, -6.0])
def test_clock_step_takes_effect_at_once(make_time, step_h):
    """Check that a periodic timer is late by one period at most, and that an alarm follows the calendar."""
    time = make_time("2026-11-20 12:00")
    times_s, alarms_s = [], []
    alarm_s = time.started_s + 7 * HOUR_S

    async def run_day():
        timers = Timers(time)
        timers.call_every(1.0, "turn", lambda: times_s.append(time.now_s - time.started_s))
        timers.call_at(alarm_s, "alarm", lambda: alarms_s.append(time.now()))
        timers.start()
        await asyncio.sleep(60.5)
        time.host_offset_s = step_h * HOUR_S
        await asyncio.sleep(1.0)
        time.follow_host()
        timers.on_clock_set()
        await asyncio.sleep(14 * HOUR_S)
        timers.stop()
        await asyncio.sleep(0)

    time.run(run_day())
    assert max(next_s - previous_s for previous_s, next_s in itertools.pairwise(times_s)) <= 3.0
    assert alarms_s == pytest.approx([alarm_s], abs=1.0)


@pytest.mark.parametrize(
    "first_day", ["2026-03-27", "2026-10-23", "2026-11-20"], ids=["spring", "autumn", "plain"]
)
@pytest.mark.parametrize("is_suspended", [False, True])
def test_books_are_backed_up_once_a_night(make_time, tmp_path, first_day, is_suspended):
    """Make a backup at 04:00, even when clocks change, or as soon as a suspended host wakes up."""
    time = make_time(f"{first_day} 12:00")
    state = StateFolder(tmp_path)
    Store(state.books).close()
    errors, cleanups = [], []

    async def run_nights():
        timers = Timers(time)
        nightly_backup = NightlyBackup(state, time, BERLIN, timers.call_at, errors.append, cleanups.append)
        timers.start()
        await nightly_backup.begin()
        if is_suspended:
            await asyncio.sleep(parse_time_s(f"{first_day} 23:30") - time.now_s)
            time.stall(7 * HOUR_S)
        await asyncio.sleep(parse_time_s(f"{first_day} 12:00") + 4 * 24.5 * HOUR_S - time.now_s)
        timers.stop()
        await asyncio.sleep(0)

    time.run(run_nights())
    days = [datetime.fromisoformat(first_day) + timedelta(days=n) for n in range(5)]
    backup_times = [
        datetime.fromtimestamp(parse_backup_time_s(copy), BERLIN).replace(tzinfo=None)
        for copy in list_backups(state)
    ]
    due_times = [days[0].replace(hour=12), *(day.replace(hour=4) for day in days[1:])]
    if is_suspended:
        due_times[1] = days[1].replace(hour=6, minute=30)
    assert backup_times[::-1] == due_times
    assert not any(errors)
