"""Stop, kill and restart of the firmware."""

from __future__ import annotations

import pytest

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.listener import Phase
from printers.firmware_host import Host, add_number

STOP_MESSAGE = (
    "Printer stopped due to errors. Fix the error and use M999 to restart. "
    "(Temperature is reset. Set it after restarting)"
)


@pytest.fixture
def host() -> Host:
    return Host()


def test_stopped_firmware_acknowledges_moves_and_obeys_temperatures() -> None:
    host = Host(faults=Faults(stop_after=3))
    host.send("M140 S60")
    host.send("M104 S210")
    host.send("G4 P0")
    answers = host.wait(1.0)
    assert host.board.nozzle.target_c == host.board.bed.target_c == 0.0
    assert host.send_burst("G1 X5") == [STOP_MESSAGE, "ok"]
    assert host.send("M104 S200") == ["ok"]
    assert host.board.nozzle.target_c == 200.0
    host.send("G28")
    assert host.firmware.machine.is_homed
    assert answers == []


def test_open_sensor_stops_the_print_with_its_message() -> None:
    host = Host(faults=Faults(stop_after=1))
    answers = host.send_burst("G4 P0")
    assert answers == [
        "Error:0",
        ": Extruder switched off. MAXTEMP triggered !",
        f"Error:{STOP_MESSAGE}",
        "ok",
    ]
    assert host.send_burst("M999") == ["Resend: 1", "ok", "ok"]
    assert host.send_burst("G1 X5") == ["ok"]


def test_target_above_275_degrees_stops_the_firmware(host: Host) -> None:
    host.send("M104 S300")
    answers = host.wait(1000.0)
    assert answers[:2] == ["Error:0", ": Extruder switched off. MAXTEMP triggered !"]
    assert host.board.nozzle.target_c == 0.0


def test_dead_nozzle_is_detected_after_30_s_and_m109_continues() -> None:
    host = Host(faults=Faults(dead_nozzle=True))
    started_s = host.now_s
    answers = host.send("M109 S210")
    assert f"Error:{STOP_MESSAGE}" in answers and answers[-1] == "ok"
    assert host.now_s - started_s == pytest.approx(33.0, abs=1.1)


def test_dead_bed_heater_is_not_detected() -> None:
    host = Host(faults=Faults(dead_bed=True))
    host.send_burst("M190 S60")
    answers = host.wait(3600.0)
    assert len(answers) > 3500 and all(line.startswith("T:21.00 E:0 B:21.0") for line in answers)


def test_dead_man_timer_halts_the_firmware_and_the_watchdog_resets_it(host: Host) -> None:
    host.send("M104 S210")
    host.send("M85 S30")
    host.wait(20.0)
    host.send("M105")  # a query does not restart the dead-man timer
    assert host.wait(9.9) == []
    assert host.wait(0.2) == ["Error:Printer halted. kill() called!"]
    assert host.board.nozzle.target_c == 0.0
    assert host.send_burst("M105") == []
    assert host.wait(3.9) == []
    assert host.wait(0.2)[0] == "start"
    assert host.wait(100.0) == ["echo:SD init fail"]  # the reset has switched the dead-man timer off


def test_dead_man_timer_is_restarted_by_late_input(host: Host) -> None:
    """Restart the timer by bytes that are processed in the same step as its timeout."""
    host.send("M85 S30")
    host.now_s += 31.0
    assert host.send_burst("M105")[0].startswith("ok T:")


def test_reset_keeps_physical_state_only(host: Host) -> None:
    host.heat_nozzle()
    for line in ("G28", "M85 S900", "G1 X100 Y100 Z100 F9000", "M400", "G1 E40 F300"):
        host.send_numbered(line)
    host.wait(2.0)
    fed_mm = host.board.filament_mm
    host.firmware.reset(host.now_s)
    assert 0 < host.board.filament_mm < 40 and host.board.filament_mm >= fed_mm
    assert host.board.nozzle.target_c == 0.0 and host.board.nozzle.compute_temperature_c(host.now_s) > 200.0
    assert not host.firmware.machine.is_homed
    assert host.board.head_position_mm == pytest.approx((100, 100, 100))
    host.wait(5.0)
    assert host.send("M114")[0].startswith("X:0.00Y:0.00Z:0.00E:0.00")
    assert host.send_burst(add_number(6, "G4 P0"))[:2] == [
        "Error:Line Number is not Last Line Number+1, Last Line: 0",
        "Resend: 1",
    ]


def test_moves_and_heaters_continue_without_a_host(host: Host) -> None:
    host.send("M104 S210")
    host.send("G28")
    host.send("G1 X200 F600")
    host.wait(3600.0)
    assert host.board.nozzle.target_c == 210.0
    assert host.firmware.machine.planner.compute_position(host.now_s)[0] == 200.0


def test_brown_out_resets_the_board() -> None:
    host = Host(faults=Faults(reset_after=3))
    host.send("M104 S210")
    host.send("G4 P0")
    host.send_burst("G4 P0")
    assert host.board.nozzle.target_c == 0.0
    assert host.wait(2.0)[0] == "start"
    assert host.firmware.reset_count == 1
    host.wait(3.0)
    for _ in range(5):
        assert host.send("G4 P0") == ["ok"]


def test_mute_board_continues_to_heat_until_it_is_reset() -> None:
    host = Host(faults=Faults(silent_after=2))
    host.send("M104 S210")
    assert host.send_burst("G4 P0") == []
    assert host.send_burst("M105") == [] and host.wait(600.0) == []
    assert host.board.nozzle.compute_temperature_c(host.now_s) == pytest.approx(210.0)
    assert host.firmware.phase is Phase.MUTE
    host.firmware.reset(host.now_s)
    assert host.wait(2.0)[0] == "start"
