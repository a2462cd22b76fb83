"""Scheduling at `next_change_s` only, compared with scheduling at every tick."""

import math
from dataclasses import replace
from datetime import datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from books.scheduling_examples import UTC, make_plate, make_printer, make_rules, make_situation
from farm.model import Bed
from farm.scheduling.assignment import assign_plates

HOUR_S = 3600.0
TICK_S = 1200.0
TICK_COUNT = 3 * 24 * 3  # three days
FRIDAY_S = datetime(2026, 11, 20, 17, tzinfo=UTC).timestamp()

rule_sets = st.builds(
    make_rules,
    attended=st.sampled_from([(), ("mon-fri 08:00-18:00",), ("08:00-10:00", "16:00-18:00")]),
    quiet=st.sampled_from([(), ("22:00-06:00",), ("sat 12:00-14:00",)]),
    first_layers_attended=st.booleans(),
    max_heating=st.none() | st.integers(1, 2),
)
fleets = st.lists(
    st.builds(
        make_printer,
        st.sampled_from("abcd"),
        bed=st.sampled_from([Bed.CLEAR, Bed.CLEAR, Bed.NOT_CLEAR]),
        is_booked=st.booleans(),
        may_print_unattended=st.booleans(),
    ),
    unique_by=lambda p: p.name,
)
plates = st.lists(
    st.builds(
        make_plate,
        st.uuids().map(str),
        st.sampled_from("abcd"),
        expected_s=st.floats(600, 20 * HOUR_S),
        first_layer_s=st.floats(300, 900),
        job=st.integers(1, 3),
        failed_on=st.frozensets(st.sampled_from("abcd")),
        not_before_s=st.none() | st.floats(FRIDAY_S, FRIDAY_S + 30 * HOUR_S),
    ),
    unique_by=lambda p: p.id,
    max_size=6,
)


def start_plates(situation):
    """Schedule until nothing starts, and remove the started plates from the queue each time."""
    starts = []
    while assignments := assign_plates(situation):
        starts += assignments
        started_printers = {item.printer for item in assignments}
        situation = situation.without({item.plate for item in assignments}).with_printers(
            tuple(replace(p, is_booked=True) if p.name in started_printers else p for p in situation.printers)
        )
    return situation, starts


@given(plates, fleets, rule_sets)
@settings(max_examples=60, deadline=None)
def test_no_start_changes_before_the_next_change(waiting_plates, fleet, start_rules):
    eager_situation = lazy_situation = make_situation(waiting_plates, fleet, start_rules, FRIDAY_S)
    due_s = -math.inf
    for tick in range(TICK_COUNT):
        now_s = FRIDAY_S + tick * TICK_S
        eager_situation, eager_starts = start_plates(replace(eager_situation, now_s=now_s))
        lazy_starts = []
        if now_s >= due_s:
            lazy_situation, lazy_starts = start_plates(replace(lazy_situation, now_s=now_s))
            due_s = lazy_situation.find_next_change_s()
        assert lazy_starts == eager_starts


@pytest.mark.parametrize(
    ("start_rules", "changes", "after_s"),
    [
        (make_rules(), {}, math.inf),  # only an event changes a decision
        # The attended hours end.
        (
            make_rules(attended=["mon-fri 08:00-18:00"]),
            {"expected_s": 20 * HOUR_S},
            HOUR_S,
        ),
        # A later start would end too close to quiet hours.
        (
            make_rules(quiet=["22:00-06:00"]),
            {"expected_s": HOUR_S},
            (5 - 1.05) * HOUR_S,
        ),
        (make_rules(), {"not_before_s": FRIDAY_S + 60.0}, 60.0),
    ],
)
def test_next_change_is_computed(start_rules, changes, after_s):
    situation = make_situation([make_plate("x", "a", **changes)], [make_printer("a")], start_rules, FRIDAY_S)
    assert situation.find_next_change_s() - FRIDAY_S == pytest.approx(after_s, abs=0.01)
