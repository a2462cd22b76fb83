"""Position and retraction of the filament at any line of a program."""

import io
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.gcode import Program, measure_retraction_mm, read_position, read_program
from drivers.gcode.filament_position import WINDOW_LINES
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS

HEAD = "M82\nG28\nM109 S210\nG92 E0\nG1 F47 X10 Y10 Z1 E7.8\nG92 E0\n"


def parse_program(text: str) -> Program:
    return read_program(io.BytesIO((HEAD + text).encode()), ULTIMAKER2_PLUS)


def measure_retraction_after(
    text: str, last_position: tuple[float, float, float, float] | None = None
) -> float:
    program = parse_program(text)
    return measure_retraction_mm(program, program.line_count, last_position)


@pytest.mark.parametrize(
    ("text", "retracted_mm"),
    [
        ("G1 X20 E5\n", 0.0),
        ("G1 X20 E5\nG1 E-1.5\n", 6.5),
        ("G1 X20 E5\nG1 E-1.5\nG0 X80\n", 6.5),
        ("G1 X20 E5\nG1 E-1.5\nG0 X80\nG1 E5\n", 0.0),
        ("G1 X20 E5\nG1 E-1.5\nG92 E0\nG1 E4\n", 2.5),
        ("G1 X20 E5\nG92 E0\nG1 E-6.5\nG91\nG1 E-13.5\nG90\nG28\n", 20.0),
        ("M83\nG1 X20 E5\nG1 E-2\nG1 E-1\nG1 E0.5\n", 2.5),
    ],
)
def test_retraction_is_measured_as_the_firmware_counts_it(text: str, retracted_mm: float):
    assert measure_retraction_after(text) == pytest.approx(retracted_mm)


HOP_GCODE = "G1 X20 Y10 E5\nG1 E-1.5\nG0 X80\nG1 E5\nG1 X90 E6\n"


@pytest.mark.parametrize(
    ("last_position", "retracted_mm"),
    [
        ((15.0, 10.0, 1.0, 2.5), 0.0),  # before the retraction
        ((20.0, 10.0, 1.0, 2.0), 3.0),  # during the retraction
        ((50.0, 10.0, 1.0, -1.5), 6.5),  # after the retraction
        ((80.0, 10.0, 1.0, 2.0), 3.0),  # while the filament returns
        ((85.0, 10.0, 1.0, 5.5), 0.0),
        ((500.0, 10.0, 1.0, 2.0), 0.0),  # no move passes this position, so the last line counts
    ],
)
def test_retraction_is_measured_within_an_interrupted_move(
    last_position: tuple[float, float, float, float], retracted_mm: float
):
    assert measure_retraction_after(HOP_GCODE, last_position) == pytest.approx(retracted_mm)


@given(st.lists(st.sampled_from((1.0, 0.5, -2.0, 2.0, 0.0)), min_size=1, max_size=60), st.booleans())
def test_retraction_is_independent_of_earlier_lines_and_of_the_mode(feeds_mm: list[float], is_relative: bool):
    e_mm = retracted_mm = 0.0
    moves = []
    for i, feed_mm in enumerate(feeds_mm):
        e_mm += feed_mm
        retracted_mm = max(0.0, retracted_mm - feed_mm)
        moves.append(f"G1 X{i} E{feed_mm if is_relative else 100 + e_mm:g}\n")
    long_text = (
        "".join(f"G1 X{i % 7} E{100 * i / 5000:g}\n" for i in range(5000)) if not is_relative else "M83\n"
    )
    assert WINDOW_LINES < 5000
    assert measure_retraction_after(
        long_text + ("" if is_relative else "G1 E100\n") + "".join(moves)
    ) == pytest.approx(retracted_mm)


def test_positions_are_read_from_answers_to_m114():
    assert read_position(b"X:1.00Y:-2.50Z:3.00E:4.25 Count X: 1.00Y:2.00Z:3.00") == [1.0, -2.5, 3.0, 4.25]
    assert read_position(b"echo: X") is None
    assert read_position(b"X:1.0.0Y:2Z:3E:4") is None
    assert not math.isnan(measure_retraction_after("G1 X1 E1\n"))
