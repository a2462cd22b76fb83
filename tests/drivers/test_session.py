"""Whole prints against the emulator's firmware, in one process and on a clock of its own."""

import pytest

from drivers.clock import Clock
from drivers.emulator.faults import Faults
from drivers.errors import Fault
from drivers.messages import Filament, PrintPhase
from drivers.session import Pace, Session
from print_rig import GCODE, PLUS, Rig, gcode, hopping


def assert_ended_off(rig: Rig, phase: PrintPhase, fault: Fault | None) -> None:
    session = rig.session
    assert (session.phase, session.fault) == (phase, fault), session.reason
    assert session.heaters_off
    assert rig.targets() == (0.0, 0.0)
    assert session.ended_s is not None and rig.now_s - 120.0 < session.ended_s <= rig.now_s


def test_a_print_goes_through_its_phases_to_heaters_shown_off_and_filament_parked():
    rig = Rig().run()
    assert_ended_off(rig, PrintPhase.DONE, None)
    assert rig.phases == [
        PrintPhase.CONNECTING, PrintPhase.HEATING, PrintPhase.PRINTING, PrintPhase.ENDING, PrintPhase.DONE,
    ]  # fmt: skip
    assert rig.session.extruded
    assert rig.session.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)
    assert rig.firmware.errors == 0


def test_the_file_s_waits_are_never_sent_and_the_dead_man_is_armed_before_any_heat():
    rig = Rig().run()
    assert b"M109" not in rig.sent and b"M190" not in rig.sent
    assert rig.sent.index(b"M85 S1200") < rig.sent.index(b"M140 S60")
    assert rig.sent.rindex(b"M85 S0") > rig.sent.rindex(b"G28")


@pytest.mark.parametrize(("filament", "pushes"), [(Filament.PARKED, 1), (Filament.AT_NOZZLE, 0)])
def test_parked_filament_is_brought_back_once_and_only_where_it_was_parked(filament: Filament, pushes: int):
    rig = Rig(filament=filament).run()
    assert rig.sent.count(b"G1 F300 E20") == pushes


@pytest.mark.parametrize("lines", [0, 3, 9, 10, 12, 60, 150])
def test_a_cancel_at_any_time_ends_with_heaters_off(lines: int):
    rig = Rig().printing(lines)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_ended_off(rig, PrintPhase.CANCELLED, None)
    assert rig.session.reason == "no more"


def test_a_cancel_in_the_middle_parks_the_filament_and_moves_the_head_away():
    rig = Rig().printing(100)
    end_s = rig.now_s
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert rig.session.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)
    assert rig.firmware.board.head_mm[0] == pytest.approx(0.0, abs=0.5)
    assert rig.now_s - end_s < 60.0


def test_a_cancel_before_homing_moves_nothing():
    rig = Rig()
    rig.run(until=lambda: rig.session.phase is PrintPhase.HEATING)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_ended_off(rig, PrintPhase.CANCELLED, None)
    assert b"Z10" not in rig.sent and b"G28" not in rig.sent


@pytest.mark.parametrize(
    ("faults", "fault"),
    [
        (Faults(reset_after=100), Fault.REBOOT),
        (Faults(stop_after=100), Fault.MAXTEMP),
        (Faults(silent_after=100), Fault.NO_ANSWER),
        (Faults(dead_bed=True), Fault.HEATER_TIMEOUT),
        (Faults(checksum=0.2), Fault.NOISY_LINE),
    ],
)
def test_faults_of_the_board_fail_the_print_by_name_and_end_with_heaters_off(faults: Faults, fault: Fault):
    assert_ended_off(Rig(faults).run(), PrintPhase.FAILED, fault)


def test_a_dead_nozzle_fails_by_the_firmware_s_stop_or_by_our_own_watch():
    rig = Rig(Faults(dead_nozzle=True)).run()
    assert rig.session.fault in (Fault.STOPPED, Fault.HEATER_TIMEOUT)
    assert_ended_off(rig, PrintPhase.FAILED, rig.session.fault)


@pytest.mark.parametrize("seed", range(5))
def test_a_wire_that_is_a_little_bad_prints_the_same_thing(seed: int):
    good = Rig().run()
    bad = Rig(Faults(checksum=0.004, drop_ok=0.004), seed=seed).run()
    assert_ended_off(bad, PrintPhase.DONE, None)
    assert bad.firmware.board.filament_mm == pytest.approx(good.firmware.board.filament_mm, abs=0.01)


def test_cold_extrusion_ends_the_print():
    text = gcode().replace("M109 S210", "M109 S100")
    assert_ended_off(Rig(text=text).run(), PrintPhase.FAILED, Fault.COLD_EXTRUSION)


def test_a_target_that_somebody_else_changed_ends_the_print():
    rig = Rig(text=gcode(2000)).printing(100)
    rig.firmware.board.set_nozzle(150.0, rig.now_s)
    rig.run()
    assert_ended_off(rig, PrintPhase.FAILED, Fault.TARGET_CHANGED)


