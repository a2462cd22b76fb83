"""Snapshots in memory: only changes that the books or the scheduler read are reported."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_planned_books
from farm.control.telemetry import TEMPERATURE_RETENTION_S, Telemetry, TemperatureRecord, compare_snapshot
from farm.model import AgentPrint, AgentSnapshot, Link, PrintState
from farm.state import events as ev

CELSIUS = st.none() | st.floats(-20.0, 300.0)
SECONDS = st.floats(0.0, 1e5)


def make_books():
    assigned_event = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="p")
    started_event = ev.PrintProgressed(
        at_s=3.0, print_id="p", state=PrintState.PRINTING, started_s=3.0, extruded=True
    )
    return apply_events(make_planned_books(), assigned_event, started_event)[0]


BOOKS = make_books()
PRINT = AgentPrint(
    print_id="p", state=PrintState.PRINTING, fault=None, reason=None, progress_s=1.0, print_time_s=90.0,
    extruded=True, started_s=3.0, ended_s=None,
)  # fmt: skip
BUSY_SNAPSHOT = AgentSnapshot(printer="a", link=Link.BUSY, agent_pid=9, print=PRINT)


@given(nozzle_c=CELSIUS, bed_c=CELSIUS, target_c=CELSIUS, progress_s=SECONDS, layer=st.integers(1, 999))
def test_telemetry_without_changes_is_not_reported(nozzle_c, bed_c, target_c, progress_s, layer):
    telemetry = Telemetry()
    assert telemetry.store(BUSY_SNAPSHOT, 60.0)
    agent_print = PRINT.model_copy(update={"progress_s": progress_s, "layer": layer, "z_mm": layer * 0.1})
    heat = {"nozzle_c": nozzle_c, "bed_c": bed_c, "nozzle_target_c": target_c, "bed_target_c": target_c}
    later_snapshot = BUSY_SNAPSHOT.model_copy(update={"print": agent_print, **heat})
    assert not telemetry.store(later_snapshot, 60.0)
    changes = compare_snapshot(BOOKS, later_snapshot, BUSY_SNAPSHOT, True, 60.0)
    assert (changes.events, changes.instructions, changes.invalid_transition) == ((), (), None)
    assert telemetry.snapshots["a"] == later_snapshot


def test_rejected_snapshot_is_compared_again_and_shown():
    telemetry = Telemetry()
    telemetry.store(BUSY_SNAPSHOT, 60.0)
    lost_snapshot = BUSY_SNAPSHOT.model_copy(update={"link": Link.ABSENT, "nozzle_c": 180.0})
    assert telemetry.store(lost_snapshot, 60.0)
    telemetry.reject(lost_snapshot, BUSY_SNAPSHOT, "the disk is full")
    assert telemetry.list_warnings(Path("/s"))[0].startswith("the disk is full; nothing is recorded")
    shown_snapshot = telemetry.snapshots["a"]
    assert (shown_snapshot.link, shown_snapshot.nozzle_c) == (Link.BUSY, 180.0)
    assert telemetry.store(lost_snapshot, 60.0)
    assert telemetry.list_warnings(Path("/s")) == ()


def test_snapshot_is_compared_step_by_step():
    """Compare in steps, because the result for an unknown print depends on the bed after the known one."""
    other_print = PRINT.model_copy(update={"print_id": "q", "state": PrintState.DONE, "ended_s": 50.0})
    ready_snapshot = AgentSnapshot(printer="a", link=Link.READY, agent_pid=9, print=other_print)
    changes = compare_snapshot(BOOKS, ready_snapshot, BUSY_SNAPSHOT, True, 60.0)
    kinds = [type(event).__name__ for event in changes.events]
    assert kinds == ["PrintEnded", "BedBecameUnknown"]
    assert [type(item).__name__ for item in changes.instructions] == ["SendForget"]


def record_readings(*readings):
    """Record readings; return the times and temperatures that are stored."""
    temperatures = TemperatureRecord()
    for at_s, nozzle_c, bed_c in readings:
        snapshot = AgentSnapshot(printer="a", link=Link.READY, nozzle_c=nozzle_c, bed_c=bed_c)
        temperatures.add(snapshot, at_s)
    return [(sample.at_s, sample.nozzle_c, sample.bed_c) for sample in temperatures.readings]


def test_hottest_reading_of_a_minute_is_kept():
    readings = [(float(s), 290.0 if s == 30 else 210.0, 60.0) for s in range(120)]
    assert record_readings(*readings) == [(0.0, 290, 60), (60.0, 210, 60)]


def test_printer_without_an_answer_leaves_one_gap():
    silent_readings = [(20.0 + s, None, None) for s in range(300)]
    assert record_readings((0.0, 20.4, 19.6), *silent_readings, (330.0, 21.0, 20.0)) == [
        (0.0, 20, 20),
        (20.0, None, None),
        (330.0, 21, 20),
    ]


@given(st.lists(st.tuples(st.floats(0.0, 1e6), CELSIUS, CELSIUS), max_size=200))
def test_temperatures_are_bounded_and_in_order_even_if_the_clock_is_set_back(readings):
    temperatures = record_readings(*readings)
    assert [at_s for at_s, *_ in temperatures] == sorted(at_s for at_s, *_ in temperatures)
    assert len(temperatures) <= TEMPERATURE_RETENTION_S / 60.0


def test_temperatures_older_than_twelve_hours_are_not_listed():
    """Omit old readings, because a chart would span years after a long absence or a clock step."""
    telemetry = Telemetry()
    telemetry.store(BUSY_SNAPSHOT.model_copy(update={"nozzle_c": 200.0}), 0.0)
    telemetry.store(BUSY_SNAPSHOT.model_copy(update={"nozzle_c": 21.0}), 1.7e9)
    assert [sample.nozzle_c for sample in telemetry.list_temperatures("a", 1.7e9)] == [21]
    assert telemetry.list_temperatures("a", 1.7e9 + TEMPERATURE_RETENTION_S + 1.0) == ()


def test_implausible_reading_is_limited():
    """Limit readings, because a chart has a line for every fifty degrees."""
    assert record_readings((0.0, 1e300, -1e300)) == [(0.0, 999, -99)]


def test_number_of_stored_temperatures_is_bounded_over_weeks():
    assert (
        len(record_readings(*((60.0 * n, 20.0, 20.0) for n in range(20_000))))
        == TEMPERATURE_RETENTION_S / 60.0
    )
