"""Snapshots of agents as the farm's records."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.clock import Clock
from farm.agents.protocol_adapter import to_farm_lines, to_farm_snapshot
from farm.config import Fleet
from farm.model import FilamentState, Link
from farm.paths import StateFolder
from farm.state import Books
from farm.state import events as ev
from farm.state.transitions import apply
from farm.views import ViewContext, describe_printer

CLOCK = Clock(1.0, 0.0)


def make_snapshot(**fields):
    return m.Snapshot.model_validate(
        {"printer": "a", "agent_pid": 7, "link": "ready", "protocol": m.PROTOCOL, **fields}
    )


def convert_snapshot(snapshot, is_simulated=False, is_bed_cleared=False):
    return to_farm_snapshot(snapshot, CLOCK, "a", is_simulated, is_bed_cleared)


@pytest.mark.parametrize("field", ["alarm", "bed_unknown_reason"])
def test_earlier_snapshot_does_not_undo_a_cleared_bed(field):
    """Ignore the alarm of a snapshot that left its agent before the command arrived."""
    snapshot = make_snapshot(alarm="the nozzle stays hot", doubt="the board was reset")
    assert getattr(convert_snapshot(snapshot), field) is not None
    assert getattr(convert_snapshot(snapshot, is_bed_cleared=True), field) is None


def test_readings_of_a_printer_are_copied_to_its_view():
    readings = {"heaters_off": True, "board_resets": 3}
    assert set(readings) == set(m.PrinterReadings.model_fields)
    snapshot_view = convert_snapshot(make_snapshot(**readings))
    assert snapshot_view.dump_readings() == readings
    fleet = Fleet.model_validate({"printers": [{"name": "a", "model": "m", "port": "/dev/a"}]})
    books, _ = apply(ev.PrinterAdded(at_s=0.0, printer="a", bed="clear"), Books())
    context = ViewContext(fleet, books, {"a": snapshot_view}, StateFolder(Path("/state")), 0.0)
    assert describe_printer(context, fleet.find_printer("a"), None).dump_readings() == readings


def test_only_emulators_report_their_bed():
    snapshot = make_snapshot(bed_clear=True)
    assert convert_snapshot(snapshot, is_simulated=True).bed_clear is True
    assert convert_snapshot(snapshot).bed_clear is None


def test_snapshot_is_attributed_to_the_printer_of_its_agent():
    assert convert_snapshot(make_snapshot(printer="b")).printer == "a"


def test_filament_of_an_older_agent_is_unknown_to_the_farm():
    base_fields = {"filament": "parked", "doubt": "the board was reset"}
    assert convert_snapshot(make_snapshot(**base_fields)).filament is FilamentState.PARKED
    assert convert_snapshot(make_snapshot(**base_fields, protocol=2)).filament is FilamentState.UNKNOWN
    assert convert_snapshot(make_snapshot(filament="parked", protocol=2)).filament is FilamentState.PARKED


def test_idle_agent_of_an_older_version_gets_no_prints():
    old_snapshot = convert_snapshot(make_snapshot(protocol=m.StartPrint.min_protocol - 1))
    assert (old_snapshot.link, old_snapshot.outdated) == (Link.FAULT, True)
    assert "farm up --replace a" in old_snapshot.reason


@pytest.mark.parametrize("at_s", [-1e300, -5.0, 1e12, 1e300, float("inf"), float("nan")])
def test_lines_have_times_that_can_be_shown(at_s):
    """Limit times of lines, which could otherwise not be rendered."""
    (line,) = to_farm_lines([m.WireLine.model_construct(at_s=at_s, sent=True, text="M105")], 1e9)
    assert datetime.fromtimestamp(line.at_s, UTC).year in (1970, 2001, 9000)
    (normal_line,) = to_farm_lines([m.WireLine(at_s=7.5, sent=False, text="ok")], 1e9)
    assert normal_line == m.WireLine(at_s=1e9 + 7.5, sent=False, text="ok")
