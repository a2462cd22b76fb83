"""Policy of replanning: only if the part ends sooner by the margin, and if it is possible."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from decompose.engines.guillotine import ASSEMBLE_S, CLEAR_S
from farm.model import Bed, HoldCode
from farm.planning.replanning import policy
from farm.scheduling.matching import Capabilities, Requirements
from scheduling_examples import LOW, box, plate, printer, rules, situation

HOUR = 3600.0
NOW_S = 1_000_000.0 // 604800 * 604800 + 4 * 86400 + 20 * HOUR  # Monday, 20:00 UTC
NIGHT = rules(attended=["08:00-18:00"])
PLUS, PLAIN = "ultimaker2_plus", "ultimaker2"


def printer_of(name, family, nozzle_mm=0.4, **changes):
    return replace(
        printer(name, **changes), capabilities=Capabilities(LOW, "generic_pla", None, nozzle_mm, family)
    )


def part(hours=10.0, **changes):
    facts = {
        "requirements": Requirements("generic_pla", None, 0.4, box(100.0), PLUS),
        "heating_s": 300.0,
        "grams": 50.0,
    }
    return plate("1/01", "a", **{**facts, "expected_s": hours * HOUR, **changes})


def test_cost_of_a_piece_equals_that_of_a_decomposition():
    assert policy.JOIN_S == CLEAR_S + ASSEMBLE_S


def test_plate_of_a_bed_full_until_morning_is_resliced():
    full, other = printer_of("a", PLUS, bed=Bed.NOT_CLEAR), printer_of("b", PLAIN)
    choice = policy.choose_reslice(part(), situation([part()], [full, other], NIGHT, NOW_S), [other])
    assert choice == policy.Reslice("1/01", "b")
    assert policy.waits_for_its_printer_kind(HoldCode.BED_NOT_CLEAR)


@pytest.mark.parametrize(
    ("changes", "other"),
    [
        ({}, {"family": PLAIN, "grams": 10.0}),  # too little filament
        ({"failed_on": frozenset("b")}, {"family": PLAIN}),
        ({"places": 0}, {"family": PLAIN}),  # its job prints on as many as it was given
        ({"requirements": Requirements("generic_abs", None, 0.4, box(100.0), PLUS)}, {"family": PLAIN}),
        (
            {"requirements": Requirements("generic_pla", None, 0.4, box(250.0), PLUS)},
            {"family": PLAIN},
        ),  # too high
        ({}, {"family": PLUS, "nozzle_mm": 0.25}),  # 25 h on the finer nozzle: the bed is cleared before
        ({}, {"family": PLAIN, "unattended": False}),
    ],
)
def test_plate_waits_if_the_other_printer_does_not_match(changes, other):
    full = printer_of("a", PLUS, bed=Bed.NOT_CLEAR)
    free = printer_of("b", **other)
    view = part(**changes)
    assert policy.choose_reslice(view, situation([view], [full, free], NIGHT, NOW_S), [free]) is None


def test_plate_waits_if_its_printer_is_free_soon():
    """Ten hours: a fifth of the waiting time has to be saved."""

    def choice(hours):
        busy = printer_of("a", PLUS, booked=True, free_s=NOW_S + hours * HOUR)
        other = printer_of("b", PLAIN)
        return policy.choose_reslice(part(), situation([part()], [busy, other], rules(), NOW_S), [other])

    assert choice(2.0) is None
    assert choice(4.0) is not None


def test_part_of_a_removed_printer_model_is_sliced_for_another():
    other = printer_of("b", PLAIN)
    assert policy.choose_reslice(part(), situation([part()], [other], rules(), NOW_S), [other]) is not None


def test_printer_to_be_inspected_counts_only_with_attended_hours():
    broken, other = (
        printer_of("a", PLUS, attention_reason="no heat"),
        printer_of("b", PLAIN, time_factor=2.0),
    )  # 20 h

    def choice(start_rules):
        return policy.choose_reslice(
            part(), situation([part()], [broken, other], start_rules, NOW_S), [other]
        )

    assert choice(NIGHT) is None  # by 18:15 on the next day
    assert choice(rules()) == policy.Reslice("1/01", "b")


def test_failed_part_is_cut_for_printers_not_needed_by_others():
    fleet = [printer_of(name, PLUS) for name in "abcd"]
    failed = part(failed_on=frozenset("a"))
    other = plate("1/02", "b", expected_s=HOUR)
    choice = policy.choose_recut(failed, situation([failed, other], fleet, NIGHT, NOW_S))
    assert choice == policy.Recut("1/01", ("c", "d", "a"))
    short = part(hours=1.0)
    assert policy.choose_recut(short, situation([short], fleet, NIGHT, NOW_S)) is None
    two = part(places=2)
    assert len(policy.choose_recut(two, situation([two], fleet, NIGHT, NOW_S)).printers) == 2
    assert policy.choose_recut(part(places=1), situation([part(places=1)], fleet, NIGHT, NOW_S)) is None
    assert policy.choose_recut(failed, situation([failed], fleet[:1], NIGHT, NOW_S)) is None


def test_part_of_a_removed_model_is_cut_only_if_reslicing_is_worse():
    fleet = [printer_of(name, PLAIN) for name in "bc"]
    short, long = part(hours=1.0), part(hours=10.0)
    assert policy.compute_expected_end_s(short, situation([short], fleet, NIGHT, NOW_S)) == float("inf")
    assert policy.choose_recut(short, situation([short], fleet, NIGHT, NOW_S)) is None
    assert policy.choose_reslice(short, situation([short], fleet, NIGHT, NOW_S), fleet) == policy.Reslice(
        "1/01", "b"
    )
    assert policy.choose_recut(long, situation([long], fleet, NIGHT, NOW_S)) == policy.Recut(
        "1/01", ("b", "c")
    )


def test_pieces_may_end_before_quiet_hours_unlike_the_whole_part():
    start_rules = rules(quiet=["06:00-22:00"])
    now_s = NOW_S + 3 * HOUR  # 23:00
    fleet = [printer_of(name, PLUS) for name in "abc"]
    assert policy.choose_recut(part(), situation([part()], fleet, start_rules, now_s)) is not None


fleets = st.lists(
    st.builds(
        printer_of,
        st.sampled_from("abcdef"),
        st.sampled_from([PLUS, PLAIN]),
        nozzle_mm=st.sampled_from([0.4, 0.8]),
        booked=st.booleans(),
        free_s=st.none() | st.floats(NOW_S, NOW_S + 20 * HOUR),
        bed=st.sampled_from([Bed.CLEAR, Bed.NOT_CLEAR]),
        grams=st.none() | st.floats(0, 200),
        time_factor=st.sampled_from([0.9, 1.0, 1.2]),
    ),
    min_size=1,
    unique_by=lambda p: p.name,
)
parts = st.builds(
    part,
    st.floats(0.5, 20.0),
    failed_on=st.frozensets(st.sampled_from("abcdef"), max_size=2),
    places=st.none() | st.integers(0, 3),
    grams=st.floats(1, 150),
)


@given(parts, fleets)
def test_recut_requests_matching_free_printers_if_useful(view, fleet):
    by_name = {p.name: p for p in fleet}
    free = [p for p in fleet if p.obstacle() is None]
    whole_s = policy.compute_expected_end_s(view, situation([view], fleet, NIGHT, NOW_S))
    sliced = policy.choose_reslice(view, situation([view], fleet, NIGHT, NOW_S), free)
    if sliced is not None:
        other = by_name[sliced.printer]
        assert other.obstacle() is None
        assert not view.requirements.matches(other.capabilities)
        assert (other.capabilities.material, other.name in view.failed_on) == ("generic_pla", False)
        assert whole_s - NOW_S > policy.MIN_GAIN_S
    cut = policy.choose_recut(view, situation([view], fleet, NIGHT, NOW_S))
    if cut is not None:
        assert 2 <= len(set(cut.printers)) == len(cut.printers) <= policy.MAX_PIECES
        assert all(by_name[name].obstacle() is None for name in cut.printers)
        assert view.places is None or len(cut.printers) <= view.places
        assert whole_s - NOW_S > policy.MIN_GAIN_S + 2 * policy.JOIN_S
    assert policy.choose_reslice(view, situation([view], fleet[::-1], NIGHT, NOW_S), free[::-1]) == sliced
    assert policy.choose_recut(view, situation([view], fleet[::-1], NIGHT, NOW_S)) == cut
