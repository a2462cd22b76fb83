"""Programs read from G-code: sent lines, times, progress and refused lines."""

import io
import math
import re
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import BadGcode
from drivers.firmware import ULTIMAKER2
from drivers.gcode import (
    Feature,
    HeaterName,
    MotionState,
    Program,
    Progress,
    measure_retraction_mm,
    read_program,
)
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS


def parse_program(text: str) -> Program:
    return read_program(io.BytesIO(text.encode()), ULTIMAKER2_PLUS)


SLICED_GCODE = """;FLAVOR:Marlin
;LAYER_COUNT:2
M140 S60 ; bed
G28
M190 S60
M105
M109 S210
G1 F2400 Z20

;LAYER:0
G1 X1 Y1 E1
G1 X2 Y1 E2
;TIME_ELAPSED:10.0
;LAYER:1
G1 X3 Y1 E3
G1 X4 Y1 E4
;TIME_ELAPSED:30.0
M104 S0
M140 S0
"""


def test_comments_blanks_and_queries_are_not_sent():
    program = parse_program(SLICED_GCODE)
    assert program.read_lines(0, 3) == [b"M140 S60", b"G28", b"M190 S60"]
    assert program.line_count == 11
    assert not any(b";" in line or b"M105" in line for line in program.read_lines(0, program.line_count))


def test_heating_lines_are_listed_with_their_targets():
    program = parse_program(SLICED_GCODE)
    waits = [(h.heater, h.target_c) for h in program.heat_commands if h.waits]
    assert waits == [(HeaterName.BED, 60.0), (HeaterName.NOZZLE, 210.0)]
    assert program.find_target_c(HeaterName.NOZZLE, 0) is None
    assert program.find_target_c(HeaterName.NOZZLE, 4) == 210.0
    assert program.find_target_c(HeaterName.NOZZLE, program.line_count) == 0.0


def test_progress_is_linear_in_time_within_a_layer():
    program = parse_program(SLICED_GCODE)
    assert program.home_line == 1
    assert program.extrusion_line == 5
    assert program.compute_progress(0).time_s == 0.0
    assert program.compute_progress(7).time_s == 10.0
    assert program.compute_progress(8).time_s == 20.0
    assert program.compute_progress(program.line_count).time_s == 30.0
    assert [program.compute_progress(n).layer for n in (0, 6, 7, 8)] == [None, 0, 1, 1]
    assert program.layer_count == 2


FEATURE_GCODE = """M109 S210
;LAYER:0
G0 F9000 X1 Y1 Z0.27
;TYPE:SKIRT
G1 X2 E1
;TIME_ELAPSED:4.0
;TYPE:WALL-OUTER
G1 X3 E2
G1 X4 E3
;TIME_ELAPSED:10.0
;LAYER:1
G0 X1 Z0.47
;TYPE:FILL
G1 X2 E4
G1 X3 E5
;TYPE:SOMETHING NEW
G1 X4 E6
;TIME_ELAPSED:20.0
G28
"""


def test_timeline_contains_time_layer_height_and_feature():
    program = parse_program(FEATURE_GCODE)
    assert tuple(program.timeline) == (
        Progress(1, 0.0, 0, 0.27, None),
        Progress(2, pytest.approx(2.0), 0, 0.27, Feature.SKIRT),
        Progress(3, 4.0, 0, 0.27, Feature.WALL_OUTER),
        Progress(5, 10.0, 1, 0.47, None),
        Progress(6, pytest.approx(12.5), 1, 0.47, Feature.FILL),
        Progress(8, pytest.approx(17.5), 1, 0.47, None),
        Progress(9, 20.0, 1, 0.47, None),
    )
    assert program.compute_progress(4) == Progress(4, 7.0, 0, 0.27, Feature.WALL_OUTER)
    assert program.compute_progress(0) == Progress(0, 0.0)
    assert program.compute_progress(program.line_count).time_s == program.time_s == 20.0


COMMENTS = st.one_of(
    st.builds("TIME_ELAPSED:{}".format, st.floats(0, 1e6)),
    st.builds("LAYER:{}".format, st.integers(0, 500)),
    st.builds("TYPE:{}".format, st.sampled_from([*Feature, "OTHER"])),
    st.sampled_from(["MESH:part.stl", "", "END"]),
)
LINES = st.one_of(
    st.builds("G1 X{}".format, st.integers(-99, 99)),
    st.builds("G0 F9000 Z{:.2f}".format, st.floats(0, 300)),
    st.builds(";{}".format, COMMENTS),
    st.builds("G1 X1 ;{}".format, COMMENTS),
    st.just(""),
)


