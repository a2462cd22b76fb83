"""Rules of the firmware, each compared with observations.

Source: docs/explanation/ultimaker2-serial.md.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.faults import Faults
from drivers.printers import PROFILES
from printers.firmware_host import Host, add_number


@pytest.fixture
def host() -> Host:
    return Host()


# --- boot ---


def test_banner_is_sent_a_second_after_power_on_and_the_card_error_2_3_s_later() -> None:
    host = Host(boot=False)
    assert host.wait_until(0.99) == []
    answers = host.wait_until(1.05)
    assert answers[:3] == [
        "start",
        "echo:Marlin 1.0.0",
        "echo: Last Updated: Mar 15 2018 13:04:08 | Author: Vers:_3.3.0",
    ]
    assert "echo: Free Memory: 2055  PlannerBufferBytes: 1232" in answers
    assert "echo:  M92 X80.00 Y80.00 Z200.00 E369.00" in answers
    assert "echo:  M201 X9000 Y9000 Z100 E10000" in answers
    assert answers[-1] == "echo:   M301 P10.03 I1.50 D70.00"
    assert host.wait_until(3.29) == []
    assert host.wait_until(3.31) == ["echo:SD init fail"]


def test_bytes_to_the_bootloader_are_lost_and_later_ones_wait() -> None:
    host = Host(boot=False)
    host.wait_until(0.5)
    assert host.send_burst("M105") == []
    host.wait_until(1.1)
    assert host.send_burst("M114") == []
    answers = host.wait_until(3.0)
    assert [line for line in answers if line.startswith(("ok", "X:"))][1:] == ["ok"]
    assert not any("T:" in line for line in answers)


def test_extended_model_differs_in_banner_and_height() -> None:
    host = Host("ultimaker2_extended_plus", boot=False)
    assert any(line.endswith("Vers:_3.3.0ex") for line in host.wait_until(2.0))
    host.wait_until(5.0)
    host.send("G28")
    assert host.send("M114")[0].startswith("X:0.00Y:224.50Z:315.00E:0.00 Count X: 0.00Y:224.50Z:315.00")


# --- answers ---


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("M105", ["ok T:21.0 /0.0 B:21.0 /0.0 @:0 B@:0"]),
        ("M119", ["Reporting endstop status", "x_min: openy_max: openz_max: openok"]),
        ("M27", ["Not SD printing", "Card error:1", "ok"]),
        ("M20", ["Begin file list", "End file list", "ok"]),
        ("M21", ["echo:SD init fail", "ok"]),
        ("T0", ["echo:Active Extruder: 0", "ok"]),
        ("T1", ["echo:T\x01Invalid extruder", "ok"]),
        ("HELLO", ['echo:Unknown command: "HELLO"', "ok"]),
        ("g1 x1", ['echo:Unknown command: "g1 x1"', "ok"]),
        *(
            (code, ["ok"])
            for code in [
                "M112",
                "M108",
                "M410",
                "M125",
                "M600",
                "M155",
                "M118",
                "M73",
                "M113",
                "G29",
                "G80",
                "M9999",
            ]
        ),
        *(
            (code, ["ok"])
            for code in ["M23", "M24", "M25", "M26", "M28", "M29", "M30", "M923", "M928", "M107"]
        ),
    ],
)
def test_answers_equal_those_of_the_firmware(host: Host, line: str, answer: list[str]) -> None:
    assert host.send(line) == answer


def test_m115_lists_no_capabilities(host: Host) -> None:
    answers = host.send("M115")
    assert answers[0].startswith(
        "FIRMWARE_NAME:Marlin Ultimaker2; Sprinter/grbl mashup for gen6 FIRMWARE_URL:"
    )
    assert answers[0].endswith("PROTOCOL_VERSION:1.0 MACHINE_TYPE:Ultimaker EXTRUDER_COUNT:1")
    assert answers[1:] == ["ok"]


def test_position_is_the_last_target_and_count_is_the_actual_position(host: Host) -> None:
    host.send("G28")
    host.send("G1 X100 F6000")  # 100 mm/s
    host.wait(0.5)
    position, count = host.send("M114")[0].split(" Count X: ")
    assert position == "X:100.00Y:224.50Z:215.00E:0.00"
    assert 40 < float(count.split("Y:")[0]) < 60
    host.send("M400")
    assert host.send("M114")[0] == "X:100.00Y:224.50Z:215.00E:0.00 Count X: 100.00Y:224.50Z:215.00"


def test_homing_from_the_middle_takes_5_3_s_without_answers(host: Host) -> None:
    host.send("G28")
    for line in ("G1 X115 Y112.25 Z107.5 F9000", "M400"):
        host.send(line)
    assert host.send_burst("G28") == []
    assert host.wait(5.2) == []
    assert host.wait(0.2) == ["ok"]


def test_homing_one_axis_leaves_the_others(host: Host) -> None:
    host.send("G28")
    host.send("G1 X50 Y60 Z70 F9000")
    host.send("G28 X0 Y0")
    assert host.send("M114")[0].startswith("X:0.00Y:224.50Z:70.00")


# --- moves ---


def test_targets_out_of_reach_are_clamped_silently(host: Host) -> None:
    assert host.send("G1 X500 Y-50 Z400") == ["ok"]
    assert host.send("M114")[0].startswith("X:230.00Y:0.00Z:225.00")


def test_cold_extrusion_is_acknowledged_and_counted_but_not_executed(host: Host) -> None:
    assert host.send_burst("G1 E5 F300") == ["ok", "echo: cold extrusion prevented"]
    assert "E:5.00" in host.send("M114")[0]
    host.wait(10.0)
    assert host.board.filament_mm == 0.0


def test_extrusion_of_a_metre_is_refused(host: Host) -> None:
    host.heat_nozzle()
    assert host.send_burst("G1 E1001 F300") == ["ok", "echo: too long extrusion prevented"]


def test_moves_are_acknowledged_when_read_and_commands_after_execution(host: Host) -> None:
    """Check that the oks of both moves come before the answer to the M105 that precedes them."""
    assert host.send_burst("G28", "M105", "G1 X10 F6000", "M114", "G1 X20") == ["ok", "ok"]
    answers = host.wait(30.0)
    assert answers[0] == "ok" and answers[1].startswith("ok T:") and answers[2].startswith("X:10.00")
    assert answers[3:] == ["ok"]


def test_seventeen_moves_are_acknowledged_at_once_and_then_one_per_finished_move(host: Host) -> None:
    ok_count = 0
    for k in range(40):
        if host.send_burst(f"G1 X{20 if k % 2 else 220} F6000") != ["ok"]:
            break
        ok_count += 1
    assert ok_count == 17
    assert host.send_burst() == []
    for _ in range(3):
        due_s = host.firmware.compute_deadline_s()
        assert host.wait_until(due_s) == ["ok"]
        host.send_burst("G1 X100 F6000")


def test_late_host_does_not_delay_queued_moves() -> None:
    ends_s = []
    for delay_s in (0.0, 0.15):
        host = Host()
        for k in range(1, 60):
            answers = host.send_burst(f"G1 X{2 * k} F1200")  # 0.1 s each
            while "ok" not in answers:
                answers += host.wait_until(host.firmware.compute_deadline_s() + delay_s)
        host.send("M400")
        ends_s.append(host.firmware.machine.planner.idle_since_s)
    assert ends_s[0] == pytest.approx(ends_s[1], abs=1e-6)


def test_m400_ends_with_the_last_move(host: Host) -> None:
    started_s = host.now_s
    for k in range(1, 11):
        host.send_burst(f"G1 X{10 * k} F600")  # 1 s each
    host.send("M400")
    assert host.now_s == pytest.approx(host.firmware.machine.planner.idle_since_s)
    assert host.now_s - started_s == pytest.approx(10.0, abs=0.5)
    assert host.firmware.moving_s == pytest.approx(host.now_s - started_s)


def test_relative_moves_and_g92_are_applied(host: Host) -> None:
    for line in ("G28", "G91", "G1 X5 F3000", "G1 X5 Y-10", "G90", "G92 X100 E7", "G1 X101"):
        host.send(line)
    host.send("M400")
    answer = host.send("M114")[0]
    assert answer.startswith("X:101.00Y:214.50Z:215.00E:7.00 Count X: 101.00")
    assert host.firmware.machine.planner.compute_position(host.now_s)[0] == pytest.approx(11.0)


def test_arc_follows_its_circle(host: Host) -> None:
    for line in ("G28", "G1 X100 Y100 Z100 F9000", "M400"):
        host.send(line)
    old_moving_s = host.firmware.moving_s
    for line in ("G2 X100 Y100 I20 J0 F1200", "M400"):
        host.send(line)
    assert host.firmware.moving_s - old_moving_s == pytest.approx(2 * math.pi * 20 / 20, rel=0.02)


def test_quick_stop_empties_the_planner_and_keeps_the_position(host: Host) -> None:
    host.send("G28")
    for x in (100, 200, 100, 200):
        host.send_burst(f"G1 X{x} F6000")
    host.wait(0.5)
    assert host.send_burst("M401") == ["ok"]
    position, count = host.send("M114")[0].removeprefix("X:").split(" Count X: ")
    assert position.split("Y:")[0] == count.split("Y:")[0]
    assert 40 < float(count.split("Y:")[0]) < 60
    old_position = host.firmware.machine.planner.compute_position(host.now_s)
    host.wait(10.0)
    assert host.firmware.machine.planner.compute_position(host.now_s) == old_position


def test_m0_never_finishes(host: Host) -> None:
    assert host.send_burst("M0", "M105") == []
    assert host.wait(1e6) == []
    host.firmware.reset(host.now_s)
    assert host.wait(2.0)[0] == "start"


# --- heat ---


def test_m109_reports_each_second_and_holds_three_seconds(host: Host) -> None:
    started_s = host.now_s
    answers = host.send("M109 S60")
    assert [line[-3:] for line in answers[-4:-1]] == ["W:2", "W:1", "W:0"] and answers[-1] == "ok"
    assert all(line.startswith("T:") and " E:0 W:" in line for line in answers[:-1])
    assert answers[0].endswith("W:?")
    expected_s = PROFILES["ultimaker2_plus"].nozzle.compute_heating_s(59.0) + 3.0
    assert host.now_s - started_s == pytest.approx(expected_s, abs=0.05)
    assert len(answers) - 1 == int(expected_s)


def test_m109_also_waits_for_cooling(host: Host) -> None:
    host.heat_nozzle(200.0)
    started_s = host.now_s
    host.send("M109 S100")
    assert host.now_s - started_s > 60.0
    assert host.board.nozzle.compute_temperature_c(host.now_s) < 101.0


def test_m190_reports_the_bed_and_finishes_at_once_if_hotter(host: Host) -> None:
    answers = host.send("M190 S40", 5000)
    assert answers[0].startswith("T:21.00 E:0 B:21.") and answers[-1] == "ok"
    assert host.send_burst("M190 S30") == ["ok"]


def test_temperatures_are_reported_with_their_targets(host: Host) -> None:
    host.send("M104 S210")
    host.send("M140 S60")
    assert host.send("M105")[0].startswith("ok T:21.0 /210.0 B:21.0 /60.0 @:127 B@:")
    host.wait(30.0)
    assert host.send("M105")[0].endswith("@:127 B@:127")


# --- faults on lines ---


def test_same_seed_gives_the_same_run() -> None:
    runs = []
    for _ in range(2):
        host = Host(faults=Faults(checksum=0.2, drop_ok=0.2))
        runs.append([host.send_burst(add_number(n, "G4 P0")) for n in range(1, 60)])
    assert runs[0] == runs[1]


# --- invariants ---


GCODES = (0, 1, 2, 3, 4, 10, 11, 28, 90, 91, 92)
MCODES = (82, 83, 84, 85, 92, 104, 105, 106, 109, 110, 114, 119, 140, 190, 201, 203, 204, 205, 220, 221)
OTHER_MCODES = (300, 302, 400, 401, 503, 601, 999)
codes = st.sampled_from(
    [*(f"G{n}" for n in GCODES), *(f"M{n}" for n in (*MCODES, *OTHER_MCODES)), "T0", "T1"]
)
numbers = st.one_of(
    st.floats(-1e4, 1e4).map(lambda number: f"{number:.3f}"),
    st.sampled_from(["", "0", "-0", "-1", "1e9", "9e99", "1e999", "nan", "-.", "0.0001", "9" * 60]),
)
argument_lists = st.lists(st.tuples(st.sampled_from("XYZEFSPIJT"), numbers).map("".join), max_size=4)


@given(st.lists(st.tuples(codes, argument_lists), max_size=25), st.floats(0.01, 1e4))
@settings(deadline=None)
def test_commands_with_arbitrary_numbers_do_not_crash_the_firmware(
    commands: list[tuple[str, list[str]]], pause_s: float
) -> None:
    host = Host()
    for code, parameters in commands:
        host.send_burst(" ".join([code, *parameters]))
        host.now_s += pause_s
        host.firmware.feed(b"", host.now_s)
        assert all(map(math.isfinite, host.firmware.machine.planner.compute_position(host.now_s)))
        assert host.firmware.moving_s <= host.now_s
    host.firmware.reset(host.now_s)
    host.wait(5.0)
    assert host.send("M105")[0].startswith("ok T:")
