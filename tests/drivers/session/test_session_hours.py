"""End of a print at its time limit."""

import pytest

from drivers.emulator.faults import Faults
from drivers.errors import Fault
from drivers.messages import Filament, PrintPhase
from printers.print_rig import Rig, assert_end_with_heaters_off, make_gcode


@pytest.mark.parametrize("no_reset", [False, True])
def test_print_over_its_time_limit_is_ended_safely(no_reset: bool):
    rig = Rig(Faults(no_reset=no_reset), text=make_gcode(3000)).run_until_printing(100)
    rig.session.context.ends_by_s = rig.now_s + 60.0
    limit_s = rig.session.context.ends_by_s
    rig.run()
    assert_end_with_heaters_off(rig, PrintPhase.FAILED, Fault.HOURS_ENDED)
    assert (
        rig.session.context.ended_s is not None and limit_s <= rig.session.context.ended_s <= limit_s + 120.0
    )
    assert rig.session.context.filament is Filament.PARKED
    assert rig.firmware.board.filament_end_mm == pytest.approx(-20.0, abs=0.5)
    assert rig.firmware.reset_count == (0 if no_reset else 1)


def test_time_limit_applies_in_pauses_and_heat_up():
    paused_rig = Rig(text=make_gcode(300)).run_until_printing(100)
    paused_rig.session.pause(paused_rig.now_s)
    paused_rig.run(until=lambda: paused_rig.session.context.pause_ends_s is not None)
    paused_rig.session.context.ends_by_s = paused_rig.now_s + 60.0
    assert_end_with_heaters_off(paused_rig.run(), PrintPhase.FAILED, Fault.HOURS_ENDED)
    heating_rig = Rig()
    heating_rig.run(until=lambda: heating_rig.session.context.phase is PrintPhase.HEATING)
    heating_rig.session.context.ends_by_s = heating_rig.now_s + 5.0
    assert_end_with_heaters_off(heating_rig.run(), PrintPhase.FAILED, Fault.HOURS_ENDED)
    assert not heating_rig.session.context.has_extruded


def test_postponed_time_limit_ends_nothing():
    rig = Rig(text=make_gcode(200)).run_until_printing(100)
    rig.session.context.ends_by_s = rig.now_s + 5.0
    rig.session.advance((), rig.now_s)
    rig.session.context.ends_by_s = None
    rig.run(until=lambda: rig.session.context.phase is PrintPhase.ENDING)
    rig.session.context.ends_by_s = rig.now_s
    assert_end_with_heaters_off(rig.run(), PrintPhase.DONE, None)
