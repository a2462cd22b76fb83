"""Cached descriptions of situations, compared with new ones."""

from dataclasses import replace
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from books.make_books import (
    PRINTERS,
    apply_events,
    make_end_event,
    make_job,
    make_plan_event,
    make_planned_books,
)
from books.recording_controller import make_fleet
from drivers.errors import Fault
from farm.config import Fleet, PrinterSection
from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, JobOptions, Link, PrintState
from farm.paths import StateFolder
from farm.planning.printer_settings import list_bed_boxes
from farm.scheduling.holds import find_held_back_plates
from farm.scheduling.plate_queue import PlateQueue
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import SituationBuilder, derive_job_requirements, update_print_ends
from farm.scheduling.start_rules import StartRules
from farm.state import events as ev
from farm.views import ViewContext

FLEET = make_fleet(["ultimaker2_plus"] * 3)
SECTIONS = FLEET.printers
READY_SNAPSHOTS = {
    n: AgentSnapshot(printer=n, link=Link.READY, filament=FilamentState.PARKED) for n in PRINTERS
}
STEPS = st.sampled_from(["start", "fail", "done", "clear", "pause", "resume", "lose"])


def make_events(step, books, number):
    open_prints = list(books.list_open_prints())
    waiting_plates = [plate for plate in books.list_waiting_plates() if not plate.paused]
    free_printers = [n for n in PRINTERS if books.find_open_print(n) is None]
    print_id = f"print-{number}"
    clear_printers = [n for n in free_printers if books.get_printer(n).bed is Bed.CLEAR]
    if step == "start" and waiting_plates and clear_printers:
        return [
            ev.PlateAssigned(
                at_s=5.0, plate=waiting_plates[0].id, printer=clear_printers[0], print_id=print_id
            )
        ]
    if step in ("fail", "lose") and open_prints:
        fault = Fault.KILL if step == "fail" else Fault.PORT_LOST
        return [make_end_event(open_prints[0].id, PrintState.FAILED, fault=fault, reason="test")]
    if step == "done" and open_prints:
        return [make_end_event(open_prints[0].id)]
    if step == "clear" and free_printers:
        return [ev.BedCleared(at_s=300.0, printer=free_printers[0], by="ann", filament=FilamentState.PARKED)]
    if step in ("pause", "resume"):
        return [ev.JobPaused(at_s=6.0, job=1, wanted=step == "pause", by="ann")]
    return []


@settings(max_examples=50)
@given(st.lists(STEPS, max_size=12), st.booleans())
def test_cached_description_equals_a_new_one(steps, is_absent):
    books, builder = make_planned_books(plates=5), SituationBuilder(list_bed_boxes)
    for number, step in enumerate(steps):
        new_events = [] if books.jobs[1].state.ended else make_events(step, books, number)
        books, _ = apply_events(books, *new_events)
        snapshots = (
            {**READY_SNAPSHOTS, "b": READY_SNAPSHOTS["b"].model_copy(update={"link": Link.ABSENT})}
            if is_absent
            else READY_SNAPSHOTS
        )
        new_builder = SituationBuilder(list_bed_boxes)
        assert builder.describe_waiting_plates(books) == new_builder.describe_waiting_plates(books)
        assert builder.describe_printers(FLEET, books, snapshots) == new_builder.describe_printers(
            FLEET, books, snapshots
        )
        holds = find_held_back_plates(books, books.jobs.values(), SECTIONS, 210.0)
        assert (
            find_held_back_plates(books, books.jobs.values(), SECTIONS, 210.0, builder.may_hold_back) == holds
        )
        unfiltered_holds = find_held_back_plates(books, books.jobs.values(), SECTIONS, 210.0, lambda *_: True)
        assert unfiltered_holds == holds
        is_absent = not is_absent


def test_printer_with_an_unverified_dead_man_timer_prints_only_in_attended_hours():
    real_section = PrinterSection(name="a", model="creality_ender3", port="/dev/ttyUSB0")
    simulated_section = real_section.model_copy(update={"port": "sim://creality_ender3"})
    plus_section = real_section.model_copy(update={"model": "ultimaker2_plus"})
    books, builder = make_planned_books(plates=1), SituationBuilder(list_bed_boxes)
    fleets = [Fleet(printers=(item,)) for item in (real_section, simulated_section, plus_section)]
    printers = [builder.describe_printers(fleet, books, {})[0] for fleet in fleets]
    assert [item.may_print_unattended for item in printers] == [False, True, True]
    reason = "it is not verified that Marlin 2 switches the heaters off when its host dies"
    assert printers[0].attended_reason == reason


