"""Start and end code of a printer model."""

from dataclasses import replace

import pytest

from printers.slicing_printers import PRINTERS, UM2_PLUS

FILAMENT_MM2 = 6.379


def test_start_code_heats_nozzle_and_bed_and_primes_the_volume_of_the_model():
    lines = UM2_PLUS.code.build_start_code(205.0, 60.0, FILAMENT_MM2).splitlines()
    assert {"M140 S60", "M190 S60", "M109 S205", "G1 F47 E7.8"} <= {*lines}
    assert lines.index("G28") < lines.index("M190 S60") < lines.index("M109 S205")


def test_bed_at_0_c_is_left_out_of_the_start_code():
    start_code = UM2_PLUS.code.build_start_code(205.0, 0.0, FILAMENT_MM2)
    assert "M140" not in start_code and "M190" not in start_code


@pytest.mark.parametrize("retracted_mm", [0.0, 6.5])
def test_end_code_completes_the_parking_retraction(retracted_mm):
    code = replace(UM2_PLUS.code, park_retraction_mm=12.0)
    assert f"G1 F1500 E{retracted_mm - 12:g}" in code.build_end_code(retracted_mm).splitlines()


@pytest.mark.parametrize("model", sorted(PRINTERS))
def test_each_end_code_switches_both_heaters_off(model):
    lines = PRINTERS[model].code.build_end_code(0.0).splitlines()
    assert {"M104 S0", "M140 S0"} <= {*lines}
