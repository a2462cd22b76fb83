"""Policy of replanning: a part is replanned only if this is possible and saves enough time."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.scheduling_examples import (
    LOW_BOXES,
    make_box,
    make_plate,
    make_printer,
    make_rules,
    make_situation,
)
from decompose.engines.guillotine import ASSEMBLY_S, CLEARING_S
from farm.model import Bed, HoldCode, TimeFactors
from farm.planning.replanning import policy
from farm.scheduling.matching import Capabilities, Requirements

HOUR_S = 3600.0
NOW_S = 1_000_000.0 // 604800 * 604800 + 4 * 86400 + 20 * HOUR_S  # Monday, 20:00 UTC
ATTENDED_RULES = make_rules(attended=["08:00-18:00"])
PLUS, UM2 = "ultimaker2_plus", "ultimaker2"


def make_family_printer(name, family, nozzle_mm=0.4, **changes):
    return replace(
        make_printer(name, **changes),
        capabilities=Capabilities(LOW_BOXES, "generic_pla", None, nozzle_mm, family),
    )


def make_part(duration_h=10.0, **changes):
    fields = {
        "requirements": Requirements("generic_pla", None, 0.4, make_box(100.0), PLUS),
        "overhead_s": 300.0,
        "grams": 50.0,
    }
    return make_plate("1/01", "a", **{**fields, "expected_s": duration_h * HOUR_S, **changes})


def test_cost_of_a_piece_equals_that_of_a_decomposition():
    assert policy.JOINING_TIME_S == CLEARING_S + ASSEMBLY_S


def test_plate_of_a_bed_full_until_morning_is_resliced():
    full_printer, other_printer = (
        make_family_printer("a", PLUS, bed=Bed.NOT_CLEAR),
        make_family_printer("b", UM2),
    )
    choice = policy.choose_reslice(
        make_part(),
        make_situation([make_part()], [full_printer, other_printer], ATTENDED_RULES, NOW_S),
        [other_printer],
    )
    assert choice == policy.Reslice("1/01", "b")
    assert policy.depends_on_printer_kind(HoldCode.BED_NOT_CLEAR)


@pytest.mark.parametrize(
    ("changes", "other_fields"),
    [
        ({}, {"family": UM2, "grams": 10.0}),  # too little filament
        ({"failed_on": frozenset("b")}, {"family": UM2}),
        ({"extra_printer_count": 0}, {"family": UM2}),  # its job already uses its maximum number of printers
        ({"requirements": Requirements("generic_abs", None, 0.4, make_box(100.0), PLUS)}, {"family": UM2}),
        # The part is too high for the other family.
        (
            {"requirements": Requirements("generic_pla", None, 0.4, make_box(250.0), PLUS)},
            {"family": UM2},
        ),
        ({}, {"family": PLUS, "nozzle_mm": 0.25}),  # 25 h on the finer nozzle: the bed is cleared before that
        ({}, {"family": UM2, "may_print_unattended": False}),
    ],
)
def test_plate_waits_if_the_other_printer_does_not_match(changes, other_fields):
    full_printer = make_family_printer("a", PLUS, bed=Bed.NOT_CLEAR)
    free_printer = make_family_printer("b", **other_fields)
    part = make_part(**changes)
    assert (
        policy.choose_reslice(
            part, make_situation([part], [full_printer, free_printer], ATTENDED_RULES, NOW_S), [free_printer]
        )
        is None
    )


def test_plate_waits_if_its_printer_is_free_soon():
    """Use a plate of ten hours: a fifth of the waiting time has to be saved."""

    def choose_reslice(free_in_h):
        busy_printer = make_family_printer("a", PLUS, is_booked=True, print_end_s=NOW_S + free_in_h * HOUR_S)
        other_printer = make_family_printer("b", UM2)
        return policy.choose_reslice(
            make_part(),
            make_situation([make_part()], [busy_printer, other_printer], make_rules(), NOW_S),
            [other_printer],
        )

    assert choose_reslice(2.0) is None
    assert choose_reslice(4.0) is not None


def test_part_of_a_removed_printer_model_is_sliced_for_another():
    other_printer = make_family_printer("b", UM2)
    assert (
        policy.choose_reslice(
            make_part(), make_situation([make_part()], [other_printer], make_rules(), NOW_S), [other_printer]
        )
        is not None
    )


def test_printer_to_be_inspected_counts_only_with_attended_hours():
    # The other printer needs 20 h.
    broken_printer, other_printer = (
        make_family_printer("a", PLUS, attention_reason="no heat"),
        make_family_printer("b", UM2, time_factors=TimeFactors(2.0)),
    )

    def choose_reslice(start_rules):
        return policy.choose_reslice(
            make_part(),
            make_situation([make_part()], [broken_printer, other_printer], start_rules, NOW_S),
            [other_printer],
        )

    assert choose_reslice(ATTENDED_RULES) is None  # its own printer ends by 18:15 on the next day
    assert choose_reslice(make_rules()) == policy.Reslice("1/01", "b")


def test_failed_part_is_cut_for_printers_not_needed_by_others():
    fleet = [make_family_printer(name, PLUS) for name in "abcd"]
    failed_part = make_part(failed_on=frozenset("a"))
    other_plate = make_plate("1/02", "b", expected_s=HOUR_S)
    choice = policy.choose_recut(
        failed_part, make_situation([failed_part, other_plate], fleet, ATTENDED_RULES, NOW_S)
    )
    assert choice == policy.Recut("1/01", ("c", "d", "a"))
    short_part = make_part(duration_h=1.0)
    assert policy.choose_recut(short_part, make_situation([short_part], fleet, ATTENDED_RULES, NOW_S)) is None
    part_for_two_printers = make_part(extra_printer_count=2)
    assert (
        len(
            policy.choose_recut(
                part_for_two_printers, make_situation([part_for_two_printers], fleet, ATTENDED_RULES, NOW_S)
            ).printers
        )
        == 2
    )
    assert (
        policy.choose_recut(
            make_part(extra_printer_count=1),
            make_situation([make_part(extra_printer_count=1)], fleet, ATTENDED_RULES, NOW_S),
        )
        is None
    )
    assert (
        policy.choose_recut(failed_part, make_situation([failed_part], fleet[:1], ATTENDED_RULES, NOW_S))
        is None
    )


def test_part_of_a_removed_model_is_cut_only_if_reslicing_is_worse():
    fleet = [make_family_printer(name, UM2) for name in "bc"]
    short_part, long_part = make_part(duration_h=1.0), make_part(duration_h=10.0)
    assert policy.compute_expected_end_s(
        short_part, make_situation([short_part], fleet, ATTENDED_RULES, NOW_S)
    ) == float("inf")
    assert policy.choose_recut(short_part, make_situation([short_part], fleet, ATTENDED_RULES, NOW_S)) is None
    assert policy.choose_reslice(
        short_part, make_situation([short_part], fleet, ATTENDED_RULES, NOW_S), fleet
    ) == policy.Reslice("1/01", "b")
    assert policy.choose_recut(
        long_part, make_situation([long_part], fleet, ATTENDED_RULES, NOW_S)
    ) == policy.Recut("1/01", ("b", "c"))


def test_pieces_may_end_before_quiet_hours_unlike_the_whole_part():
    start_rules = make_rules(quiet=["06:00-22:00"])
    now_s = NOW_S + 3 * HOUR_S  # 23:00
    fleet = [make_family_printer(name, PLUS) for name in "abc"]
    assert (
        policy.choose_recut(make_part(), make_situation([make_part()], fleet, start_rules, now_s)) is not None
    )


fleets = st.lists(
    st.builds(
        make_family_printer,
        st.sampled_from("abcdef"),
        st.sampled_from([PLUS, UM2]),
        nozzle_mm=st.sampled_from([0.4, 0.8]),
        is_booked=st.booleans(),
        print_end_s=st.none() | st.floats(NOW_S, NOW_S + 20 * HOUR_S),
        bed=st.sampled_from([Bed.CLEAR, Bed.NOT_CLEAR]),
        grams=st.none() | st.floats(0, 200),
        time_factors=st.sampled_from([0.9, 1.0, 1.2]).map(TimeFactors),
    ),
    min_size=1,
    unique_by=lambda p: p.name,
)
parts = st.builds(
    make_part,
    st.floats(0.5, 20.0),
    failed_on=st.frozensets(st.sampled_from("abcdef"), max_size=2),
    extra_printer_count=st.none() | st.integers(0, 3),
    grams=st.floats(1, 150),
)


@given(parts, fleets)
def test_recut_requests_matching_free_printers_if_useful(part, fleet):
    printers_by_name = {p.name: p for p in fleet}
    free_printers = [p for p in fleet if p.find_obstacle() is None]
    whole_s = policy.compute_expected_end_s(part, make_situation([part], fleet, ATTENDED_RULES, NOW_S))
    reslice = policy.choose_reslice(part, make_situation([part], fleet, ATTENDED_RULES, NOW_S), free_printers)
    if reslice is not None:
        other_printer = printers_by_name[reslice.printer]
        assert other_printer.find_obstacle() is None
        assert not part.requirements.matches(other_printer.capabilities)
        assert (other_printer.capabilities.material, other_printer.name in part.failed_on) == (
            "generic_pla",
            False,
        )
        assert whole_s - NOW_S > policy.MIN_GAIN_S
    recut = policy.choose_recut(part, make_situation([part], fleet, ATTENDED_RULES, NOW_S))
    if recut is not None:
        assert 2 <= len(set(recut.printers)) == len(recut.printers) <= policy.MAX_PIECES
        assert all(printers_by_name[name].find_obstacle() is None for name in recut.printers)
        assert part.extra_printer_count is None or len(recut.printers) <= part.extra_printer_count
        assert whole_s - NOW_S > policy.MIN_GAIN_S + 2 * policy.JOINING_TIME_S
    assert (
        policy.choose_reslice(
            part, make_situation([part], fleet[::-1], ATTENDED_RULES, NOW_S), free_printers[::-1]
        )
        == reslice
    )
    assert policy.choose_recut(part, make_situation([part], fleet[::-1], ATTENDED_RULES, NOW_S)) == recut
