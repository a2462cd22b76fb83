"""Whole prints on an emulated Ender-3, whose board has plain Marlin 2."""

import io
from dataclasses import replace

import pytest

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.listener import Phase
from drivers.errors import BadGcode, Fault
from drivers.gcode import read_program
from drivers.messages import Filament, PrintPhase
from drivers.printers import PROFILES
from print_rig import Rig, assert_ended_off

ENDER3 = PROFILES["creality_ender3"]


def gcode(moves: int = 200) -> str:
    path = "\n".join(f"G1 F3000 X{50 + 40 * (i % 2)} Y{50 + i * 0.2:.2f} E{i + 1}" for i in range(moves))
    start = "\n".join(ENDER3.start_code).format(bed_c=60.0, nozzle_c=205.0, prime_mm=12.5)
    end = "\n".join(ENDER3.end_code).format(park_mm=5.0 - ENDER3.parked_mm)
    return (
        f";FLAVOR:Marlin\n{start}\n;LAYER:0\nG0 F9000 X50 Y50 Z0.2\n{path}\n"
        f";TIME_ELAPSED:100\nG1 F1500 E{moves - 5:.2f}\n{end}\n"
    )


def rig(moves: int = 200, **faults: float) -> Rig:
    return Rig(Faults(**faults), gcode(moves), "creality_ender3", profile=ENDER3)


@pytest.mark.parametrize("advanced_ok", [False, True])
def test_a_part_is_printed_whole_each_line_once_and_ends_cold(advanced_ok: bool):
    one = rig(advanced_ok=advanced_ok).run()
    assert_ended_off(one, PrintPhase.DONE, None)
    board = one.firmware.board
    assert one.firmware.errors == 0 and one.link.repeated == 0
    assert board.filament_mm == pytest.approx(200.0 + 12.5, abs=0.01)  # 8 forth at the start, 8 back
    assert board.filament_end_mm == pytest.approx(-ENDER3.parked_mm, abs=0.01)
    assert one.session.context.filament is Filament.PARKED
    assert one.firmware.machine.homed and not board.bed_clear
    assert one.phases[-3:] == [PrintPhase.PRINTING, PrintPhase.ENDING, PrintPhase.DONE]


@pytest.mark.parametrize("seed", range(3))
def test_a_part_is_exact_over_a_noisy_wire(seed: int):
    faults = Faults(noise=2e-4, lost=1e-4, doubled=1e-4)
    one = Rig(faults, gcode(600), "creality_ender3", seed=seed, profile=ENDER3).run()
    assert_ended_off(one, PrintPhase.DONE, None)
    noise = one.firmware.noise
    assert noise is not None and noise.damaged > 0 and noise.altered == 0
    assert one.link.repeated > 0
    assert one.firmware.board.filament_mm == pytest.approx(600.0 + 12.5, abs=0.01)


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
def test_a_part_is_exact_where_lines_or_answers_are_lost(faults: dict[str, float], advanced_ok: bool):
    one = rig(400, advanced_ok=advanced_ok, **faults).run()
    assert_ended_off(one, PrintPhase.DONE, None)
    assert one.firmware.board.filament_mm == pytest.approx(400.0 + 12.5, abs=0.01)


def test_a_slow_move_is_waited_for_as_long_as_the_board_is_at_work():
    slow = gcode(60).replace("F3000", "F120")  # 20 s each, and the planner is full
    one = Rig(Faults(), slow, "creality_ender3", profile=ENDER3).run()
    assert_ended_off(one, PrintPhase.DONE, None)
    assert one.link.repeated == 0
    questions = one.sent.count(ENDER3.firmware.last_line_query)
    assert questions < 150  # one a line at most, and not one each 0.3 s


def test_a_cancel_lifts_the_head_off_the_part_and_parks_the_filament():
    one = rig().printing()
    one.session.cancel("enough", one.now_s)
    one.run()
    assert_ended_off(one, PrintPhase.CANCELLED, None)
    x, y, z, _ = one.firmware.machine.planner.position(one.now_s)
    assert (x, y) == (0.0, 0.0) and z == pytest.approx(26.0)  # 10 over the prime's, to the next mm
    assert one.firmware.board.filament_end_mm == pytest.approx(-ENDER3.parked_mm, abs=0.3)
    assert b"M410" in one.sent and b"M401" not in one.sent


