"""Schedule of camera requests: decisions on data alone."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.cameras.schedule import (
    END_STILL_TIMEOUT_S,
    MAX_INTERVAL_S,
    MIN_INTERVAL_S,
    CameraState,
    DueStill,
    find_due_stills,
)
from farm.model import AgentPrint, AgentSnapshot, Link, Moment, PrintState, Still
from farm.state import events as ev

CAMERAS = frozenset("ab")


@given(st.lists(st.tuples(st.floats(0.0, 100.0), st.booleans()), max_size=30))
def test_attempts_are_two_seconds_apart_and_at_least_one_a_minute_is_allowed(steps):
    state, now_s, begin_times_s = CameraState(), 0.0, []
    for wait_s, succeeds in steps:
        now_s += wait_s
        assert state.next_attempt_s <= (state.last_attempt_s or 0.0) + MAX_INTERVAL_S
        if now_s >= state.next_attempt_s:
            begin_times_s.append(now_s)
            state = state.begin(now_s)
            state = state.succeed() if succeeds else state.fail("dead")
    assert all(
        next_attempt_s >= previous_s + MIN_INTERVAL_S  # as computed: 2.8 - 0.8 is less than 2
        for previous_s, next_attempt_s in itertools.pairwise(begin_times_s)
    )


def test_dead_camera_is_polled_with_growing_intervals():
    state, waits_s = CameraState(), []
    for _ in range(7):
        state = state.begin(100.0).fail("dead")
        waits_s.append(state.next_attempt_s - 100.0)
    assert waits_s == [4.0, 8.0, 16.0, 32.0, 60.0, 60.0, 60.0]
    assert state.begin(100.0).succeed().next_attempt_s == 102.0


def make_books_with_open_print():
    return apply_events(
        make_planned_books(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.PrintProgressed(print_id="x", at_s=3.0, state=PrintState.PRINTING, started_s=2.0, extruded=True),
    )[0]


def make_snapshots(layer, layers=100, state=PrintState.PRINTING, print_id="x"):
    agent_print = AgentPrint(
        print_id=print_id, state=state, fault=None, reason=None, progress_s=1.0, print_time_s=90.0,
        extruded=True, started_s=2.0, ended_s=None, layers=layers, layer=layer,
    )  # fmt: skip
    return {"a": AgentSnapshot(printer="a", link=Link.BUSY, print=agent_print)}


def find_stills(books, snapshots, now_s=1000.0, scale=1.0, cameras=CAMERAS):
    return list(find_due_stills(books, snapshots, cameras, now_s, scale))


@pytest.mark.parametrize(
    ("snapshots", "is_due"),
    [
        ({}, False),
        (make_snapshots(None), False),
        (make_snapshots(1), False),
        (make_snapshots(2), True),
        (make_snapshots(10), True),
        (make_snapshots(11), False),  # the first layer is no longer visible
        (make_snapshots(3, layers=5), True),
        (make_snapshots(2, state=PrintState.PAUSED), False),  # its head is parked, but the bed is still warm
        (make_snapshots(2, print_id="another"), False),
    ],
)
def test_still_of_the_first_layer_is_taken_when_complete(snapshots, is_due):
    due_stills = [DueStill("x", "a", Moment.FIRST_LAYER)] if is_due else []
    assert find_stills(make_books_with_open_print(), snapshots) == due_stills


@pytest.mark.parametrize(
    ("state", "moment"),
    [
        (PrintState.DONE, Moment.END),
        (PrintState.FAILED, Moment.FAILURE),
    ],
)
def test_still_of_the_end_is_taken_within_a_minute(state, moment):
    books, _ = apply_events(make_books_with_open_print(), make_end_event("x", state, at_s=200.0))
    due_stills = [DueStill("x", "a", moment)]
    assert find_stills(books, {}, 200.0) == find_stills(books, {}, 200.0 + END_STILL_TIMEOUT_S) == due_stills
    assert find_stills(books, {}, 201.0 + END_STILL_TIMEOUT_S) == find_stills(books, {}, 199.0) == []
    assert find_stills(books, {}, 200.0 + 50 * END_STILL_TIMEOUT_S, scale=50.0) == due_stills


def test_still_is_taken_once():
    still = Still(moment=Moment.FIRST_LAYER, at_s=4.0, file="s.jpg")
    books, _ = apply_events(make_books_with_open_print(), ev.StillKept(at_s=4.0, print_id="x", still=still))
    assert find_stills(books, make_snapshots(2)) == []
    books, _ = apply_events(books, make_end_event("x"))
    assert find_stills(books, {}, 200.0) == [DueStill("x", "a", Moment.END)]
    later_still = still.model_copy(update={"file": "t.jpg"})
    books, _ = apply_events(books, ev.StillKept(at_s=5.0, print_id="x", still=later_still))
    assert books.prints["x"].stills == (later_still,)  # at most one for each moment


def test_printer_without_a_camera_is_not_polled():
    assert find_stills(make_books_with_open_print(), make_snapshots(2), cameras=frozenset({"b", "new"})) == []
