"""Identification of the printer before anything heats."""

import pytest

from drivers.emulator.faults import Faults
from drivers.errors import Fault
from drivers.messages import PrintPhase
from printers.print_rig import Rig, assert_end_with_heaters_off, make_gcode


def test_board_of_another_model_is_refused_before_anything_heats():
    rig = Rig(model="ultimaker2_extended_plus").run()
    assert_end_with_heaters_off(rig, PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert b"M140 S60" not in rig.sent_bytes
    assert not rig.session.context.has_extruded


def test_printer_is_identified_by_its_home_offset():
    first_rig = Rig(Faults(home_offset_hundredths_mm=243)).run()
    assert first_rig.session.context.identity == "X0.00 Y0.00 Z-12.43"
    second_rig = Rig(Faults(home_offset_hundredths_mm=243), identity=first_rig.session.context.identity).run()
    assert_end_with_heaters_off(second_rig, PrintPhase.DONE, None)
    other_rig = Rig(Faults(home_offset_hundredths_mm=187), identity=first_rig.session.context.identity).run()
    assert_end_with_heaters_off(other_rig, PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert (
        b"M140" not in other_rig.sent_bytes.replace(b"M140 S0", b"")
        and not other_rig.session.context.has_extruded
    )


@pytest.mark.parametrize("banner", [b"Vers:", b"M206"])
def test_unreadable_banner_is_requested_again_and_then_refused(banner: bytes):
    rig = Rig()
    receive = rig.link.receive
    rig.link.receive = lambda data, now_s: receive(data.replace(banner, b"?????"), now_s)  # type: ignore[method-assign]
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert rig.firmware.reset_count == 3
    restarted_rig = Rig()
    receive = restarted_rig.link.receive
    restarted_rig.link.receive = lambda data, now_s: receive(  # type: ignore[method-assign]
        data.replace(banner, b"?????") if restarted_rig.firmware.reset_count < 2 else data, now_s
    )
    assert_end_with_heaters_off(restarted_rig.run(), PrintPhase.DONE, None)


def test_extended_with_a_plain_banner_is_detected_by_its_height():
    rig = Rig(model="ultimaker2_extended_plus")
    receive = rig.link.receive
    rig.link.receive = lambda data, now_s: receive(data.replace(b"3.3.0ex", b"3.3.0"), now_s)  # type: ignore[method-assign]
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert "315" in str(rig.session.context.reason) and b"M104 S210" not in rig.sent_bytes


def test_file_that_homes_axes_one_by_one_is_accepted():
    text = make_gcode().replace("\nG28\nG1", "\nG28 X0 Y0\nG28 Z0\nG1")
    assert_end_with_heaters_off(Rig(text=text).run(), PrintPhase.DONE, None)


def test_another_firmware_is_detected_by_m115():
    rig = Rig()
    receive = rig.link.receive
    rig.link.receive = lambda data, now_s: receive(data.replace(b"Ultimaker2", b"Ultimaker3"), now_s)  # type: ignore[method-assign]
    assert_end_with_heaters_off(rig.run(), PrintPhase.FAILED, Fault.WRONG_PRINTER)
    assert "M115" in str(rig.session.context.reason) and b"M140 S60" not in rig.sent_bytes