@given(st.lists(LINES, max_size=60))
def test_commands_are_kept_and_times_never_decrease(lines: list[str]):
    commands = [command for line in lines if (command := line.partition(";")[0].strip())]
    if not commands:
        return
    program = parse_program("\n".join(lines))
    assert [line.decode() for line in program.read_lines(0, program.line_count)] == commands
    entries = [(progress.line, progress.time_s) for progress in program.timeline]
    assert entries == sorted(entries)
    assert len({line for line, _ in entries}) == len(entries)
    times_s = [program.compute_progress(line).time_s for line in range(program.line_count + 1)]
    assert times_s == sorted(times_s)
    assert times_s[-1] == program.time_s == max((s for _, s in entries), default=0.0)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("M16 12:30", "':'"),
        ("M16 Nozzle", "'N'"),
        ("M16 a*b", "'*'"),
        ("G1 X1 " + "Y1.00000 " * 9, "characters"),
        ("M0", "knob"),
        ("M999", "stopped for a reason"),
        ("G10", "retracts"),
        ("M109 R200", "no temperature"),
        ("hello", "not a command"),
        ("M16 \x01", "plain text"),
        ("M00", "knob"),
        ("M303 S210", "heats"),
        ("M109 S500", "too hot"),
        ("M140 S130", "too hot"),
        ("G1 E1", "M109"),
        (";FLAVOR:UltiGCode", "UltiGCode"),
        (";LAYER:nan", "not a number"),
        (";TIME_ELAPSED:inf", "not a number"),
        (";TIME_ELAPSED:soon", "not a number"),
        (";LAYER:3000000000", "not a number"),
        (";TIME_ELAPSED:1e9", "not a number"),
        ("G1 X1.2.3", "cannot be read"),
        ("G92 E1.2.3", "cannot be read"),
        ("G1 X1e5", "cannot be read"),
        ("G1 X--1", "cannot be read"),
        ("G1 X1-1", "cannot be read"),
        ("G1 X+1", "cannot be read"),
        ("G1 X.", "cannot be read"),
        ("G1 X1 X2", "cannot be read"),
        ("G1 E1 e2", "cannot be read"),
        ("M106 S255 G28", "cannot be read"),
        ("g1 x1", "not a command"),
        ("G1 X1\0", "plain text"),
        ("G1 X", "without a number"),
        ("G92 E", "without a number"),
        ("G1 X12345678", "not a number"),
        ("G1 X1234567", "not a number"),
        ("M104 S-5", "no temperature"),
        ("M23 other.gcode", "SD card"),
        ("G1 X1 ;" + 70_000 * "a", "characters"),
    ],
)
def test_lines_that_the_firmware_would_misread_are_refused_by_number(line: str, message: str):
    with pytest.raises(BadGcode) as error:
        parse_program("G28\n" + line + "\n")
    assert str(error.value).startswith("line 2: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_file_without_a_command_is_refused():
    with pytest.raises(BadGcode):
        parse_program("; nothing\n\n")


@given(
    st.lists(st.integers(-999, 999), min_size=1, max_size=1200),
    st.integers(0, 1300),
    st.integers(0, 1300),
)
def test_any_slice_of_lines_equals_the_slice_of_the_list(values: list[int], start: int, stop: int):
    lines = [b"G1 X%d" % v for v in values]
    program = read_program((line + b" ; c\n" for line in lines), ULTIMAKER2_PLUS)
    assert program.read_lines(start, stop) == lines[start:stop]
    assert program.line_count == len(lines)
    times_s = [program.compute_progress(n).time_s for n in range(0, program.line_count + 1, 50)]
    assert times_s == sorted(times_s)


@pytest.mark.parametrize(
    ("line", "sent_line"),
    [
        ("G1X1Y2", b"G1 X1 Y2"),
        ("G01 Y2 X1 F900", b"G1 Y2 X1 F900"),
        ("G1  X 1.  Y-.5", b"G1 X1. Y-.5"),
        ("G28 X Y", b"G28 X Y"),
        ("G 91", b"G91"),
        ("M0106 S128", b"M106 S128"),
    ],
)
def test_readable_lines_are_rewritten_in_one_form(line: str, sent_line: bytes):
    assert parse_program(line + "\n").read_lines(0, 1) == [sent_line]


def test_display_texts_are_dropped():
    program = parse_program("M117 Ärger: N1 *\nM118 " + "long " * 30 + "\nG28\n")
    assert program.read_lines(0, program.line_count) == [b"G28"]


_NUMBERS = [
    "1", "-1", "1.5", ".5", "-.5", "5.", "0", "-0", "999999", "1000000", "9" * 70, "", "1 2", "1e5", "1E5",
    "--1", ".", "-", "+1", "+", "1.2.3", "nan", "inf", "0x10", "1_0", "\0", "é",
]  # fmt: skip
_LINE_STARTS = [
    "G0", "G1", "G01", "G2", "G3", "G4", "G28", "G90", "G91", "G92", "M82", "M83", "M104", "M109", "M140",
    "M106", "M117", "T0", "G", "g1", "", "\ufeffG1", ";LAYER:", ";TIME_ELAPSED:", "G1\tX5;LAYER:", "G1X1Y1E1",
]  # fmt: skip
NUMBERS = st.sampled_from(_NUMBERS)
LETTERS = st.sampled_from([*"XYZEFSPGMTNxé*:;"])
WORDS = st.builds("{}{}{}".format, st.sampled_from(["", " ", "  ", "\t"]), LETTERS, NUMBERS)
HARD_LINES = st.builds(
    "{}{}{}".format,
    st.sampled_from(_LINE_STARTS),
    st.lists(WORDS, max_size=4).map("".join),
    st.sampled_from(["", " ", "\r", " ; a comment", ";", "\0", "a" * 90]),
)


@given(st.lists(HARD_LINES, min_size=1, max_size=12), st.data())
@settings(deadline=None)
def test_state_at_any_accepted_line_is_finite_and_never_crashes_an_agent(
    lines: list[str], data: st.DataObject
):
    """Read figures of the file in the middle of a print, as a pause, a cancel or a snapshot does."""
    accepted_lines = []
    for line in ["M109 S210", *lines]:
        try:
            program = parse_program("\n".join(["M109 S210", *accepted_lines, line]))
        except BadGcode as error:
            assert str(error).startswith("line ") and "\n" not in str(error)
        else:
            accepted_lines.append(line)
    program = parse_program("\n".join(accepted_lines))
    line_count = data.draw(st.integers(0, program.line_count))
    moves = MotionState(program, line_count)
    values = [
        mm for mm in (*moves.position_mm, moves.retracted_mm, moves.feedrate_mm_min) if not math.isnan(mm)
    ]
    assert all(abs(mm) < 1e9 for mm in values)
    assert 0.0 <= measure_retraction_mm(program, line_count, (10.0, 10.0, 1.0, 1.0)) < 1e9
    progress = program.compute_progress(line_count)
    assert all(
        abs(number) < 1e9
        for number in (
            progress.time_s,
            progress.z_mm,
            program.compute_max_height_mm(line_count),
            program.time_s,
        )
    )
    sent_lines = program.read_lines(0, program.line_count)
    assert (
        parse_program("\n".join(line.decode() for line in sent_lines)).read_lines(0, program.line_count)
        == sent_lines
    )
    assert all(re.fullmatch(rb"[GMT]\d+( [A-Z](-?(\d+(\.\d*)?|\.\d+))?)*", line) for line in sent_lines)


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes):
    try:
        program = read_program(io.BytesIO(data), ULTIMAKER2_PLUS)
    except BadGcode:
        return
    assert all(
        0 < len(line) <= ULTIMAKER2.max_command_bytes for line in program.read_lines(0, program.line_count)
    )


