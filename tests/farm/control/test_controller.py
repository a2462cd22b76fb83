"""The core with hands that only write down what they are told."""

from pathlib import Path

import pytest

from farm.errors import ErrorCode, FarmError, Refused
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    HoldCode,
    JobOptions,
    JobState,
    Link,
    OwnGcode,
    PrintState,
)
from farm.paths import StateFolder
from farm.planning.plan import InspectedSubmission, Plan, TooFewPrinters
from farm.state import events as ev
from farm.views.jobs import describe_job
from farm.views.printers import describe_printer
from farm.views.tasks import list_tasks
from make_books import plan as planned
from recording_controller import MODEL, PLUS, Farm

STATE = StateFolder(Path("/state"))


@pytest.fixture
def plan():
    event = planned(1, 2)
    return Plan(event.parts, event.plates, event.repairs, 1000.0, 500.0, 100.0, None)


@pytest.fixture
def farm(tmp_path):
    return Farm(tmp_path)


def test_a_job_waits_for_its_printers_then_takes_all_that_are_idle_and_clear(farm):
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    assert farm.core.books.jobs[1].hold.code is HoldCode.PRINTER_CONNECTING
    farm.ready("a")
    assert farm.hands.plans == []
    farm.ready("b")
    assert farm.hands.plans == [(1, ["a", "b"], 1)]
    assert farm.core.books.jobs[1].state is JobState.PLANNING


def test_a_plate_goes_elsewhere_only_when_its_agent_has_heard_that_it_must_not_begin(tmp_path):
    farm = Farm(tmp_path, [PLUS] * 3)
    farm.ready("a", "b", "c")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    event = planned(1, 1)
    farm.core.planned(1, Plan(event.parts, event.plates, (), 1.0, 500.0, 100.0))
    first = farm.core.books.open_print_on("a")
    stale = AgentSnapshot(printer="a", link=Link.ABSENT, agent_pid=9, reason="unplugged")
    farm.core.heard(stale)
    assert farm.hands.told[-1] == ev.SendCancel(print_id=first.id, printer="a", reason="unplugged")
    assert [p.printer for p in farm.core.books.open_prints()] == ["a"]
    farm.core.heard(stale.model_copy(update={"heard_cancel": first.id}))
    assert [p.printer for p in farm.core.books.open_prints()] == ["b"]


def test_a_job_that_no_printer_matches_any_more_lets_the_next_one_pass(farm):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions(material="generic_abs"))
    farm.core.submit("s" * 8, "n.stl", MODEL, JobOptions())
    farm.core.submit("t" * 8, "o.stl", MODEL, JobOptions())
    assert farm.hands.plans == [(2, ["a", "b"], 1)]
    holds = {job.id: job.hold and job.hold.code for job in farm.core.books.jobs.values()}
    assert holds == {1: HoldCode.NO_SUCH_PRINTER, 2: None, 3: HoldCode.NOT_FRONT}
    farm.desk.cancel_job(2, "ann")
    assert [number for number, *_ in farm.hands.plans] == [2, 3]


def test_own_g_code_takes_one_printer_that_has_its_nozzle_and_its_room(farm):
    def submit(request_id, nozzle_mm, half_mm):
        box = {"min_mm": (-half_mm, -half_mm, 0.2), "max_mm": (half_mm, half_mm, 9.0)}
        own = OwnGcode(nozzle_mm=nozzle_mm, **box)
        return farm.core.submit(
            request_id, "x.gcode", InspectedSubmission("x.gcode", (), 1.0, own), JobOptions()
        )[0]

    farm.ready("a")
    farm.ready("b", bed_clear=False)
    numbers = [submit("r" * 8, 0.8, 10), submit("s" * 8, 0.4, 111), submit("t" * 8, None, 10)]
    holds = [farm.core.books.jobs[number].hold for number in numbers]
    assert [hold and hold.code for hold in holds] == [HoldCode.NO_SUCH_PRINTER] * 2 + [None]
    assert farm.hands.plans == [(3, ["a"], 1)]


def test_the_same_request_is_the_same_job(farm):
    assert farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions()) == (1, False)
    assert farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions()) == (1, True)
    assert farm.core.submit("s" * 8, "m.stl", MODEL, JobOptions()) == (2, False)


def test_a_model_that_needs_more_parts_than_there_are_printers_goes_in_rounds(farm):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    farm.core.planned(1, TooFewPrinters("needs 5", 5))
    assert farm.hands.plans[-1] == (1, ["a", "b"], 3)


def test_a_plan_that_fails_fails_its_job_and_the_next_one_goes_on(farm):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    farm.core.submit("s" * 8, "n.stl", MODEL, JobOptions())
    assert farm.core.books.jobs[2].hold.code is HoldCode.NOT_FRONT
    farm.core.planned(1, FarmError("parts overlap", ErrorCode.GEOMETRY))
    job = farm.core.books.jobs[1]
    assert (job.state, job.error) == (JobState.FAILED, ErrorCode.GEOMETRY)
    assert farm.hands.plans[-1][0] == 2
    assert describe_job(farm.core.build_view_context(STATE), job).exit_code == 5


def test_a_plan_made_for_a_job_that_was_cancelled_is_thrown_away(farm, plan):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    farm.desk.cancel_job(1, "ann")
    assert ev.StopPlanning(job=1) in farm.hands.told
    farm.core.planned(1, plan)
    assert not farm.core.books.plates
    with pytest.raises(Refused, match="ended already"):
        farm.desk.cancel_job(1, "ann")


