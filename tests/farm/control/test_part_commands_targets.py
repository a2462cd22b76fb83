"""`farm pause`, `resume` and `cancel` of jobs, parts and printers."""

import asyncio

import httpx
import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from browser.http_caller import DAEMON_USER, call_as
from farm.cli.commands.operate import find_target_path
from farm.control import DryRuns
from farm.http import Services, make_app
from farm.model import JobOptions, JobState, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.state import events as ev


@pytest.fixture
def farm(tmp_path):
    """Serve a job of two parts, which two printers print, through the daemon's routes."""
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 2)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    now_s = farm.controller.clock.now()
    for attempt in list(farm.controller.books.list_open_prints()):
        farm.controller.handle(
            ev.PrintProgressed(
                at_s=now_s,
                print_id=attempt.id,
                state=PrintState.PRINTING,
                started_s=now_s,
                extruded=True,
            )
        )
    app = make_app(
        Services(farm.controller, StateFolder(tmp_path), tmp_path / "fleet.yaml", None, None),
        DryRuns(farm.controller),
    )

    def send_command(target, verb):
        async def post_command():
            transport = httpx.ASGITransport(call_as(DAEMON_USER, app))
            async with httpx.AsyncClient(transport=transport, base_url="http://farm") as client:
                return await client.post(f"{find_target_path(target)}/{verb}")

        farm.effects.instructions.clear()
        return asyncio.run(post_command())

    farm.send_command = send_command
    return farm


TARGETS = [("1", "ab"), ("1/p01", "a"), ("1/2", "b"), ("b", "b")]


@pytest.mark.parametrize(("target", "printers"), TARGETS)
def test_paused_part_continues_when_resumed(farm, target, printers):
    for verb, is_paused in (("pause", True), ("resume", False)):
        assert farm.send_command(target, verb).status_code == 200
        requests = {
            (item.printer, item.pause) for item in farm.effects.instructions if isinstance(item, ev.SendPause)
        }
        assert requests == {(printer, is_paused) for printer in printers}
    assert farm.send_command(target, "resume").status_code == 409


@pytest.mark.parametrize(("target", "printers"), TARGETS)
def test_cancelled_part_is_not_printed_again(farm, target, printers):
    assert farm.send_command(target, "cancel").status_code == 200
    assert {item.printer for item in farm.effects.instructions if isinstance(item, ev.SendCancel)} == set(
        printers
    )
    plates = [farm.controller.books.plates[f"1/0{'ab'.index(printer) + 1}"] for printer in printers]
    assert all(plate.cancelled for plate in plates)
    assert (farm.controller.books.get_job(1).state is JobState.CANCELLED) is (target == "1")
    assert farm.send_command(target, "cancel").status_code == 409
