"""A real daemon that is killed at commits and at random times, while agents and printers continue."""

from __future__ import annotations

import os
import random

import pytest

from farms.killed_daemon_farm import KilledDaemonFarm
from farms.restarted_daemon import AFTER_DELAY, DEATH_MOMENTS

pytestmark = pytest.mark.system

JOB_EVENTS = (  # events of a job, from its submission to the verdict
    *("JobSubmitted", "PlanningStarted", "JobPlanned", "PlateAssigned", "PrintProgressed", "PrintEnded"),
    "BedCleared",
)


@pytest.fixture
def killed_farm(tmp_path):
    farm = KilledDaemonFarm(tmp_path)
    yield farm
    farm.end()


@pytest.mark.parametrize(
    ("seed", "rounds"),
    [
        (6, 1),
        pytest.param(
            7,
            9,
            marks=pytest.mark.skipif("FARM_KILLS" not in os.environ, reason="takes 3 minutes: FARM_KILLS=1"),
        ),
    ],
)
def test_no_plate_is_lost_or_printed_twice_after_a_kill_at_any_event(killed_farm, seed, rounds):
    """Kill the daemon at every event of a job: before, during or after its commit."""
    rng = random.Random(seed)
    deaths = [
        death
        for round_number in range(rounds)
        for index, event in enumerate(JOB_EVENTS)
        for death in (
            (DEATH_MOMENTS[(index + round_number) % 3], event),
            (AFTER_DELAY, rng.uniform(0.3, 2.0)),
        )[: 1 + index % 2]
    ]
    killed_farm.start_daemons(deaths)
    killed_farm.submit(3 * rounds)
    killed_farm.judge_prints_good(failing_prints=[1])
    # A fast machine may finish the jobs before all deaths have happened.
    while len(killed_farm.list_deaths()) < len(deaths):
        killed_farm.submit(1)
        killed_farm.judge_prints_good()
    killed_farm.check()
    assert killed_farm.list_deaths() == [
        moment if moment == AFTER_DELAY else f"{moment} {event_kind}" for moment, event_kind in deaths
    ]
