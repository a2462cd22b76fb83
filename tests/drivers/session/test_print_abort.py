"""Ends of prints, after which the next print has the filament at the nozzle, or a person is asked."""

import math
import random
from collections.abc import Callable
from dataclasses import fields

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.errors import Fault
from drivers.messages import Filament, PrintPhase
from drivers.session import Pace, Session, SessionContext
from printers.print_rig import PLUS_PROFILE, Rig, make_gcode, make_retracting_gcode

TOLERANCE_MM = 0.5
DELAYED_FAULTS = [field.name for field in fields(Faults) if field.name.endswith("_after")]
COMPLETE_PRINT_MM = Rig(text=make_gcode(150)).run().firmware.board.filament_mm

Ending = Callable[[Rig], None]


def finish_print(rig: Rig) -> None:
    pass


def cancel_print(rig: Rig) -> None:
    rig.session.cancel("no more", rig.now_s)


def pause_print(rig: Rig, seconds: float) -> None:
    """Request a pause, and run for `seconds`."""
    rig.session.pause(rig.now_s)
    end_s = rig.now_s + seconds
    rig.run(until=lambda: rig.now_s >= end_s)


def kill_agent(rig: Rig) -> None:
    """Kill the agent, and begin a session with the state of the filament from the journal."""
    filament = rig.session.context.filament
    rig.link.on_closed()
    rig.session = Session(SessionContext(rig.link, None, PLUS_PROFILE, filament, Pace(), rig.now_s))


def lose_port_temporarily(rig: Rig) -> None:
    rig.is_plugged = False
    rig.link.on_closed()
    rig.session.fail(Fault.PORT_LOST, "went away", rig.now_s)
    rig.reconnect_at_s = rig.now_s + 10.0


def turn_knob(rig: Rig) -> None:
    rig.firmware.board.set_nozzle_target(150.0, rig.now_s)


def mute_board_and_cancel(rig: Rig) -> None:
    rig.firmware.trigger_fault("silent_after", rig.now_s)
    cancel_print(rig)


def make_fault_ending(name: str) -> Ending:
    def run_ending(rig: Rig) -> None:
        rig.firmware.trigger_fault(name, rig.now_s)

    run_ending.__name__ = name
    return run_ending


def make_cancel_after_pause(seconds: float) -> Ending:
    def run_ending(rig: Rig) -> None:
        pause_print(rig, seconds)
        cancel_print(rig)

    run_ending.__name__ = f"cancelled_after_a_pause_of_{seconds:g}_s"
    return run_ending


def make_kill_after_pause(seconds: float) -> Ending:
    def run_ending(rig: Rig) -> None:
        pause_print(rig, seconds)
        kill_agent(rig)

    run_ending.__name__ = f"killed_after_a_pause_of_{seconds:g}_s"
    return run_ending


def make_cancel_after_resume(seconds: float) -> Ending:
    def run_ending(rig: Rig) -> None:
        pause_print(rig, 60.0)
        rig.session.resume(rig.now_s)
        end_s = rig.now_s + seconds
        rig.run(until=lambda: rig.now_s >= end_s)
        cancel_print(rig)

    run_ending.__name__ = f"cancelled_after_a_resume_of_{seconds:g}_s"
    return run_ending


def let_pause_expire(rig: Rig) -> None:
    pause_print(rig, 60.0)


COMMON_ENDINGS: list[Ending] = [
    finish_print, cancel_print, let_pause_expire,
    make_cancel_after_pause(30.0), make_cancel_after_pause(60.0),
]  # fmt: skip
ENDINGS: list[Ending] = [
    *COMMON_ENDINGS,
    *(make_cancel_after_pause(seconds) for seconds in (0.0, 1.0, 3.0, 6.0)),
    *(make_cancel_after_resume(seconds) for seconds in (0.0, 20.0, 40.0, 50.0, 52.0, 60.0)),
    *(make_kill_after_pause(seconds) for seconds in (3.0, 60.0)),
    kill_agent,
    lose_port_temporarily,
    turn_knob,
    mute_board_and_cancel,
    *(make_fault_ending(name) for name in DELAYED_FAULTS),
]


def end_print(ending: Ending, lines: int, seconds: float, text: str) -> Rig:
    """Run a print, end it in some way after a number of lines and seconds, and run to its end."""
    rig = Rig(text=text)
    rig.run(until=lambda: rig.session.context.acknowledged_line_count >= lines)
    end_s = rig.now_s + seconds
    rig.run(until=lambda: rig.now_s >= end_s)
    if not rig.session.context.has_ended:
        ending(rig)
    rig.run()
    assert rig.session.context.has_ended
    return rig


def measure_next_filament_end_mm(rig: Rig) -> float:
    """Measure the position of the filament's tip in mm at the first extruding line of the next print."""
    board = rig.firmware.board
    no_faults = Faults()
    next_rig = Rig(text=make_gcode(20), filament=rig.session.context.filament)
    next_rig.firmware = EmulatedFirmware(PLUS_PROFILE, no_faults, random.Random(0), next_rig.now_s)
    next_rig.firmware.board.filament_end_mm = board.filament_end_mm
    next_rig.run(until=lambda: next_rig.session.context.phase is PrintPhase.PRINTING)
    return next_rig.firmware.board.filament_end_mm


