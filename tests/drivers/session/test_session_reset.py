"""Resets before and after a print, boards without reset, and the firmware's dead-man timer."""

import math
from typing import Any

import pytest

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.listener import Phase
from drivers.errors import Fault
from drivers.link import LinkFault
from drivers.link import Phase as LinkPhase
from drivers.messages import Filament, PrintPhase
from drivers.session import Pace, Session, SessionContext
from printers.print_rig import PLUS_PROFILE, Rig, assert_end_with_heaters_off, make_gcode


def test_lost_port_fails_the_print_without_heaters_confirmed_off():
    rig = Rig().run_until_printing(100)
    rig.is_plugged = False
    rig.link.on_closed()
    rig.session.fail(Fault.PORT_LOST, "went away", rig.now_s)
    rig.run()
    assert (rig.session.context.phase, rig.session.context.fault) == (PrintPhase.FAILED, Fault.PORT_LOST)
    assert not rig.session.context.heaters_off
    assert "switch the printer off" in str(rig.session.context.reason)


def test_returned_port_is_reset_and_confirmed_off():
    rig = Rig().run_until_printing(100)
    rig.is_plugged = False
    rig.link.on_closed()
    rig.session.fail(Fault.PORT_LOST, "went away", rig.now_s)
    rig.reconnect_at_s = rig.now_s + 10.0
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.PORT_LOST)


def test_session_without_a_program_resets_the_board_and_names_the_dead_agent():
    rig = Rig()
    rig.firmware.board.set_nozzle_target(210.0, rig.now_s)
    rig.session = Session(SessionContext(rig.link, None, PLUS_PROFILE, Filament.AT_NOZZLE, Pace(), rig.now_s))
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.AGENT_DIED)
    assert rig.session.context.filament is Filament.UNKNOWN


def test_second_print_on_a_link_begins_with_new_counts():
    rig = Rig()
    rig.run()
    assert rig.session.context.acknowledged_line_count == rig.program.line_count
    second_session = Session(
        SessionContext(rig.link, rig.program, PLUS_PROFILE, Filament.PARKED, Pace(), rig.now_s)
    )
    assert second_session.context.acknowledged_line_count == 0


def test_dead_man_timer_depends_on_heat_and_pause_and_is_off_when_cold():
    rig = Rig(text=make_gcode(200)).run_until_printing(100)
    rig.session.pause(rig.now_s)
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.PAUSED and rig.read_targets()[0] == 0.0)
    paused_at_s = rig.now_s
    rig.run(until=lambda: rig.now_s > paused_at_s + 60.0)
    assert rig.firmware.machine.dead_man_timeout_s == 120.0
    rig.session.resume(rig.now_s)
    rig.run()
    armed_times_s = [int(command.split(b"*")[0]) for command in rig.sent_bytes.split(b"M85 S")[1:]]
    assert armed_times_s[0] == 1200 and armed_times_s[-1] == 0
    assert {seconds: armed_times_s.count(seconds) > 0 for seconds in (600, 120)} == {600: True, 120: True}
    assert rig.sent_bytes.index(b"M85 S600") < rig.sent_bytes.index(b"M85 S120*")


def test_heat_up_longer_than_the_dead_man_timer_does_not_trip_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drivers.session.stream.HEATING_DEAD_MAN_TIMEOUT_S", 60.0)
    monkeypatch.setattr("drivers.session.heat.COMMAND_INTERVAL_S", 20.0)
    rig = Rig()
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.HEATING)
    started_s = rig.now_s
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.PRINTING)
    assert rig.now_s - started_s > 2 * 60.0
    assert_end_with_heaters_off(rig.run(), PrintPhase.DONE, None)


def test_board_switches_its_heaters_off_after_its_host_died():
    rig = Rig(text=make_gcode(200)).run_until_printing(100)
    death_s = rig.now_s
    while (due_s := rig.firmware.compute_deadline_s()) < death_s + 1000.0:
        rig.firmware.feed(b"", due_s)
    assert rig.read_targets() == (0.0, 0.0)


def test_bed_goes_down_before_the_head_moves_after_a_reset():
    rig = Rig().run_until_printing(100)
    rig.firmware.phase = Phase.MUTE
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.CANCELLED, None)
    index = rig.sent_bytes.rindex(b"M110")
    assert rig.sent_bytes.index(b"G28 Z0", index) < rig.sent_bytes.index(b"G28 X0 Y0", index)


