"""Admission of the first job in the queue, and its printers."""

from farm.model import Bed, Hold, HoldCode, Link
from farm.scheduling import admission
from farm.scheduling.admission import Availability, Begin, JobRequest, find_mismatch
from farm.scheduling.matching import Requirements
from scheduling_examples import TALL, printer

ANY = Requirements(None, None, None)


def begin(requirements, printers, least, fleet, taken, starting, needs_approval=False, blocked=frozenset()):
    request = JobRequest(requirements, printers, least, needs_approval=needs_approval)
    return admission.choose_printers(
        request, Availability(tuple(fleet), dict.fromkeys(taken, "9/01"), starting, blocked)
    )


def test_the_front_job_takes_all_that_are_idle_and_clear():
    fleet = [printer("a"), printer("b", bed=Bed.NOT_CLEAR), printer("c", booked=True), printer("d")]
    assert begin(ANY, None, 0, fleet, frozenset(), True) == Begin(("a", "d"))
    assert begin(ANY, None, 0, fleet, frozenset("d"), True) == Begin(("a",))
    assert begin(ANY, 1, 0, fleet, frozenset(), True) == Begin(("a",))


def test_fewer_requested_printers_are_the_largest():
    fleet = [printer("a"), printer("b", room=TALL)]
    assert begin(ANY, 1, 0, fleet, frozenset(), True) == Begin(("b",))


def test_job_waits_for_connecting_printers():
    answer = begin(ANY, None, 0, [printer("a"), printer("b", link=Link.STARTING)], frozenset(), True)
    assert isinstance(answer, Hold) and "b" in answer.text
    late = begin(ANY, None, 0, [printer("a"), printer("b", link=Link.STARTING)], frozenset(), False)
    assert late == Begin(("a",))


def test_job_waits_for_one_round_unless_the_fleet_is_too_small():
    fleet = [printer("a"), printer("b", booked=True), printer("c")]
    held = begin(ANY, None, 3, fleet, frozenset(), True)
    assert isinstance(held, Hold) and held.code is HoldCode.TOO_FEW_PRINTERS
    away = [printer("a"), printer("b", link=Link.ABSENT), printer("c", attention_reason="it smokes")]
    assert begin(ANY, None, 2, away, frozenset(), True) == Begin(("a",), rounds=2)
    assert begin(ANY, None, 5, fleet, frozenset(), True) == Begin(("a", "c"), rounds=3)


def test_a_job_that_no_printer_matches_is_held_with_the_reason():
    assert (
        find_mismatch(Requirements("generic_abs", None, None), [printer("a")]).code
        is HoldCode.NO_SUCH_PRINTER
    )
    assert find_mismatch(ANY, []).code is HoldCode.NO_SUCH_PRINTER
    assert find_mismatch(ANY, [printer("a", attention_reason="it smokes")]) is None


def test_job_at_night_is_planned_for_unattended_printers():
    fleet = [printer("a"), printer("b"), printer("c", unattended=False)]
    blocked = frozenset("c")
    assert begin(ANY, None, 0, fleet, frozenset(), True, blocked=blocked) == Begin(("a", "b"))
    assert begin(ANY, None, 3, fleet, frozenset(), True, blocked=blocked) == Begin(("a", "b"), rounds=2)
    assert begin(ANY, None, 0, fleet[2:], frozenset(), True, blocked=blocked) == Begin(("c",))
    held = begin(ANY, None, 0, [printer("a", booked=True), fleet[2]], frozenset(), True, blocked=blocked)
    assert isinstance(held, Hold) and held.code is HoldCode.PRINTER_BUSY
    assert begin(ANY, None, 0, fleet, frozenset(), True, needs_approval=True, blocked=blocked) == Begin(
        ("a", "b", "c")
    )


def test_hold_prefers_a_running_print_and_names_a_full_bed():
    busy, full = printer("c", booked=True), printer("b", bed=Bed.NOT_CLEAR)
    for fleet in ([full, busy], [printer("a", attention_reason="it smokes"), full, busy]):
        held = begin(ANY, None, 0, fleet, frozenset(), True)
        assert isinstance(held, Hold) and held.code is HoldCode.PRINTER_BUSY
        assert held.text.startswith(busy.obstacle().text) and "`farm cleared b`" in held.text
    alone = begin(ANY, None, 0, [printer("a", attention_reason="it smokes"), full], frozenset(), True)
    assert isinstance(alone, Hold) and alone.code is HoldCode.NEEDS_INSPECTION


def test_requirements_name_the_missing_room():
    asked = Requirements(None, None, None, (-50.0, -20.0, 50.0, 40.0, 30.0))
    assert asked.describe() == "100 mm of width, 60 mm of depth and 30 mm of height"
