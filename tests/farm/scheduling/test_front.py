"""Whether the job in front can begin, and with which printers."""

from farm.model import Bed, Hold, HoldCode, Link
from farm.scheduling.assign import Need
from farm.scheduling.front import Begin, begin
from make_views import TALL, printer

ANY = Need(None, None, None)


def test_the_front_job_takes_all_that_are_idle_and_clear():
    fleet = [printer("a"), printer("b", bed=Bed.NOT_CLEAR), printer("c", booked=True), printer("d")]
    assert begin(ANY, None, 0, fleet, frozenset()) == Begin(("a", "d"))
    assert begin(ANY, None, 0, fleet, frozenset("d")) == Begin(("a",))
    assert begin(ANY, 1, 0, fleet, frozenset()) == Begin(("a",))


def test_given_fewer_printers_it_takes_the_roomiest():
    fleet = [printer("a"), printer("b", room=TALL)]
    assert begin(ANY, 1, 0, fleet, frozenset()) == Begin(("b",))


def test_it_waits_for_printers_that_are_still_connecting():
    answer = begin(ANY, None, 0, [printer("a"), printer("b", link=Link.STARTING)], frozenset())
    assert isinstance(answer, Hold) and "b" in answer.text


def test_it_waits_for_enough_printers_for_one_round_and_takes_rounds_where_the_fleet_is_too_small():
    fleet = [printer("a"), printer("b", booked=True), printer("c")]
    held = begin(ANY, None, 3, fleet, frozenset())
    assert isinstance(held, Hold) and held.code is HoldCode.TOO_FEW_PRINTERS
    assert begin(ANY, None, 5, fleet, frozenset()) == Begin(("a", "c"), rounds=3)


def test_a_job_that_no_printer_matches_is_held_with_the_reason():
    answer = begin(Need("generic_abs", None, None), None, 0, [printer("a")], frozenset())
    assert isinstance(answer, Hold) and answer.code is HoldCode.NO_SUCH_PRINTER
