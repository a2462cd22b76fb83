"""Messages and rules of Marlin 2 (gcode/queue.cpp, gcode/gcode.cpp and MarlinCore.cpp)."""

import pytest

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.listener import Phase
from printers.firmware_host import Host, add_number

MODEL = "creality_ender3"


@pytest.fixture
def host() -> Host:
    return Host(MODEL)


def test_identity_is_reported(host: Host):
    answers = host.send("M115")
    assert (
        answers[0].startswith("FIRMWARE_NAME:Marlin 2.0")
        and "MACHINE_TYPE:Ender-3 EXTRUDER_COUNT:1" in answers[0]
    )
    assert answers[-1] == "ok"
    assert "echo:  M206 X0.00 Y0.00 Z0.00" in host.send("M503")
    assert host.send("M105") == ["ok T:21.00 /0.00 B:21.00 /0.00 @:0 B@:0"]
    assert host.send("M114") == ["X:0.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0", "ok"]


def test_number_without_a_checksum_is_refused_with_the_last_line(host: Host):
    host.send_numbered("M400")
    refusal = ["Error:No Checksum with line number, Last Line: 1", "Resend: 2", "ok"]
    assert host.send_burst("N0 M110") == refusal
    assert host.send_numbered("M400") == ["ok"]  # the refused line has changed nothing


def test_move_is_acknowledged_when_it_is_in_the_planner(host: Host):
    host.send("G28")
    answers = [line for x in range(40) for line in host.send_numbered(f"G1 F600 X{x % 2 * 100}")]
    assert [line for line in answers if not line.startswith("ok")] == ["echo:busy: processing"] * (
        answers.count("echo:busy: processing")
    )
    assert answers.count("ok") == 40 and answers.count("echo:busy: processing") > 50
    assert 24 <= host.firmware.move_count <= 40


def test_busy_board_reads_lines_and_sends_busy_messages(host: Host):
    host.send("M113 S1")
    host.send_burst(add_number(1, "G4 S5"))
    assert host.send_burst("N0 M110")[0] == "Error:No Checksum with line number, Last Line: 1"
    assert host.wait(6.0) == ["echo:busy: processing"] * 4 + ["ok"]


def test_advanced_ok_contains_the_line_number():
    host = Host(MODEL, Faults(advanced_ok=True))
    assert host.send_numbered("M400") == ["ok N1 P15 B4"]
    assert host.send_numbered("M105")[0].startswith("ok T:")


def test_m112_halts_the_board_until_a_reset(host: Host):
    host.send("M104 S200")
    assert host.send_burst("M112") == ["Error:Printer halted. kill() called!"]
    assert host.board.nozzle.target_c == 0.0 and host.firmware.phase is Phase.HALTED
    assert host.wait(600.0) == [] and host.send_burst("M105") == []
    host.firmware.reset(host.now_s)
    assert "start" in host.wait(5.0)


def test_only_moves_and_m85_restart_the_dead_man_timer(host: Host):
    host.send("M140 S60")
    host.send("M85 S100")
    for _ in range(6):
        host.wait(15.0)
        host.send("M105")
        host.send("M140 S60")
    assert host.firmware.phase is Phase.RUNNING
    assert host.wait(20.0)[-1] == "Error:Printer halted. kill() called!"
    assert host.board.bed.target_c == 0.0


def test_m410_stops_at_once_and_keeps_the_position(host: Host):
    host.send("G28")
    host.send_burst(add_number(1, "G1 F600 X100"))
    host.wait(3.0)
    assert host.send_burst("M410") == []
    x_mm = host.firmware.machine.planner.compute_position(host.now_s)[0]
    host.wait(2.0)
    assert 20.0 < x_mm < 40.0
    assert host.send("M114")[0].startswith(f"X:{x_mm:.2f} ")


def test_g90_ends_relative_extrusion(host: Host):
    host.send("M83")
    host.send("G90")
    assert not host.firmware.machine.is_e_relative
    host.send("G91")
    assert host.firmware.machine.is_e_relative


def test_comment_ends_with_its_line(host: Host):
    assert host.send("M115;what are you")[0].startswith("FIRMWARE_NAME")
    assert host.send("M105") == ["ok T:21.00 /0.00 B:21.00 /0.00 @:0 B@:0"]