def test_the_board_of_another_model_is_refused_before_anything_heats():
    rig = Rig(model="ultimaker2_extended_plus").run()
    assert_ended_off(rig, PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert b"M140 S60" not in rig.sent
    assert not rig.session.extruded


def test_a_port_that_went_away_fails_the_print_and_nobody_claims_heaters_off():
    rig = Rig().printing(100)
    rig.plugged = False
    rig.link.closed()
    rig.session.fail(Fault.PORT_LOST, "went away", rig.now_s)
    rig.run()
    assert (rig.session.phase, rig.session.fault) == (PrintPhase.FAILED, Fault.PORT_LOST)
    assert not rig.session.heaters_off
    assert "switch the printer off" in str(rig.session.reason)


def test_a_port_that_comes_back_is_reset_and_shown_off():
    rig = Rig().printing(100)
    rig.plugged = False
    rig.link.closed()
    rig.session.fail(Fault.PORT_LOST, "went away", rig.now_s)
    rig.back_s = rig.now_s + 10.0
    assert_ended_off(rig.run(), PrintPhase.FAILED, Fault.PORT_LOST)


def test_without_a_program_the_board_is_reset_and_the_agent_s_death_is_the_reason():
    rig = Rig()
    rig.firmware.board.set_nozzle(210.0, rig.now_s)
    rig.session = Session(rig.link, None, PLUS, Filament.AT_NOZZLE, Pace(), rig.now_s)
    assert_ended_off(rig.run(), PrintPhase.FAILED, Fault.AGENT_DIED)
    assert rig.session.filament is Filament.UNKNOWN


def test_a_second_cancel_and_a_cancel_of_what_has_ended_change_nothing():
    rig = Rig().printing(100)
    rig.session.cancel("first", rig.now_s)
    rig.session.cancel("second", rig.now_s)
    rig.run()
    rig.session.cancel("third", rig.now_s)
    assert_ended_off(rig, PrintPhase.CANCELLED, None)
    assert rig.session.reason == "first"


def test_an_accelerated_pace_is_bounded_in_wall_time():
    pace = Pace.of(Clock(scale=60.0))
    assert (pace.floor_s, pace.printing_s) == (120.0, 30.0)
    assert Pace.of(Clock()).printing_s == 3.0


def test_a_report_is_asked_for_by_a_numbered_line():
    """A bare M105 with one flipped bit may be an M1, which never comes back."""
    rig = Rig().run()
    assert b"\nM105\n" not in rig.sent
    assert rig.sent.count(b" M105*") > 10


def test_moves_that_take_longer_than_a_time_out_are_no_noise_and_no_silence():
    """A brim at 10 mm/s along the longest side: each ok comes when a move is done."""
    path = "\n".join(f"G1 F600 X{10 + 200 * (i % 2)} E{i + 1}" for i in range(60))
    rig = Rig(text=GCODE.format(moves=path, end=60 - 6.5)).run()
    assert_ended_off(rig, PrintPhase.DONE, None)
    assert rig.firmware.errors <= 6


def test_a_board_whose_reports_cannot_be_read_is_not_heated_for_ever():
    rig = Rig()
    listen = rig.link.receive
    rig.link.receive = lambda data, now_s: listen(data.replace(b"ok T:", b"ok T:? "), now_s)  # type: ignore[method-assign]
    rig.run(until=lambda: rig.session.phase is PrintPhase.ENDING)
    assert rig.session.fault is Fault.NO_ANSWER
    rig.run()
    assert rig.targets() == (0.0, 0.0)
    assert not rig.session.heaters_off  # nobody could read that they are


def test_a_first_stage_too_cold_to_extrude_leaves_the_filament_parked():
    text = gcode().replace("M109 S210", "M109 S150\nM109 S210")
    rig = Rig(text=text).run()
    assert_ended_off(rig, PrintPhase.DONE, None)
    assert rig.sent.count(b"G1 F300 E20") == 1


@pytest.mark.parametrize("after_s", [0.1 * i for i in range(30)])
def test_whatever_the_feeder_was_doing_a_cancel_leaves_the_filament_parked(after_s: float):
    rig = Rig(text=hopping(120)).printing(60 + int(130 * after_s))
    until_s = rig.now_s + after_s
    rig.run(until=lambda: rig.now_s >= until_s)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert_ended_off(rig, PrintPhase.CANCELLED, None)
    assert rig.session.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)


@pytest.mark.parametrize(
    ("end", "filament"),
    [("", Filament.UNKNOWN), ("G1 E200\n", Filament.AT_NOZZLE), ("G1 E180\n", Filament.PARKED)],
)
def test_at_the_end_the_filament_is_where_the_file_left_it(end: str, filament: Filament):
    text = gcode().replace("G91\nG1 F1500 E-13.5\nG90\n", end)
    rig = Rig(text=text).run()
    assert_ended_off(rig, PrintPhase.DONE, None)
    assert rig.session.filament is filament
    end_mm = {Filament.UNKNOWN: -6.5, Filament.AT_NOZZLE: 0.0, Filament.PARKED: -20.0}[filament]
    assert rig.firmware.board.filament_end_mm == pytest.approx(end_mm, abs=0.1)