def test_every_printer_is_told_once_and_a_new_daemon_tells_those_that_do_not_know(farm, plan, tmp_path):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    farm.core.planned(1, plan)
    starts = [i for i in farm.hands.told if isinstance(i, ev.SendStart)]
    assert [s.printer for s in starts] == ["a", "b"]
    farm.store.close()
    again = Farm(tmp_path)
    assert again.core.books == farm.core.books
    again.ready("a")
    assert [i for i in again.hands.told if isinstance(i, ev.SendStart)] == [starts[0]]


def test_what_was_given_by_day_is_not_told_again_by_night(farm, plan, tmp_path):
    """An agent that was away since would heat with nobody there."""
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    farm.core.planned(1, plan)
    assert any(isinstance(i, ev.SendStart) for i in farm.hands.told)
    night = Farm(tmp_path, quiet="00:00-24:00")
    night.ready("a", "b")
    assert not [i for i in night.hands.told if isinstance(i, ev.SendStart)]
    day = Farm(tmp_path)
    day.ready("a", "b")
    assert [i for i in day.hands.told if isinstance(i, ev.SendStart)]


def test_a_daemon_that_died_while_it_planned_plans_again(farm, tmp_path):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    farm.store.close()
    again = Farm(tmp_path)
    again.ready("a", "b")
    assert again.hands.plans == [(1, ["a", "b"], 1)]


def test_a_full_bed_is_shown_with_what_to_do(farm, plan):
    farm.ready("a", "b", bed_clear=False)
    assert {p.bed for p in farm.core.books.printers.values()} == {Bed.NOT_CLEAR}
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    view = describe_job(farm.core.build_view_context(STATE), farm.core.books.jobs[1])
    assert view.waits_for_person
    assert view.hold.code is HoldCode.BED_NOT_CLEAR
    assert list_tasks(farm.core.build_view_context(STATE))[0].printers == ["a", "b"]
    farm.desk.cleared("a", "ann", None)
    assert farm.hands.plans == [(1, ["a"], 1)]


def test_a_printer_in_fault_is_not_used_and_says_why(farm):
    farm.ready("a", link=Link.FAULT, reason="it does not get warm")
    view = describe_printer(farm.core.build_view_context(STATE), farm.core.fleet.printer("a"), None)
    assert (view.state, view.look) == ("fault", "it does not get warm")
    farm.ready("b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    assert farm.hands.plans == [(1, ["b"], 1)]


def test_a_person_pauses_what_a_printer_prints_and_is_told_by_when_to_resume_it(farm, plan):
    farm.ready("a", "b")
    farm.core.submit("r" * 8, "m.stl", MODEL, JobOptions())
    with pytest.raises(Refused, match="a prints nothing"):
        farm.desk.pause_printer("a", True, "ann")
    farm.core.planned(1, plan)
    attempt = farm.core.books.open_print_on("a")
    with pytest.raises(Refused, match="a is not paused"):
        farm.desk.pause_printer("a", False, "ann")
    paused = ev.SendPause(print_id=attempt.id, printer="a", wanted=True)

    def told_last():
        return [told for told in farm.hands.told if getattr(told, "printer", "") == "a"][-1]

    farm.desk.pause_printer("a", True, "ann")
    assert told_last() == paused

    def word(state, **changes):
        facts = {"fault": None, "reason": None, "progress_s": 5.0, "print_time_s": 90.0, "extruded": True}
        facts |= {"started_s": 2.0, "ended_s": None, **changes}
        said = AgentPrint(print_id=attempt.id, state=state, **facts)
        farm.core.heard(AgentSnapshot(printer="a", link=Link.BUSY, print=said))
        context = farm.core.build_view_context(STATE)
        view = describe_printer(context, farm.core.fleet.printer("a"), None)
        return view, [item for item in list_tasks(context) if item.code == "resume"]

    word(PrintState.PRINTING)  # it was heating when it was told
    assert told_last() == paused
    assert word(PrintState.PAUSED)[1] == []  # it parks
    view, (item,) = word(PrintState.PAUSED, pause_ends_s=7200.0)
    assert (view.state, view.print.pause_ends) == ("paused", "1970-01-01T02:00:00+00:00")
    assert item.text == "resume a by Thu 02:00, or its print is ended: `farm resume a`"
    farm.desk.pause_printer("a", False, "ann")
    assert told_last() == paused.model_copy(update={"wanted": False})
    view, rest = word(PrintState.PRINTING)
    assert (view.state, view.print.pause_ends, rest) == ("printing", None, [])
    farm.desk.cancel_job(1, "ann")
    with pytest.raises(Refused, match="ending"):
        farm.desk.pause_printer("a", True, "ann")


def test_a_heater_that_cannot_be_switched_off_is_booked_whether_the_printer_prints_or_not(farm):
    farm.ready("a", "b")
    for link in (Link.BUSY, Link.FAULT):
        found = f"the nozzle is off, and gets hotter ({link})"
        farm.core.heard(AgentSnapshot(printer="a", link=link, agent_pid=7, alarm=found))
        assert (farm.core.books.printers["a"].attention_reason, farm.core.books.printers["a"].alarm) == (
            found,
            found,
        )
