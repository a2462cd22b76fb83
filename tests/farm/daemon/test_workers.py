"""Worker processes: what dies in them is tried once more, and then named."""

import asyncio

import pytest

from dying_work import complain, die, die_once
from farm.daemon.workers import Workers
from farm.errors import FarmError


@pytest.fixture
def workers():
    pool = Workers(1)
    yield pool
    pool.close()


def test_work_whose_worker_died_is_done_by_another(workers, tmp_path):
    assert asyncio.run(workers.run(die_once, tmp_path / "died")) == "alive"


def test_work_that_kills_every_worker_is_named_and_the_next_goes_on(workers, tmp_path):
    with pytest.raises(FarmError, match="died 2 times"):
        asyncio.run(workers.run(die))
    (tmp_path / "died").touch()
    assert asyncio.run(workers.run(die_once, tmp_path / "died")) == "alive"


def test_an_error_passes_between_processes_whole(workers):
    with pytest.raises(FarmError, match="no such thing") as error:
        asyncio.run(workers.run(complain))
    assert error.value.code == "failed"