def test_description_of_one_printer_equals_that_in_the_fleet_unless_it_is_disabled():
    books, builder = make_planned_books(plates=1), SituationBuilder(list_bed_boxes)
    views = builder.describe_printers(FLEET, books, READY_SNAPSHOTS)
    assert [builder.describe_printer(FLEET, name, books, READY_SNAPSHOTS) for name in PRINTERS] == list(views)
    assert builder.describe_printer(FLEET, "z", books, READY_SNAPSHOTS) is None
    disabled_section = SECTIONS[0].model_copy(update={"enabled": False})
    smaller_fleet = FLEET.model_copy(update={"printers": (disabled_section, *SECTIONS[1:])})
    assert builder.describe_printer(smaller_fleet, "a", books, READY_SNAPSHOTS) is None
    assert builder.describe_printers(smaller_fleet, books, READY_SNAPSHOTS) == views[1:]


def test_only_changed_entities_are_described_again():
    first_plan = make_plan_event(1, plates=2)
    second_job_events = (
        ev.JobSubmitted(at_s=0.0, job=make_job(2)),
        ev.PlanningStarted(at_s=0.0, job=2),
        make_plan_event(2, plates=3),
    )
    books, _ = apply_events(make_planned_books(plates=2), *second_job_events)
    builder = SituationBuilder(list_bed_boxes)
    old_plates, printers = (
        list(builder.describe_waiting_plates(books)),
        builder.describe_printers(FLEET, books, READY_SNAPSHOTS),
    )
    assert [view.id for view in old_plates] == [
        plate.id for plate in (*first_plan.plates, *second_job_events[2].plates)
    ]
    started_event = ev.PlateAssigned(at_s=5.0, plate="1/01", printer="a", print_id="x")
    books, _ = apply_events(books, started_event)
    hot_snapshots = {**READY_SNAPSHOTS, "c": READY_SNAPSHOTS["c"].model_copy(update={"nozzle_c": 210.0})}
    new_plates, new_printers = (
        list(builder.describe_waiting_plates(books)),
        builder.describe_printers(FLEET, books, hot_snapshots),
    )
    assert [view.id for view in new_plates] == ["1/02", "2/01", "2/02", "2/03"]
    assert all(
        new_plate is old_plate for new_plate, old_plate in zip(new_plates[1:], old_plates[2:], strict=True)
    )
    assert [new_plate is old_plate for new_plate, old_plate in zip(new_printers, printers, strict=True)] == [
        False,
        True,
        True,
    ]


def test_capabilities_have_a_name_only_if_a_job_requests_it():
    books, builder = make_planned_books(plates=1), SituationBuilder(list_bed_boxes)
    requesting_job = make_job(2).model_copy(update={"options": JobOptions(only=("b",))})
    for events, names in (
        ([], [None, None, None]),
        ([ev.JobSubmitted(at_s=2.0, job=requesting_job)], [None, "b", None]),
        ([ev.JobCancelled(at_s=3.0, job=2, by="ann")], [None, None, None]),
    ):
        books, _ = apply_events(books, *events)
        assert [
            printer.capabilities.requested_name
            for printer in builder.describe_printers(FLEET, books, READY_SNAPSHOTS)
        ] == names
    assert derive_job_requirements(requesting_job).allowed_printers == ("b",)


@given(st.floats(0, 200), st.floats(-300, 300), st.sampled_from(["print", "another", None]))
def test_end_of_a_running_print_equals_the_end_shown_for_its_printer(progress_s, offset_s, reported_id):
    books = make_planned_books(plates=2)
    books, _ = apply_events(books, ev.PlateAssigned(at_s=5.0, plate="1/01", printer="a", print_id="print"))
    report = AgentPrint(
        print_id=reported_id or "", state=PrintState.PRINTING, fault=None, reason=None, progress_s=progress_s,
        print_time_s=90.0, extruded=True, started_s=5.0, ended_s=None,
    )  # fmt: skip
    report = None if reported_id is None else report
    snapshots = {**READY_SNAPSHOTS, "a": AgentSnapshot(printer="a", link=Link.BUSY, print=report)}
    context = ViewContext(FLEET, books, snapshots, StateFolder(Path("/state")), 300.0 + offset_s)
    builder = SituationBuilder(list_bed_boxes)
    printers = builder.describe_printers(FLEET, books, snapshots)
    situation = Situation(PlateQueue(), printers, StartRules.from_config(FLEET.fleet), context.now_s)
    busy_printer, *other_printers = update_print_ends(situation, books, snapshots).printers
    assert busy_printer.print_end_s == context.now_s + context.estimate_remaining_s(
        books.find_open_print("a")
    )
    assert replace(busy_printer, print_end_s=printers[0].print_end_s) == printers[0]
    assert tuple(other_printers) == printers[1:]