@pytest.mark.parametrize("lines", [0, 12, 60, 137])
@pytest.mark.parametrize("ending", ENDINGS, ids=lambda ending: ending.__name__)
def test_next_print_knows_the_filament_position_or_asks_a_person(ending: Ending, lines: int):
    rig = end_print(ending, lines, 0.7, make_retracting_gcode(50))
    if rig.session.context.filament is not Filament.UNKNOWN:
        assert abs(measure_next_filament_end_mm(rig)) <= TOLERANCE_MM
        end_mm = {Filament.PARKED: -20.0, Filament.AT_NOZZLE: 0.0}[rig.session.context.filament]
        assert rig.firmware.board.filament_end_mm == pytest.approx(end_mm, abs=TOLERANCE_MM)


@given(ending=st.sampled_from(ENDINGS), lines=st.integers(0, 250), seconds=st.floats(0.0, 20.0))
@settings(max_examples=40, deadline=None)
def test_fault_at_any_line_ends_the_print_safely(ending: Ending, lines: int, seconds: float):
    rig = end_print(ending, lines, seconds, make_retracting_gcode(50))
    if rig.session.context.filament is not Filament.UNKNOWN:
        assert abs(measure_next_filament_end_mm(rig)) <= TOLERANCE_MM


@pytest.mark.parametrize("lines", [60, 137, 210])
def test_responsive_firmware_parks_the_filament(lines: int):
    """Check that usual ends of a print need no person."""
    for ending in COMMON_ENDINGS:
        assert (
            end_print(ending, lines, 0.7, make_retracting_gcode(50)).session.context.filament
            is Filament.PARKED
        )


@given(
    faults=st.builds(
        Faults,
        noise=st.sampled_from([0.0, 0.0001, 0.002]),
        lost=st.sampled_from([0.0, 0.0005]),
        checksum=st.sampled_from([0.0, 0.003, 0.1]),
        drop_ok=st.sampled_from([0.0, 0.003, 0.1]),
        garble_ok=st.sampled_from([0.0, 0.01]),
        swallow=st.sampled_from([0.0, 0.003]),
        no_number=st.sampled_from([0.0, 0.003]),
        mute_resend=st.booleans(),
        no_reset=st.sampled_from([False, False, True]),
        dead_bed=st.sampled_from([False, False, True]),
        weak_nozzle=st.sampled_from([False, False, True]),
        no_endstop=st.sampled_from([0, 0, 0, 1, 3]),
        **{name: st.sampled_from([0, 0, 0, 0, 30, 450, 600]) for name in DELAYED_FAULTS},
    ),
    cancel_s=st.sampled_from([math.inf, 5.0, 300.0, 600.0]),
    pause_s=st.just(math.inf) | st.floats(200.0, 700.0),
    unplug_s=st.sampled_from([math.inf, math.inf, 300.0, 500.0]),
    reconnect_after_s=st.sampled_from([2.0, 20.0, 100.0]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=120, deadline=None)
def test_any_print_ends_and_reports_its_heaters_correctly(
    faults: Faults, cancel_s: float, pause_s: float, unplug_s: float, reconnect_after_s: float, seed: int
):
    """Check that heaters are off or a power-off is requested, and that a finished print was executed."""
    rig = Rig(faults, text=make_gcode(150), seed=seed)
    board, session, is_paused = rig.firmware.board, rig.session, False
    while not session.context.has_ended:
        rig.step()
        elapsed_s = rig.now_s - 1000.0
        if elapsed_s > unplug_s:
            unplug_s, rig.is_plugged, rig.reconnect_at_s = math.inf, False, rig.now_s + reconnect_after_s
            rig.link.on_closed()
            session.fail(Fault.PORT_LOST, "unplugged", rig.now_s)
        if elapsed_s > cancel_s:
            session.cancel("no more", rig.now_s)
        if elapsed_s > pause_s and not is_paused:
            is_paused = True
            session.pause(rig.now_s)
        if session.context.phase is PrintPhase.PAUSED and elapsed_s > pause_s + 400.0:
            session.resume(rig.now_s)
        assert elapsed_s < 20_000.0, "the print does not end"
    assert (session.context.phase is PrintPhase.FAILED) == (session.context.fault is not None)
    assert session.context.heaters_off or session.context.wants_power_off
    if session.context.heaters_off:
        assert rig.read_targets() == (0.0, 0.0)
        for heater in (board.nozzle, board.bed):
            # A heater that is stuck on is only this cold if the print has just begun.
            assert not heater.is_mosfet_shorted or heater.compute_temperature_c(rig.now_s) < 90.0
    if session.context.phase is PrintPhase.DONE and not (
        rig.firmware.noise and rig.firmware.noise.altered_line_count
    ):
        assert board.filament_mm == pytest.approx(COMPLETE_PRINT_MM, abs=0.05)