def test_board_without_reset_is_initialised_before_each_print():
    rig = Rig(Faults(no_reset=True))
    board = rig.firmware.board
    board.bed.target_c = 50.0  # a person has warmed up the bed
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.HEATING)
    assert rig.firmware.reset_count == 0 and board.bed.target_c == 0.0
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
    assert rig.firmware.reset_count == 0
    assert rig.session.context.identity == "X0.00 Y0.00 Z-10.00"
    assert board.filament_end_mm == pytest.approx(-20.0, abs=0.1)


def test_another_board_without_reset_is_detected():
    rig = Rig(Faults(no_reset=True, home_offset_hundredths_mm=3), identity="X0.00 Y0.00 Z-10.00").run()
    assert_end_with_heaters_off(rig, PrintPhase.FAILED, Fault.WRONG_PRINTER)


@pytest.mark.parametrize(
    ("faults", "fault"),
    [({}, None), ({"stop_after": 150}, Fault.MAXTEMP), ({"dead_bed": True}, Fault.HEATER_TIMEOUT)],
)
def test_board_without_reset_is_stopped_by_command(faults: dict[str, Any], fault: Fault | None):
    rig = Rig(Faults(no_reset=True, **faults))
    if fault is None:
        rig.run_until_printing(60).session.cancel("cancelled", rig.now_s)
    rig.run()
    assert rig.session.context.phase is (PrintPhase.CANCELLED if fault is None else PrintPhase.FAILED)
    assert rig.session.context.heaters_off and rig.read_targets() == (0.0, 0.0)
    assert rig.firmware.reset_count == 0


def test_silent_board_without_reset_has_its_mains_cut():
    rig = Rig(Faults(no_reset=True, silent_after=150)).run()
    assert (rig.session.context.phase, rig.session.context.fault) == (PrintPhase.FAILED, Fault.NO_ANSWER)
    assert rig.session.context.wants_power_off and not rig.session.context.heaters_off


def test_dead_man_timer_of_a_board_without_reset_stays_armed_until_heaters_are_off():
    rig = Rig(Faults(no_reset=True, nozzle_burns_after=150)).run()
    assert rig.session.context.wants_power_off
    assert rig.firmware.machine.dead_man_timeout_s < math.inf
    rig_without_reset = Rig(Faults(no_reset=True))
    rig_without_reset.firmware.machine.dead_man_timeout_s = 600.0
    rig_without_reset.firmware.board.set_nozzle_target(210.0, rig_without_reset.now_s)
    rig_without_reset.session = Session(
        SessionContext(
            rig_without_reset.link, None, PLUS_PROFILE, Filament.AT_NOZZLE, Pace(), rig_without_reset.now_s
        )
    )
    rig_without_reset.session.context.can_reset_board = False
    rig_without_reset.run(
        until=lambda: (
            rig_without_reset.session.context.report is not None
            and rig_without_reset.session.context.report.targets_off
        )
    )
    assert rig_without_reset.firmware.machine.dead_man_timeout_s == 600.0
    assert_end_with_heaters_off(rig_without_reset.run(), PrintPhase.FAILED, Fault.AGENT_DIED)
    assert rig_without_reset.firmware.machine.dead_man_timeout_s == math.inf  # the timer is off


def test_board_that_restarts_during_the_confirmation_is_polled_at_once():
    """Poll at once, because a dead link does not wait for an answer."""
    rig = Rig().run_until_printing()
    rig.session.fail(Fault.NO_ANSWER, "it does not answer", rig.now_s)
    rig.run(until=lambda: rig.session.context.wants_reset)
    rig.run(until=lambda: not rig.session.context.wants_reset and rig.link.phase is LinkPhase.LIVE)
    assert not rig.session.context.has_ended
    rig.firmware.reset(rig.now_s)
    restarted_s = rig.now_s
    rig.run(until=lambda: rig.session.context.wants_reset)
    assert rig.now_s - restarted_s < 10.0
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.NO_ANSWER)


def test_board_with_a_fault_after_its_reset_is_still_polled():
    """Poll a board that has stopped again, because it still reports its temperatures."""
    rig = Rig().run_until_printing()
    rig.session.fail(Fault.NO_ANSWER, "it does not answer", rig.now_s)
    rig.run(until=lambda: rig.session.context.wants_reset)
    rig.run(until=lambda: not rig.session.context.wants_reset and rig.link.phase is LinkPhase.LIVE)
    resets = rig.firmware.reset_count
    events = rig.link.receive(b"Error:0\n: Extruder switched off. MINTEMP triggered !\n", rig.now_s)
    assert [event.fault for event in events or () if isinstance(event, LinkFault)] == [Fault.MINTEMP]
    rig.session.advance(events or (), rig.now_s)
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.NO_ANSWER)
    assert rig.firmware.reset_count == resets
