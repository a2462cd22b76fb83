"""Measurement of the disk, and the task in DO NOW that follows from it."""

import asyncio
import shutil
import time
from collections import namedtuple

import pytest

from books.old_jobs import NOW_S, make_old_books, write_files
from books.recording_controller import Farm
from drivers.clock import Clock
from farm.model import JobState
from farm.paths import StateFolder
from farm.state.retention import list_referenced_files
from farm.upkeep.disk_use import measure_disk
from farm.upkeep.upkeep import Upkeep
from farm.views import list_tasks

Usage = namedtuple("Usage", "total used free")


def test_files_of_open_jobs_are_not_counted_as_prunable(tmp_path):
    state, books = StateFolder(tmp_path), make_old_books((JobState.DONE, 5), (JobState.PRINTING, 0))
    write_files(books, state, size=100)
    disk_use = measure_disk(state, books, NOW_S, 1.0)
    assert disk_use.stored_bytes == 100 * len(list_referenced_files(books))
    assert disk_use.prunable_bytes == 600  # the picture stays
    assert disk_use.daily_bytes == 0.0  # all files are old
    assert disk_use.free_bytes == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.05)


def test_task_names_a_disk_that_fills_within_two_nights(tmp_path, monkeypatch):
    state = StateFolder(tmp_path / "farm")
    farm = Farm(state.root)
    state.make()
    for number in range(4):
        (state.files / f"{number}.gcode").write_bytes(b"x" * 10**6)
    upkeep = Upkeep(farm.controller, farm.store, state, None)

    def list_task_texts(free_bytes):
        monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 0, free_bytes))
        asyncio.run(upkeep.check_free_space())
        return [task.text for task in list_tasks(farm.build_view_context(state)) if task.code == "farm"]

    with farm.store:
        assert list_task_texts(10**9) == []  # 4 MB a day are stored, and 0.5 GB must stay free
        (text,) = list_task_texts(507 * 10**6)
        assert "will be full in about two nights" in text and "`farm prune`" in text
        (text,) = list_task_texts(4 * 10**8)
        assert "is full now" in text
        assert list_task_texts(10**9) == []


def test_stored_bytes_per_day_follow_the_time_scale(tmp_path):
    state, books = StateFolder(tmp_path), make_old_books()
    state.files.mkdir()
    (state.files / "a.gcode").write_bytes(b"x" * 100)
    clock = Clock(240.0, time.time())
    assert measure_disk(state, books, clock.now(), clock.scale).daily_bytes == 100.0