def test_print_resumes_at_its_position():
    one = rig().printing()
    one.session.pause(one.now_s)
    one.run(until=lambda: one.session.context.phase is PrintPhase.PAUSED and one.targets()[0] == 0.0)
    until_s = one.now_s + 900.0
    one.run(until=lambda: one.now_s > until_s)
    assert one.firmware.phase is Phase.RUNNING  # the dead-man is fed
    one.session.resume(one.now_s)
    one.run()
    assert_ended_off(one, PrintPhase.DONE, None)
    assert one.firmware.board.filament_mm == pytest.approx(200.0 + 12.5, abs=0.05)


def test_the_dead_man_ends_the_heat_of_a_host_that_died():
    one = rig().printing()
    firmware, since_s = one.firmware, one.now_s
    while firmware.phase is Phase.RUNNING:
        assert one.now_s < since_s + 700.0, "it goes on heating"
        one.now_s = max(one.now_s + 1e-3, firmware.deadline_s())
        firmware.feed(b"", one.now_s)
    assert firmware.phase is Phase.HALTED and one.targets() == (0.0, 0.0)


def test_a_board_that_halted_is_reset_and_seen_off():
    one = rig(kill_after=150).run()
    assert_ended_off(one, PrintPhase.FAILED, Fault.KILL)
    assert one.firmware.phase is Phase.RUNNING
    assert b"G28 Z0" not in one.sent  # its switch is down at the bed, below the part


def test_the_head_stays_where_it_is_after_a_reset_in_a_cancel():
    one = rig(silent_after=150).printing(60)
    one.session.cancel("enough", one.now_s)
    one.run()
    assert one.targets() == (0.0, 0.0) and one.session.context.heaters_off
    assert b"G28 Z0" not in one.sent


def test_a_heater_that_gives_no_heat_ends_the_print():
    one = rig(dead_nozzle=True).run()
    assert one.session.context.phase is PrintPhase.FAILED
    assert one.session.context.fault in (Fault.HEATER_TIMEOUT, Fault.KILL)
    assert one.targets() == (0.0, 0.0)


def test_another_machine_with_marlin_2_is_not_heated():
    other = replace(ENDER3, machine_word=b"MACHINE_TYPE:CR-10 EXTRUDER", title="CR-10")
    one = Rig(Faults(), gcode(), "creality_ender3", profile=other).run()
    assert (one.session.context.phase, one.session.context.fault) == (PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert "another machine than the CR-10" in (one.session.context.reason or "")
    assert b"M104 S2" not in one.sent and b"M140 S6" not in one.sent


@pytest.mark.parametrize("model", ["ultimaker2_plus", "creality_ender3"])
def test_a_board_with_another_firmware_is_not_heated(model: str):
    profile = PROFILES["creality_ender3" if model == "ultimaker2_plus" else "ultimaker2_plus"]
    one = Rig(Faults(), gcode(), model, profile=profile).run()
    assert one.session.context.phase is PrintPhase.FAILED
    assert one.firmware.board.nozzle.temperature_c(one.now_s) < 25.0


def test_relative_extrusion_is_refused():
    with pytest.raises(BadGcode, match="M83 the firmware forgets it"):
        read_program(io.BytesIO(b"M83\n"), ENDER3)


@pytest.mark.parametrize("fault", ["drop_ok", "swallow", "checksum"])
def test_a_hot_head_stands_still_no_longer_than_a_sign_of_life_takes(fault: str):
    """Short moves, of which the planner holds a tenth of a second."""
    path = "\n".join(f"G1 F3000 X{50 + 0.3 * (i % 100):.1f} Y{50 + i * 0.01:.2f}" for i in range(3000))
    text = gcode(1).replace("G1 F3000 X50 Y50.00 E1", f"G1 F3000 X50 Y50.00 E1\n{path}")
    one = Rig(Faults(**{fault: 0.002}), text, "creality_ender3", seed=4, profile=ENDER3)
    worst_s, was_s = 0.0, 0.0
    while not one.session.context.ended:
        one.step()
        starved_s = one.firmware.starved_s
        worst_s, was_s = max(worst_s, starved_s - was_s), starved_s
    assert_ended_off(one, PrintPhase.DONE, None)
    assert 0.0 < worst_s < 2.0
