"""Cancelled planning in real processes, which ends at once and leaves no process."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest

from farms.real_farm import wait_for

pytestmark = pytest.mark.system

PRINTER_MODEL = "ultimaker2_plus"


@pytest.fixture
def hanging_engine(tmp_path):
    """Make an engine that never ends and holds a FIFO open, so that end of file means that no engine runs."""
    os.mkfifo(tmp_path / "fifo")
    engine = tmp_path / "engine"
    version = "[ $1 = help ] && exec CuraEngine help"
    engine.write_text(
        f"#!/bin/sh\n{version}\nexec 3>{tmp_path / 'fifo'}\necho slicing >&3\nexec sleep 1000\n"
    )
    engine.chmod(0o755)
    return engine


def list_children(pid):
    """List the running child processes of a process."""
    pids = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
        except OSError:
            continue
        if int(parent) == pid and state != "Z":
            pids.add(int(stat.parent.name))
    return pids


def list_workers(daemon):
    """List the worker processes of a daemon; a child may end meanwhile."""
    pids = set()
    for pid in list_children(daemon):
        with suppress(OSError):
            if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
                pids.add(pid)
    return pids


def test_planning_processes_end_with_their_job_and_with_the_daemon(make_farm, bar, hanging_engine, tmp_path):
    farm = make_farm(
        {"one": (PRINTER_MODEL, f"sim://{PRINTER_MODEL}"), "two": (PRINTER_MODEL, f"sim://{PRINTER_MODEL}")}
    )
    farm.up(FARM_CURA_ENGINE=str(hanging_engine))
    daemon = farm.read_status()["daemon"]["pid"]
    farm.run_checked("submit", bar)
    with (tmp_path / "fifo").open() as fifo:
        assert fifo.readline() == "slicing\n"
        progress = {"step": "slicing", "done": 0, "of": 2, "cached": 0, "share": None, "remaining_s": None}
        assert farm.read_job()["progress"] == progress
        assert "slicing 0 of 2" in farm.run_checked("status")
        old_workers = list_workers(daemon)
        farm.run_checked("cancel", 1)
        fifo.read()  # returns when no engine has the FIFO open
    assert (farm.read_job()["state"], farm.read_job()["progress"]) == ("cancelled", None)
    wait_for(
        "new workers", lambda: len(old_workers) == len(now := list_workers(daemon)) and now - old_workers
    )
    assert not list((farm.state / "work").glob("job-*"))
    # While the new workers plan the next job, the daemon is killed.
    farm.run_checked("submit", bar)
    with (tmp_path / "fifo").open() as fifo:
        assert fifo.readline() == "slicing\n"
        old_workers = list_workers(daemon)
        farm.kill_daemon()
        fifo.read()
    wait_for(
        "the workers of the killed daemon to end",
        lambda: not any(Path(f"/proc/{pid}").exists() for pid in old_workers),
    )
    # A worker that is killed while it writes a slice leaves such a file.
    partial_file = farm.state / "slices" / ".some.gcode.x"
    partial_file.touch()
    # The next daemon plans the job again, and is shut down meanwhile.
    farm.up(FARM_CURA_ENGINE=str(hanging_engine))
    assert not partial_file.exists()
    daemon = farm.read_status()["daemon"]["pid"]
    with (tmp_path / "fifo").open() as fifo:
        assert fifo.readline() == "slicing\n"
        old_workers = list_workers(daemon)
        assert "being planned: job 2" in farm.run("down").stderr
        farm.run_checked("down", "--now")
        fifo.read()
    assert not any(Path(f"/proc/{pid}").exists() for pid in old_workers)
    assert not (farm.state / "work" / "workers").exists()
