"""Complete prints on an emulated Ender-3, whose board has plain Marlin 2."""

import io
from dataclasses import replace

import pytest

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.listener import Phase
from drivers.errors import BadGcode, Fault
from drivers.gcode import read_program
from drivers.messages import Filament, PrintPhase
from drivers.printers import PROFILES
from printers.print_rig import Rig, assert_end_with_heaters_off

ENDER3 = PROFILES["creality_ender3"]


def make_gcode(moves: int = 200) -> str:
    move_lines = "\n".join(
        f"G1 F3000 X{50 + 40 * (i % 2)} Y{50 + i * 0.2:.2f} E{i + 1}" for i in range(moves)
    )
    start = "\n".join(ENDER3.start_code).format(bed_c=60.0, nozzle_c=205.0, prime_mm=12.5)
    end = "\n".join(ENDER3.end_code).format(park_mm=5.0 - ENDER3.park_retraction_mm)
    return (
        f";FLAVOR:Marlin\n{start}\n;LAYER:0\nG0 F9000 X50 Y50 Z0.2\n{move_lines}\n"
        f";TIME_ELAPSED:100\nG1 F1500 E{moves - 5:.2f}\n{end}\n"
    )


def make_rig(moves: int = 200, **faults: float) -> Rig:
    return Rig(Faults(**faults), make_gcode(moves), "creality_ender3", profile=ENDER3)


@pytest.mark.parametrize("advanced_ok", [False, True])
def test_part_is_printed_with_each_line_once_and_ends_cold(advanced_ok: bool):
    printer = make_rig(advanced_ok=advanced_ok).run()
    assert_end_with_heaters_off(printer, PrintPhase.DONE, None)
    board = printer.firmware.board
    assert printer.firmware.error_count == 0 and printer.link.resend_count == 0
    # The filament moves 8 mm forward and 8 mm back at the start.
    assert board.filament_mm == pytest.approx(200.0 + 12.5, abs=0.01)
    assert board.filament_end_mm == pytest.approx(-ENDER3.park_retraction_mm, abs=0.01)
    assert printer.session.context.filament is Filament.PARKED
    assert printer.firmware.machine.is_homed and not board.bed_clear
    assert printer.phases[-3:] == [PrintPhase.PRINTING, PrintPhase.ENDING, PrintPhase.DONE]


@pytest.mark.parametrize("seed", range(3))
def test_part_is_exact_over_a_noisy_wire(seed: int):
    faults = Faults(noise=2e-4, lost=1e-4, doubled=1e-4)
    printer = Rig(faults, make_gcode(600), "creality_ender3", seed=seed, profile=ENDER3).run()
    assert_end_with_heaters_off(printer, PrintPhase.DONE, None)
    noise = printer.firmware.noise
    assert noise is not None and noise.damaged_byte_count > 0 and noise.altered_line_count == 0
    assert printer.link.resend_count > 0
    assert printer.firmware.board.filament_mm == pytest.approx(600.0 + 12.5, abs=0.01)


@pytest.mark.parametrize(
    "faults",
    [
        {"drop_ok": 0.01},
        {"garble_ok": 0.01},
        {"checksum": 0.02},
        {"resend": 0.02, "mute_resend": True},
        {"swallow": 0.01},
        {"wrong_number": 0.01},
    ],
    ids=lambda faults: next(iter(faults)),
)
@pytest.mark.parametrize("advanced_ok", [False, True])
def test_part_is_exact_where_lines_or_answers_are_lost(faults: dict[str, float], advanced_ok: bool):
    printer = make_rig(400, advanced_ok=advanced_ok, **faults).run()
    assert_end_with_heaters_off(printer, PrintPhase.DONE, None)
    assert printer.firmware.board.filament_mm == pytest.approx(400.0 + 12.5, abs=0.01)


def test_slow_move_has_no_timeout_while_the_board_is_busy():
    slow_gcode = make_gcode(60).replace("F3000", "F120")  # 20 s each, and the planner is full
    printer = Rig(Faults(), slow_gcode, "creality_ender3", profile=ENDER3).run()
    assert_end_with_heaters_off(printer, PrintPhase.DONE, None)
    assert printer.link.resend_count == 0
    query_count = printer.sent_bytes.count(ENDER3.firmware.last_line_query)
    assert query_count < 150  # at most a few queries for each line, not one every 0.3 s


def test_cancel_lifts_the_head_off_the_part_and_parks_the_filament():
    printer = make_rig().run_until_printing()
    printer.session.cancel("enough", printer.now_s)
    printer.run()
    assert_end_with_heaters_off(printer, PrintPhase.CANCELLED, None)
    x, y, z, _ = printer.firmware.machine.planner.compute_position(printer.now_s)
    assert (x, y) == (0.0, 0.0) and z == pytest.approx(26.0)  # 10 mm above the height of priming, rounded up
    assert printer.firmware.board.filament_end_mm == pytest.approx(-ENDER3.park_retraction_mm, abs=0.3)
    assert b"M410" in printer.sent_bytes and b"M401" not in printer.sent_bytes


