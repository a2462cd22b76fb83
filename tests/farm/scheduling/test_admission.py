"""Admission of the first job in the queue, and its printers."""

from books.scheduling_examples import TALL_BOXES, make_printer, make_situation
from farm.model import Bed, Hold, HoldCode, Job, JobOptions, Link, ModelSize, OwnGcode
from farm.scheduling import admission
from farm.scheduling.admission import (
    Availability,
    HoldJob,
    JobAdmission,
    JobRequest,
    PrinterChoice,
    StartPlanning,
    find_mismatch,
    is_quick,
)
from farm.scheduling.matching import Requirements
from farm.state.books import Books

ANY_PRINTER = Requirements(None, None, None)


def choose_order(
    requirements,
    printers,
    min_parts,
    fleet,
    reserved_printers,
    is_starting,
    starts_later=False,
    blocked_printers=frozenset(),
):
    request = JobRequest(requirements, printers, min_parts, starts_later=starts_later)
    return admission.choose_printers(
        request,
        Availability(
            tuple(fleet),
            dict.fromkeys(reserved_printers, "9/01"),
            is_starting=is_starting,
            attended_only_printers=blocked_printers,
        ),
    )


def test_first_job_uses_all_idle_and_clear_printers():
    fleet = [
        make_printer("a"),
        make_printer("b", bed=Bed.NOT_CLEAR),
        make_printer("c", is_booked=True),
        make_printer("d"),
    ]
    assert choose_order(ANY_PRINTER, None, 0, fleet, frozenset(), True) == PrinterChoice(("a", "d"))
    assert choose_order(ANY_PRINTER, None, 0, fleet, frozenset("d"), True) == PrinterChoice(("a",))
    assert choose_order(ANY_PRINTER, 1, 0, fleet, frozenset(), True) == PrinterChoice(("a",))


def test_largest_printers_are_chosen_if_fewer_are_requested():
    fleet = [make_printer("a"), make_printer("b", boxes=TALL_BOXES)]
    assert choose_order(ANY_PRINTER, 1, 0, fleet, frozenset(), True) == PrinterChoice(("b",))
    in_rounds = choose_order(ANY_PRINTER, 1, 3, fleet, frozenset(), True)
    assert in_rounds == PrinterChoice(("b",), round_count=3)


def test_job_waits_for_connecting_printers():
    answer = choose_order(
        ANY_PRINTER, None, 0, [make_printer("a"), make_printer("b", link=Link.STARTING)], frozenset(), True
    )
    assert isinstance(answer, Hold) and "b" in answer.text
    decision = choose_order(
        ANY_PRINTER, None, 0, [make_printer("a"), make_printer("b", link=Link.STARTING)], frozenset(), False
    )
    assert decision == PrinterChoice(("a",))


def test_excess_parts_are_planned_for_busy_printers_then_in_rounds():
    fleet = [make_printer("a"), make_printer("b", is_booked=True), make_printer("c")]
    assert choose_order(ANY_PRINTER, None, 3, fleet, frozenset(), True) == PrinterChoice(("a", "b", "c"))
    printers = [
        make_printer("a"),
        make_printer("b", link=Link.ABSENT),
        make_printer("c", attention_reason="it smokes"),
    ]
    assert choose_order(ANY_PRINTER, None, 2, printers, frozenset(), True) == PrinterChoice(
        ("a",), round_count=2
    )
    assert choose_order(ANY_PRINTER, None, 5, fleet, frozenset(), True) == PrinterChoice(
        ("a", "c"), round_count=3
    )


def test_job_is_planned_although_no_printer_is_free():
    busy_printer, full_printer = make_printer("c", is_booked=True), make_printer("b", bed=Bed.NOT_CLEAR)
    broken_printer = make_printer("a", attention_reason="it smokes")
    assert choose_order(
        ANY_PRINTER, None, 0, [broken_printer, full_printer, busy_printer], frozenset(), True
    ) == PrinterChoice(("b", "c"))
    assert choose_order(
        ANY_PRINTER, 1, 0, [broken_printer, full_printer, busy_printer], frozenset(), True
    ) == PrinterChoice(("b",))
    # A printer that needs attention is used only if there is no other.
    assert choose_order(ANY_PRINTER, None, 0, [broken_printer], frozenset(), True) == PrinterChoice(("a",))
    assert choose_order(
        ANY_PRINTER, None, 0, [make_printer("d"), busy_printer], frozenset("d"), True
    ) == PrinterChoice(("c", "d"))


