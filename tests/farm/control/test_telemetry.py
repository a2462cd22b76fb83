"""Snapshots in memory: only changes that the books or the scheduler read are reported."""

from hypothesis import given
from hypothesis import strategies as st

from farm.control.telemetry import Telemetry, read_snapshot
from farm.model import AgentPrint, AgentSnapshot, Link, PrintState
from farm.state import events as ev
from make_books import printing, run

CELSIUS = st.none() | st.floats(-20.0, 300.0)
SECONDS = st.floats(0.0, 1e5)


def printing_books():
    assigned = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="p")
    started = ev.PrintProgressed(
        at_s=3.0, print_id="p", state=PrintState.PRINTING, started_s=3.0, extruded=True
    )
    return run(printing(), assigned, started)[0]


BOOKS = printing_books()
SAID = AgentPrint(
    print_id="p", state=PrintState.PRINTING, fault=None, reason=None, progress_s=1.0, print_time_s=90.0,
    extruded=True, started_s=3.0, ended_s=None,
)  # fmt: skip
BUSY = AgentSnapshot(printer="a", link=Link.BUSY, agent_pid=9, print=SAID)


@given(nozzle_c=CELSIUS, bed_c=CELSIUS, target_c=CELSIUS, progress_s=SECONDS, layer=st.integers(1, 999))
def test_telemetry_without_changes_is_not_reported(nozzle_c, bed_c, target_c, progress_s, layer):
    telemetry = Telemetry()
    assert telemetry.store(BUSY)
    message = SAID.model_copy(update={"progress_s": progress_s, "layer": layer, "z_mm": layer * 0.1})
    heat = {"nozzle_c": nozzle_c, "bed_c": bed_c, "nozzle_target_c": target_c, "bed_target_c": target_c}
    later = BUSY.model_copy(update={"print": message, **heat})
    assert not telemetry.store(later)
    reading = read_snapshot(BOOKS, later, BUSY, True, 60.0)
    assert (reading.events, reading.instructions, reading.misfit) == ((), (), None)
    assert telemetry.snapshots["a"] == later


def test_rejected_snapshot_is_compared_again_and_shown():
    telemetry = Telemetry()
    telemetry.store(BUSY)
    lost = BUSY.model_copy(update={"link": Link.ABSENT, "nozzle_c": 180.0})
    assert telemetry.store(lost)
    telemetry.reject(lost, BUSY, "the disk is full")
    assert telemetry.failure == "the disk is full"
    shown = telemetry.snapshots["a"]
    assert (shown.link, shown.nozzle_c) == (Link.BUSY, 180.0)
    assert telemetry.store(lost)
    assert telemetry.failure is None


def test_snapshot_is_compared_step_by_step():
    """The outcome of an unknown print depends on the bed that the known one left."""
    other = SAID.model_copy(update={"print_id": "q", "state": PrintState.DONE, "ended_s": 50.0})
    ready = AgentSnapshot(printer="a", link=Link.READY, agent_pid=9, print=other)
    reading = read_snapshot(BOOKS, ready, BUSY, True, 60.0)
    kinds = [type(event).__name__ for event in reading.events]
    assert kinds == ["PrintEnded", "BedBecameUnknown"]
    assert [type(item).__name__ for item in reading.instructions] == ["SendForget"]
