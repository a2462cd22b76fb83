"""Pause of a print: head and filament are parked, and return."""

import pytest

from drivers.errors import Fault
from drivers.gcode import MotionState
from drivers.messages import Filament, PrintPhase
from drivers.session.park import PAUSE_TIMEOUT_S
from printers.print_rig import GCODE, Rig, assert_end_with_heaters_off, make_gcode, make_retracting_gcode


@pytest.mark.parametrize("lines", [14, 40, 77, 111, 190, 260])
def test_pause_parks_and_keeps_the_bed_warm_and_the_print_resumes_exactly(lines: int):
    text = make_retracting_gcode(60)
    unpaused_rig = Rig(text=text).run()
    rig = Rig(text=text).run_until_printing(lines)
    rig.session.pause(rig.now_s)
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.PAUSED and rig.read_targets()[0] == 0.0)
    board = rig.firmware.board
    paused_at_s = rig.now_s
    rig.run(until=lambda: rig.now_s > paused_at_s + 1800.0)  # 15 times the timeout of the dead-man timer
    assert rig.session.context.phase is PrintPhase.PAUSED
    assert rig.read_targets() == (0.0, 60.0)
    assert rig.session.context.pause_ends_s == pytest.approx(paused_at_s + PAUSE_TIMEOUT_S, abs=60.0)
    assert rig.session.context.filament is Filament.PARKED
    assert board.filament_end_mm == pytest.approx(-20.0, abs=0.1)
    assert rig.firmware.machine.planner.target_mm[:2] == (10.0, 200.0)
    rig.session.resume(rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
    assert board.filament_mm == pytest.approx(unpaused_rig.firmware.board.filament_mm, abs=0.01)
    assert board.filament_end_mm == pytest.approx(-20.0, abs=0.1)
    assert rig.list_moves() == unpaused_rig.list_moves()


def test_head_returns_before_the_filament_after_a_pause():
    rig = Rig(text=make_gcode(200)).run_until_printing(100)
    rig.session.pause(rig.now_s)
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.PAUSED and rig.read_targets()[0] == 0.0)
    x, y, z, _ = MotionState(rig.program, rig.session.context.acknowledged_line_count).position_mm
    rig.session.resume(rig.now_s)
    index = len(rig.sent_bytes)
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.PRINTING)
    return_commands = rig.sent_bytes[index:]
    order = [
        b"E13.500",
        b"G1 F9000 X%.3f Y%.3f" % (x, y),
        b"G1 F1200 Z%.3f" % z,
        b"G1 F1500 E6.500",
        b"G92 E",
    ]
    indices = [return_commands.index(command) for command in order]
    assert indices == sorted(indices)


def make_sequential_gcode() -> str:
    """Make G-code that finishes a part of 60 mm and begins a second one beside it."""
    low_moves = "\n".join(
        f"G1 F3000 X{150 + 20 * (i % 2)} Y{50 + i * 0.2:.2f} E{4 + 0.1 * i:.2f}" for i in range(60)
    )
    high_moves = (
        "G1 F3000 X90 Y50 E1\n;LAYER:1\nG0 Z60\nG1 F3000 X50 Y60 E3\nG0 Z65 X150\n;LAYER:0\nG0 Z0.27\n"
    )
    return GCODE.format(moves=high_moves + low_moves, end=3.5)


@pytest.mark.parametrize("is_cancelled", [False, True])
def test_head_leaves_a_part_above_the_finished_ones(is_cancelled: bool):
    rig = Rig(text=make_sequential_gcode())
    rig.run_until_printing(rig.program.line_count - 40)
    index = len(rig.sent_bytes)
    planner = rig.firmware.machine.planner
    if is_cancelled:
        rig.session.cancel("no more", rig.now_s)
    else:
        rig.session.pause(rig.now_s)
    while not rig.session.context.has_ended and rig.read_targets()[1 if is_cancelled else 0] > 0:
        rig.step()
    rig.run(
        until=lambda: (
            b"G28 X0" in rig.sent_bytes[index:] if is_cancelled else planner.target_mm[:2] == (10.0, 200.0)
        )
    )
    assert planner.target_mm[2] >= 69.9
    rig.session.resume(rig.now_s)
    rig.run()
    assert rig.session.context.phase is (PrintPhase.CANCELLED if is_cancelled else PrintPhase.DONE)


def test_cancel_with_the_bed_at_its_lowest_does_not_lower_it_further():
    rig = Rig()
    rig.run(until=lambda: rig.session.context.acknowledged_line_count > rig.program.home_line + 1)
    rig.session.cancel("no more", rig.now_s)
    rig.run()
    assert b"G1 F1200 Z0.000" in rig.sent_bytes
    assert rig.session.context.heaters_off


def test_pause_beyond_its_limit_ends_the_print_safely():
    rig = Rig(text=make_gcode(200)).run_until_printing(100)
    rig.session.pause(rig.now_s)
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.PAUSE_TIMEOUT)
    assert rig.session.context.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.1)


@pytest.mark.parametrize("lines", [0, 5])
def test_pause_before_the_first_extrusion_is_ignored(lines: int):
    rig = Rig().run_until_printing(lines)
    rig.session.pause(rig.now_s)
    assert_end_with_heaters_off(rig.run(), PrintPhase.DONE, None)
    assert PrintPhase.PAUSED not in rig.phases


@pytest.mark.parametrize("has_layers", [True, False])
def test_head_clears_the_highest_part_without_layer_comments(has_layers: bool):
    moves = ["G1 F3000 X90 Y50 E1", "G0 F9000 Z80", "G1 F3000 X90 Y80 E2", "G0 F9000 X150 Y150 Z0.27"]
    moves += [f"G1 F3000 X{150 + i % 2} Y150 E{2 + 0.1 * i:.1f}" for i in range(300)]
    text = GCODE.format(moves="\n".join(moves), end=25.5)
    rig = Rig(text=text if has_layers else text.replace(";LAYER:0\n", "")).run_until_printing(60)
    rig.session.pause(rig.now_s)
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.PAUSED and rig.read_targets()[0] == 0.0)
    assert 90.0 <= rig.firmware.machine.planner.target_mm[2] <= 92.0


@pytest.mark.parametrize("step_count", range(12))
def test_pause_during_cooling_extrudes_no_cold_filament(step_count: int):
    end_line = Rig().program.read_lines(0, 10_000).index(b"M104 S0")
    rig = Rig().run_until_printing(end_line - 2)
    for _ in range(step_count):
        rig.step()
    rig.session.pause(rig.now_s)
    rig.run(
        until=lambda: (
            rig.session.context.pause_ends_s is not None or rig.session.context.phase is PrintPhase.ENDING
        )
    )
    assert (
        rig.session.context.acknowledged_line_count <= end_line
        or rig.session.context.phase is not PrintPhase.PAUSED
    )
    cold_s = rig.now_s + 900.0
    rig.run(until=lambda: rig.now_s > cold_s)
    rig.session.resume(rig.now_s)
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.DONE, None)