def test_job_that_no_printer_matches_is_held_with_the_reason():
    assert (
        find_mismatch(Requirements("generic_abs", None, None), [make_printer("a")]).code
        is HoldCode.NO_SUCH_PRINTER
    )
    assert find_mismatch(ANY_PRINTER, []).code is HoldCode.NO_SUCH_PRINTER
    assert find_mismatch(ANY_PRINTER, [make_printer("a", attention_reason="it smokes")]) is None


def test_job_at_night_is_planned_for_unattended_printers():
    fleet = [make_printer("a"), make_printer("b"), make_printer("c", may_print_unattended=False)]
    blocked_printers = frozenset("c")
    assert choose_order(
        ANY_PRINTER, None, 0, fleet, frozenset(), True, blocked_printers=blocked_printers
    ) == PrinterChoice(("a", "b"))
    assert choose_order(
        ANY_PRINTER, None, 3, fleet, frozenset(), True, blocked_printers=blocked_printers
    ) == PrinterChoice(("a", "b"), round_count=2)
    assert choose_order(
        ANY_PRINTER, None, 0, fleet[2:], frozenset(), True, blocked_printers=blocked_printers
    ) == PrinterChoice(("c",))
    busy_printers = [make_printer("a", is_booked=True), fleet[2]]
    assert choose_order(
        ANY_PRINTER, None, 0, busy_printers, frozenset(), True, blocked_printers=blocked_printers
    ) == PrinterChoice(("a",))


def make_queued_job(number, **changes):
    fields = {"name": "m", "model_file": "m.npz", "options": JobOptions(), "submitted_s": 0.0}
    return Job(id=number, request_id="r" * 8, **{**fields, **changes})


def decide_on_jobs(jobs, fleet):
    """Decide on the jobs of a queue; return the orders and the holds."""
    situation = make_situation([], fleet)
    admission = JobAdmission()
    results = list(admission.decide(Books.from_entities(jobs), situation, Availability(situation.printers)))
    orders = [(item.job, item.printers) for item in results if isinstance(item, StartPlanning)]
    return orders, {item.job: item.hold for item in results if isinstance(item, HoldJob)}


def test_held_job_is_planned_for_attended_printers_too():
    fleet = [
        make_printer("a"),
        make_printer("b", is_booked=True),
        make_printer("c", may_print_unattended=False),
    ]
    assert decide_on_jobs([make_queued_job(1)], fleet)[0] == [(1, ("a",))]
    assert decide_on_jobs([make_queued_job(1, options=JobOptions(hold=True))], fleet)[0] == [
        (1, ("a", "b", "c"))
    ]
    assert decide_on_jobs([make_queued_job(1, not_before_s=3600.0)], fleet)[0] == [(1, ("a", "b"))]


SMALL_MODEL = {"size": ModelSize(extents_mm=(60.0, 60.0, 60.0), faces=12)}


def test_long_plans_are_limited_and_quick_ones_do_not_wait():
    own_gcode = OwnGcode(nozzle_mm=0.4, min_mm=(-5.0, -5.0, 0.2), max_mm=(5.0, 5.0, 9.0))
    jobs = [make_queued_job(n) for n in (1, 2, 3)] + [
        make_queued_job(4, **SMALL_MODEL),
        make_queued_job(5, own_gcode=own_gcode),
    ]
    orders, holds = decide_on_jobs(jobs, [make_printer("a"), make_printer("b")])
    assert orders == [(n, ("a", "b")) for n in (1, 2, 4, 5)]
    assert (holds[3].code, holds[3].text) == (HoldCode.NOT_FIRST, "job 1 and job 2 are planned first")


def test_model_is_quick_only_if_small_and_without_options():
    fleet = [make_printer("a")]
    assert is_quick(make_queued_job(1, **SMALL_MODEL), fleet)
    assert not is_quick(make_queued_job(1), fleet)  # a job of an earlier version has no size
    for size in (((260.0, 10.0, 10.0), 12), ((60.0, 60.0, 60.0), 900_000)):
        large_size = ModelSize(extents_mm=size[0], faces=size[1])
        assert not is_quick(make_queued_job(1, size=large_size), fleet)
    for options in (JobOptions(printers=3), JobOptions(done_by="08:00")):
        assert not is_quick(make_queued_job(1, options=options, **SMALL_MODEL), fleet)
    assert is_quick(
        make_queued_job(1, size=ModelSize(extents_mm=(10.0, 150.0, 240.0), faces=12)),
        [make_printer("a", TALL_BOXES)],
    )


def test_requirements_name_the_needed_build_volume():
    requirements = Requirements(None, None, None, (-50.0, -20.0, 50.0, 40.0, 30.0))
    assert requirements.describe() == "100 mm of width, 60 mm of depth and 30 mm of height"
