"""Messages of a daemon that cannot start, and its clock."""

import asyncio
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from books.recording_controller import make_fleet
from farm.cli import commands
from farm.daemon import Daemon, run
from farm.errors import FarmError
from farm.model import Job, JobOptions, JobState, PlanProgress, PlanStep
from farm.paths import FarmPaths, StateFolder
from farm.state import Books
from farm.state import events as ev


def test_unwritable_state_folder_is_reported_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("logging.basicConfig", lambda **_: None)
    state = StateFolder(tmp_path / "state")
    state.make()
    state.lock.mkdir()  # prevents the lock, as a full or read-only disk does
    with pytest.raises(FarmError, match=r"state folder .* cannot be used .*: check its disk space"):
        run(make_fleet(), FarmPaths(state, tmp_path / "farm.sock", tmp_path / "fleet.yaml"))


COMMANDS = [f"farm.cli.commands.{path.stem}" for path in Path(commands.__file__).parent.glob("[a-z]*.py")]


@pytest.mark.parametrize("module", ["farm.daemon", "farm.planning.tasks", *COMMANDS])
def test_modules_of_workers_are_not_loaded_by_the_daemon(module):
    """Limit the imports, so that a restarted daemon and every `farm status` start quickly."""
    slow_modules = (
        "numpy",
        "scipy",
        "trimesh",
        "numba",
        "sklearn",
        "PIL",
        "shapely",
        "manifold3d",
        "httpx",
    )
    script = f"import sys, {module}; print([m for m in {slow_modules} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout == "[]\n"


def test_clock_step_of_the_host_reaches_every_component(tmp_path, monkeypatch):
    """Follow a step of the clock at the next check."""
    monkeypatch.setattr("farm.daemon._CLOCK_INTERVAL_S", 0.0)
    state = StateFolder(tmp_path / "state")
    state.make()
    daemon = Daemon(make_fleet(), FarmPaths(state, tmp_path / "farm.sock", tmp_path / "fleet.yaml"))
    real_time, reports = time.time, []
    monkeypatch.setattr(daemon._timers, "on_clock_set", lambda: reports.append("timers"))
    monkeypatch.setattr(daemon._agents.hosts, "on_clock_set", lambda by_s: reports.append("hosts"))
    monkeypatch.setattr(daemon._controller, "handle", lambda *events: reports.extend(events))
    monkeypatch.setattr(time, "time", lambda: real_time() + 6 * 3600.0)
    old_s = daemon._clock.now()

    async def follow_clock():
        follow_task = asyncio.get_running_loop().create_task(daemon._follow_clock())
        for _ in range(10):
            await asyncio.sleep(0)
        follow_task.cancel()

    asyncio.run(follow_clock())
    daemon._workers.close()
    daemon._store.close()
    assert daemon._clock.now() - old_s == pytest.approx(6 * 3600.0, abs=60.0)
    assert reports[:2] == ["timers", "hosts"]
    (event,) = [event for event in reports if isinstance(event, ev.ClockSet)]
    assert event.by_s == pytest.approx(6 * 3600.0, abs=60.0)


def test_agents_are_watched_often(tmp_path, monkeypatch):
    """Check agents every second or more often: heaters must be off within 5 s of an agent's death."""
    state = StateFolder(tmp_path / "state")
    state.make()
    daemon = Daemon(make_fleet(), FarmPaths(state, tmp_path / "farm.sock", tmp_path / "fleet.yaml"))
    timers = {}

    def record_timer(interval_s, name, callback):
        timers[name] = (interval_s, callback)

    monkeypatch.setattr(daemon._timers, "call_every", record_timer)
    monkeypatch.setattr(daemon._timers, "start", lambda: None)
    daemon._start_timers(Mock(), Mock())
    daemon._workers.close()
    daemon._store.close()
    interval_s, callback = timers["watch agents"]
    assert interval_s <= 1.0 and callback == daemon._agents.watch


@pytest.mark.parametrize(("now", "poll_count"), [(False, 3), (True, 0)])
def test_farm_down_waits_for_a_plan_in_progress_unless_now(tmp_path, monkeypatch, now, poll_count):
    state = StateFolder(tmp_path / "state")
    state.make()
    daemon = Daemon(make_fleet(), FarmPaths(state, tmp_path / "farm.sock", tmp_path / "fleet.yaml"))
    planning_states, polls, polls_at_end = iter([[1], [1], []]), [], []

    def list_planning(_):
        polls.append(next(planning_states))
        return polls[-1]

    async def skip_sleep(_):
        pass

    async def shut_down_agents():
        polls_at_end.append(list(polls))

    monkeypatch.setattr(daemon._controller.planning, "list_jobs_in_planning", list_planning)
    monkeypatch.setattr("farm.daemon.asyncio.sleep", skip_sleep)
    monkeypatch.setattr(daemon._agents, "shut_down_agents", shut_down_agents)
    asyncio.run(daemon._end_when_idle(now))
    daemon._workers.close()
    daemon._store.close()
    assert len(polls_at_end[0]) == poll_count


def test_farm_down_waits_for_inspections_but_not_for_a_plan_that_waits_for_disk_space(tmp_path, monkeypatch):
    state = StateFolder(tmp_path / "state")
    state.make()
    daemon = Daemon(make_fleet(), FarmPaths(state, tmp_path / "farm.sock", tmp_path / "fleet.yaml"))
    controller, waits = daemon._controller, []
    controller.books = Books.from_entities([make_planned_job(1)])
    controller.planning.on_progress(1, PlanProgress(step=PlanStep.SLICING))
    daemon._inspections[tmp_path] = "bunny.stl"

    async def record_wait(_):
        waits.append(list(daemon._inspections.values()))
        daemon._inspections.clear()
        if len(waits) == 2:
            controller.planning.on_progress(1, PlanProgress(step=PlanStep.NO_ROOM))

    async def shut_down_agents():
        pass

    monkeypatch.setattr("farm.daemon.asyncio.sleep", record_wait)
    monkeypatch.setattr(daemon._agents, "shut_down_agents", shut_down_agents)
    asyncio.run(daemon._end_when_idle(is_immediate=False))
    daemon._workers.close()
    daemon._store.close()
    assert waits == [["bunny.stl"], []]


def make_planned_job(number):
    fields = {"name": "m", "model_file": "m.npz", "options": JobOptions(), "submitted_s": 0.0}
    return Job(id=number, request_id="r" * 8, state=JobState.PLANNING, **fields)
