"""`farm cleared --good`: the command, through the daemon's own routes and rules."""

import asyncio
from types import SimpleNamespace

import httpx
import pytest
from typer.testing import CliRunner

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from browser.http_caller import DAEMON_USER, call_as
from farm.cli.client import daemon_client
from farm.cli.main import app as cli
from farm.control import DryRuns
from farm.control.job_commands import abort_prints
from farm.http import Services, make_app
from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, JobOptions, JobState, Link, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan


@pytest.fixture
def farm(tmp_path, monkeypatch):
    """Serve a job of one part, whose print on `a` ended with its agent, to the CLI."""
    farm = Farm(tmp_path)
    farm.controller.started_s -= 3600.0
    farm.report_ready("a")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 1)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    now_s = farm.controller.clock.now()
    report_print(farm, "a", PrintState.PRINTING, started_s=now_s - 100.0)
    end_fields = {
        "fault": "agent_died",
        "reason": "its agent died",
        "started_s": now_s - 100.0,
        "ended_s": now_s,
    }
    report_print(farm, "a", PrintState.FAILED, **end_fields)
    daemon = make_app(
        Services(farm.controller, StateFolder(tmp_path), tmp_path / "fleet.yaml", None, None),
        DryRuns(farm.controller),
    )

    class Connection:
        def __init__(self, *_):
            pass

        def request(self, method, target, content, headers):
            async def send_request():
                transport = httpx.ASGITransport(call_as(DAEMON_USER, daemon))
                async with httpx.AsyncClient(transport=transport, base_url="http://farm") as client:
                    return await client.request(method, target, content=content or b"", headers=headers)

            self._answer = asyncio.run(send_request())

        def getresponse(self):
            return SimpleNamespace(status=self._answer.status_code, read=lambda: self._answer.content)

        def close(self):
            pass

    monkeypatch.setattr(daemon_client, "open_connection", Connection)
    return farm


def report_print(farm, printer, state, **fields):
    attempt = farm.controller.books.find_open_print(printer)
    progress = {"fault": None, "reason": None, "progress_s": 5.0, "print_time_s": 90.0, "extruded": True}
    progress |= {"started_s": None, "ended_s": None, **fields}
    link = Link.READY if state.ended else Link.BUSY
    snapshot = AgentSnapshot(
        printer=printer,
        link=link,
        agent_pid=9,
        filament=FilamentState.PARKED,
        print=AgentPrint(print_id=attempt.id, state=state, **progress),
    )
    farm.controller.on_snapshot(snapshot)


def run_farm(*arguments):
    return CliRunner().invoke(cli, list(arguments))


def join_lines(text):
    return " ".join(text.split())


@pytest.mark.parametrize("part", ["1/p01", "p01", "1"])
def test_good_part_of_a_failed_print_is_not_reprinted(farm, part):
    assert "if part 1/p01 is good nevertheless: `farm cleared a --good 1/p01`" in join_lines(
        run_farm("status").stdout
    )
    answer = run_farm("cleared", "a", "--good", part)
    assert answer.stdout == "a: bed clear; part 1/p01 is good and will not be printed again\n"
    assert farm.controller.books.jobs[1].state is JobState.DONE
    assert farm.controller.books.get_printer("a").bed is Bed.CLEAR
    farm.controller.clock.host_shift_s += 60.0
    farm.report_ready("a", "b")
    assert list(farm.controller.books.list_open_prints()) == []


def test_good_part_names_its_running_reprint_and_the_command_to_end_it(farm):
    # A loss that may affect several printers is reported after a delay.
    farm.controller.clock.host_shift_s += 60.0
    farm.report_ready("b")
    report_print(farm, "b", PrintState.HEATING, started_s=farm.controller.clock.now())
    answer = run_farm("cleared", "a", "--good", "1/p01")
    assert answer.stdout == (
        "a: bed clear; part 1/p01 is good; b is already printing it again: stop that with `farm cancel b`\n"
    )
    assert run_farm("cancel", "b").exit_code == 0
    assert farm.controller.books.find_open_print("b").cancel_reason is not None
    report_print(farm, "b", PrintState.CANCELLED, ended_s=farm.controller.clock.now())
    assert farm.controller.books.jobs[1].state is JobState.DONE


def test_shutdown_ends_a_print_of_a_part_found_good(farm):
    farm.controller.clock.host_shift_s += 60.0
    farm.report_ready("b")
    report_print(farm, "b", PrintState.HEATING, started_s=farm.controller.clock.now())
    run_farm("cleared", "a", "--good", "1/p01")
    abort_prints(farm.controller)
    assert farm.controller.books.find_open_print("b").cancel_reason is not None


@pytest.mark.parametrize(
    ("arguments", "expected_text"),
    [
        (("a", "--good", "1/p02"), "the part on a is 1/p01, not 1/p02"),
        (("a", "--good", "2/p01"), "the part on a is 1/p01, not 2/p01"),
        (("b", "--good", "1/p01"), "no part is recorded on b"),
        (("a", "--good", "1/p01", "--bad"), "exclude each other"),
        (("a", "b", "--good", "1/p01"), "exactly one printer"),
        (("all", "--good", "1/p01"), "exactly one printer"),
    ],
)
def test_part_on_another_bed_cannot_be_confirmed_as_good(farm, arguments, expected_text):
    answer = run_farm("cleared", *arguments)
    assert answer.exit_code != 0
    text = join_lines((answer.output + str(answer.exception or "")).replace("│", " "))
    assert expected_text in text
    assert farm.controller.books.jobs[1].state is JobState.PRINTING
    assert farm.controller.books.get_printer("a").bed is Bed.NOT_CLEAR


def test_part_of_a_completed_print_may_be_named_as_good(farm):
    run_farm("cleared", "a")
    farm.controller.clock.host_shift_s += 60.0
    farm.report_ready("a")
    farm.controller.handle()  # as the daemon's timer does
    now_s = farm.controller.clock.now()
    report_print(farm, "a", PrintState.DONE, started_s=now_s - 100.0, ended_s=now_s)
    assert run_farm("cleared", "a", "--good", "p01").stdout == "a: bed clear\n"
    assert farm.controller.books.jobs[1].state is JobState.DONE