def test_print_resumes_at_its_position():
    printer = make_rig().run_until_printing()
    printer.session.pause(printer.now_s)
    printer.run(
        until=lambda: printer.session.context.phase is PrintPhase.PAUSED and printer.read_targets()[0] == 0.0
    )
    end_s = printer.now_s + 900.0
    printer.run(until=lambda: printer.now_s > end_s)
    assert printer.firmware.phase is Phase.RUNNING  # the dead-man timer is restarted
    printer.session.resume(printer.now_s)
    printer.run()
    assert_end_with_heaters_off(printer, PrintPhase.DONE, None)
    assert printer.firmware.board.filament_mm == pytest.approx(200.0 + 12.5, abs=0.05)


def test_dead_man_timer_switches_the_heaters_off_after_the_host_died():
    printer = make_rig().run_until_printing()
    firmware, started_s = printer.firmware, printer.now_s
    while firmware.phase is Phase.RUNNING:
        assert printer.now_s < started_s + 700.0, "the board continues to heat"
        printer.now_s = max(printer.now_s + 1e-3, firmware.compute_deadline_s())
        firmware.feed(b"", printer.now_s)
    assert firmware.phase is Phase.HALTED and printer.read_targets() == (0.0, 0.0)


def test_halted_board_is_reset_and_confirmed_off():
    printer = make_rig(kill_after=150).run()
    assert_end_with_heaters_off(printer, PrintPhase.FAILED, Fault.KILL)
    assert printer.firmware.phase is Phase.RUNNING
    assert b"G28 Z0" not in printer.sent_bytes  # the Z switch is at the bed, below the part


def test_head_does_not_move_after_a_reset_during_a_cancel():
    printer = make_rig(silent_after=150).run_until_printing(60)
    printer.session.cancel("enough", printer.now_s)
    printer.run()
    assert printer.read_targets() == (0.0, 0.0) and printer.session.context.heaters_off
    assert b"G28 Z0" not in printer.sent_bytes


def test_heater_that_does_not_heat_ends_the_print():
    printer = make_rig(dead_nozzle=True).run()
    assert printer.session.context.phase is PrintPhase.FAILED
    assert printer.session.context.fault in (Fault.HEATER_TIMEOUT, Fault.KILL)
    assert printer.read_targets() == (0.0, 0.0)


def test_another_machine_with_marlin_2_is_not_heated():
    other_profile = replace(ENDER3, machine_text=b"MACHINE_TYPE:CR-10 EXTRUDER", title="CR-10")
    printer = Rig(Faults(), make_gcode(), "creality_ender3", profile=other_profile).run()
    assert (printer.session.context.phase, printer.session.context.fault) == (
        PrintPhase.FAILED,
        Fault.WRONG_PRINTER,
    )
    assert "a machine other than the CR-10" in (printer.session.context.reason or "")
    assert b"M104 S2" not in printer.sent_bytes and b"M140 S6" not in printer.sent_bytes


@pytest.mark.parametrize("model", ["ultimaker2_plus", "creality_ender3"])
def test_board_with_another_firmware_is_not_heated(model: str):
    profile = PROFILES["creality_ender3" if model == "ultimaker2_plus" else "ultimaker2_plus"]
    printer = Rig(Faults(), make_gcode(), model, profile=profile).run()
    assert printer.session.context.phase is PrintPhase.FAILED
    assert printer.firmware.board.nozzle.compute_temperature_c(printer.now_s) < 25.0


def test_relative_extrusion_is_refused():
    with pytest.raises(BadGcode, match="M83 the firmware forgets it"):
        read_program(io.BytesIO(b"M83\n"), ENDER3)


@pytest.mark.parametrize("fault", ["drop_ok", "swallow", "checksum"])
def test_hot_head_stops_no_longer_than_the_keep_alive_interval(fault: str):
    """Use moves so short that the planner contains only 0.1 s of them."""
    move_lines = "\n".join(f"G1 F3000 X{50 + 0.3 * (i % 100):.1f} Y{50 + i * 0.01:.2f}" for i in range(3000))
    text = make_gcode(1).replace("G1 F3000 X50 Y50.00 E1", f"G1 F3000 X50 Y50.00 E1\n{move_lines}")
    printer = Rig(Faults(**{fault: 0.002}), text, "creality_ender3", seed=4, profile=ENDER3)
    longest_stall_s, last_starvation_s = 0.0, 0.0
    while not printer.session.context.has_ended:
        printer.step()
        starvation_s = printer.firmware.starvation_s
        longest_stall_s, last_starvation_s = (
            max(longest_stall_s, starvation_s - last_starvation_s),
            starvation_s,
        )
    assert_end_with_heaters_off(printer, PrintPhase.DONE, None)
    assert 0.0 < longest_stall_s < 2.0
