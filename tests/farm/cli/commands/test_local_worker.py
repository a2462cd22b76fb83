"""`farm worker` that cannot start: an error in one line."""

import os

import pytest

from drivers import locks
from farm.cli.commands import local
from farm.errors import ErrorCode, FarmError, RefusedError

SCHEDULER = "tcp://127.0.0.1:9"  # nothing listens on the port `discard`


def test_worker_without_an_engine_names_the_command_that_installs_it(tmp_path, monkeypatch):
    monkeypatch.setenv("FARM_CURA_ENGINE", str(tmp_path / "none"))
    with pytest.raises(FarmError, match="run 'farm setup'") as error:
        local.worker(SCHEDULER, folder=tmp_path)
    assert error.value.code is ErrorCode.ENGINE


def test_folder_of_another_worker_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "_RETRY_INTERVAL_S", 0.0)
    other_lock = locks.acquire_lock(tmp_path / "lock")
    with pytest.raises(RefusedError, match="give each its own --folder"):
        local.worker(SCHEDULER, folder=tmp_path)
    os.close(other_lock)