def test_heating_lines_are_found_in_every_notation():
    program = parse_program("M104S200\nM0109 T0 S210\nM190S60\nG1 E1\n")
    results = [(h.heater, h.target_c, h.waits) for h in program.heat_commands]
    nozzle, bed = HeaterName.NOZZLE, HeaterName.BED
    assert results == [(nozzle, 200.0, False), (nozzle, 210.0, True), (bed, 60.0, True)]


def test_g92_is_not_counted_as_extrusion():
    program = parse_program("G92 E0\nM109 S210\nG1 X1 E1\n")
    assert program.extrusion_line == 2


def test_long_files_and_their_timelines_take_little_memory():
    layers_text = "".join(f";TYPE:FILL\n{'G1 X1 Y1 E1' + chr(10)}" * 50 + f"G0 Z{i}\n" for i in range(1, 400))
    tracemalloc.start()
    try:
        program = read_program(
            io.BytesIO(("M109 S210\n;LAYER:0\n" + layers_text).encode()), ULTIMAKER2_PLUS, DiscardingStore()
        )
        held_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(program.timeline) > 15_000
    assert held_bytes < 60 * len(program.timeline)


class DiscardingStore:
    """Store that discards all data."""

    def write(self, data: bytes) -> None:
        pass

    def read(self, start: int, end: int) -> bytes:
        raise OSError


@given(st.lists(st.sampled_from(["G90", "G91", "M82", "M83", "G1 X1", "G1 Z2", "G1 Z7"]), min_size=1))
def test_modes_and_height_at_a_line_follow_from_the_lines_before(lines: list[str]):
    program = parse_program("\n".join(lines))
    is_relative = is_e_relative = False
    highest_mm = 0.0
    for n, line in enumerate(lines):
        assert (program.is_relative(n), program.is_e_relative(n)) == (is_relative, is_e_relative)
        assert highest_mm <= program.compute_max_height_mm(n) <= highest_mm + 1.0
        is_relative = {"G91": True, "G90": False}.get(line, is_relative)
        is_e_relative = {"M83": True, "M82": False}.get(line, is_e_relative)
        if line.startswith("G1 Z") and not is_relative:
            highest_mm = max(highest_mm, float(line[4:]))


@pytest.mark.parametrize("command", ["M104", "M109", "M140", "M190"])
def test_targets_above_the_limits_of_the_printer_are_refused(command: str):
    heater, max_c = ("nozzle", 260) if command in ("M104", "M109") else ("bed", 115)
    assert parse_program(f"{command} S{max_c}\n").heat_commands[0].target_c == max_c
    with pytest.raises(BadGcode, match=f"{max_c + 0.5} C is too hot for the {heater}: at most {max_c} C"):
        parse_program(f"{command} S{max_c + 0.5}\n")
