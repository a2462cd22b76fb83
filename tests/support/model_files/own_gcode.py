"""Acceptance of own G-code, and checks of the result with a separate reader."""

import re

import pytest

from drivers.gcode import HeaterName, measure_retraction_mm, read_program
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from model_files.make_gcode import FILAMENT_MM2, TravelTimeEstimator
from printers.slicing_printers import UM2_PLUS
from slicing.errors import GcodeRefused
from slicing.own_gcode import PrintTarget, accept_gcode

ALLOWED_COMMAND_PATTERN = re.compile(
    rb"(G0|G1|G4|G28|G90|G91|G92|G21|M82|M84|M104|M106|M107|M109|M140|M190|M220 S100|M221 S100)( |\Z)"
)


def accept(lines, time_estimator=None, end=b"\n", nozzle_mm=0.4):
    return accept_gcode(
        [line if isinstance(line, bytes) else line.encode() + end for line in lines],
        PrintTarget(UM2_PLUS, FILAMENT_MM2, nozzle_mm, nozzle_c=210.0, bed_c=65.0),
        time_estimator=time_estimator or TravelTimeEstimator(),
    )


def extract_body(result):
    """Return the lines between the farm's start and end code."""
    start = UM2_PLUS.code.build_start_code(result.nozzle_c, result.bed_c, FILAMENT_MM2)
    text = result.gcode.decode().removeprefix(f";FLAVOR:Marlin\n{start}\n")
    assert text.endswith(f"{UM2_PLUS.code.build_end_code(0.0)}\n")
    return text.removesuffix(f"{UM2_PLUS.code.build_end_code(0.0)}\n").splitlines()


def list_moves(lines):
    """List the moves of a body as (x, y, z, fed filament) in mm, without the reader of the farm."""
    position, moves = {"X": 5.0, "Y": 50.0, "Z": 20.0, "E": 0.0}, []
    for line in lines:
        values = {w[0]: float(w[1:]) for w in line.split()[1:] if not line.startswith((";", "M"))}
        if line.startswith("G92"):
            position["E"] = 0.0
        elif line.startswith("G"):
            end = {**position, **{k: v for k, v in values.items() if k != "F"}}
            moves.append((end["X"], end["Y"], end["Z"], end["E"] - position["E"]))
            position = end
    return moves


def select_extrusions(moves):
    return [m for m in moves if m[3] > 1e-6]


def check_rules(result):
    """Check a program against the rules for all programs of the farm, and return it."""
    program = read_program(result.gcode.splitlines(), ULTIMAKER2_PLUS)
    assert all(ALLOWED_COMMAND_PATTERN.match(line) for line in program.read_lines(0, program.line_count))
    for heater in HeaterName:
        assert program.find_target_c(heater, program.line_count) == 0
    assert measure_retraction_mm(program, program.line_count) == pytest.approx(20.0, abs=1e-3)
    assert program.home_line < program.extrusion_line < program.line_count
    assert program.time_s == pytest.approx(result.print_time_s, abs=1e-3)
    return program


def assert_refused(lines, expected_text):
    with pytest.raises(GcodeRefused, match=expected_text):
        accept(lines)
