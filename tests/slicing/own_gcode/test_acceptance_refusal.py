"""Refusal of own G-code, so that every accepted file is safe."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from model_files.make_gcode import (
    FILAMENT_MM2,
    encode_lines,
    join_objects,
    make_marlin,
    make_square,
    make_ultigcode,
)
from model_files.own_gcode import accept, assert_refused, check_rules, extract_body, list_moves
from slicing.errors import GcodeRefused
from slicing.own_gcode import MAX_LINE_BYTES


@pytest.mark.parametrize("tail", [[], ["G1 E0 F1500"]])
def test_start_that_retracts_the_filament_out_of_the_hot_end_is_refused(tail):
    start = [";FLAVOR:Marlin", "G28", "M109 S200", "G92 E0", "G1 E-60 F1500", "M82", "G92 E-60"]
    lines = make_marlin(start=start)
    index = lines.index(";LAYER:0")
    assert_refused(
        [*lines[: index - 2], ";LAYER:0", *tail, *lines[index + 1 :]],
        "retracted by 60.0 mm, out of the hot end",
    )


@pytest.mark.parametrize(
    ("z", "message"), [("-3", "to Z -3, into the bed"), ("0", "at Z 0: .* above the bed")]
)
def test_start_that_leaves_the_head_in_the_bed_is_refused(z, message):
    tail = [f"G1 X100 Y100 Z{z}", ";LAYER:0", "G1 F1800 X120 Z0.2 E0.25", "G1 X140 E0.5"]
    assert_refused(make_marlin([], tail=tail), message)


def test_sequential_objects_are_limited_to_the_clearance_of_the_head():
    def make_two_towers(layers):
        return make_marlin(join_objects(make_square(layers=layers), make_square(at_mm=170.0, layers=2)))

    check_rules(accept(make_two_towers(layers=50)))
    assert_refused(make_two_towers(layers=53), "Z 0.2 beside a part that is 10.6 mm high.*Print Sequence")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        *((f"M{n}", rf"line \d+: M{n} ") for n in (0, 1, 226, 600, 601, 20, 23, 24, 28, 30, 92, 112, 200)),
        *((f"M{n} P1", rf"line \d+: M{n} .*remove it") for n in (301, 302, 303, 500, 501, 502, 999)),
        *((f"M{n} X1", rf"line \d+: M{n} ") for n in (92, 201, 203, 206)),
        ("G20", "millimetres"),
        ("T1", "single extruder"),
        ("G28", "homes in the middle"),
        ("G29", "not supported during a print"),
        ("M84", "motors"),
        ("M42 P3", "not supported during a print"),
        ("G5 X1", "not supported during a print"),
        ("G92 X0", "may reset E"),
        ("G92 X0 E0", "may reset E"),
        ("G92", "may reset E"),
        ("M104 S0", "cold .0 C. before the print ends"),
        ("M109 S150", "cold"),
        ("M104 S261", "limit of the nozzle is 260 C"),
        ("M104 S-5", "limit of the nozzle is 260 C"),
        ("M104", "no temperature"),
        ("M104 S200 T1", "single extruder"),
        ("M140 S0", "bed off"),
        ("M140 S0.3", "bed off"),
        ("M140 S116", "limit of the bed is 115 C"),
        ("M220", "needs S10 to S500"),
        ("M221 S0", "needs S10 to S300"),
        ("G4 S3600", "waits 3600 s"),
        ("G1 X10 E900", "extrudes 899 mm"),
        ("G1 F1500 E-30", "out of the hot end"),
        ("G1 F1 X10", "never ends"),
        ("G1 Z-1", "into the bed"),
        ("G1 X1e9", "damaged|space"),
        ("G1 X1000000000", "out of any printer's range"),
        ("G1 Xnan", "cannot be read|twice"),
        ("G1 Xinf", "cannot be read|damaged"),
        ("G1 X1E5", "a space before each E"),
        ("G1 X1 X2", "twice"),
        ("G1 X--1", "cannot be read"),
        ("G1 X1 : M112", "cannot be read"),
        ("G2 X10 Y10 R5", "I and J"),
        ("G2 X10 Y10 I1 J1", "no printer can make this arc"),
        ("G2 X100 Y100 I5000 J0", "no printer can make this arc"),
        ("N5 G1 X10*1", "checksum"),
        ("G1 X10*33", "cannot be read"),
        ("G1 X Y10", "cannot be read"),
        ("START_PRINT BED=60", "not a command"),
        ("hello", "not a command"),
        ("G1.5 X1", "not supported during a print"),
        ("M117\0", "plain text"),
        ("G1 X1 \x07", "plain text"),
        ("G1 Xé", "plain text"),
        ("M200", "mm3"),
        ("M200 D1.75", "mm3"),
        (";" + "x" * MAX_LINE_BYTES, "longer than"),
        ("(open", "not a command"),
    ],
)
def test_forbidden_command_of_a_print_is_refused_with_its_line(line, message):
    assert_refused(make_marlin(body=[line]), message)


@pytest.mark.parametrize(
    "line",
    ["M500", "M92 E400", "M302 P1", "M0", "T1", "G20", "M206 X5", "M200 D2.85", "G92 Z0", "M104 S200 T1"],
)
def test_command_that_changes_the_meaning_is_also_refused_in_the_start(line):
    assert_refused([";FLAVOR:Marlin", line, *make_marlin()[1:]], f"line 2: {line.split()[0]} ")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "start of its print"),
        ([";FLAVOR:Griffin", *make_marlin()[1:]], "flavour is 'Griffin'.*Marlin"),
        ([";FLAVOR:Marlin(Volumetric)", *make_marlin()[1:]], "Marlin"),
        (["; filament_diameter = 1.75", *make_marlin()], "1.75 mm"),
        (["; use_volumetric_e = 1", *make_marlin()], "Use volumetric E"),
        (["G28", "G1 X10 Y10 Z0.2 E1"], "start of its print"),
        (["G28", "M109 S200"], "prints nothing"),
        ([";LAYER:0", "G28", "M109 S200"], "nozzle's temperature"),
        (make_marlin(start=["G28", "M190 S60"]), "nozzle's temperature"),
        (make_marlin([], start=["G28", "M109 S200"], tail=[]), "prints nothing"),
        (make_marlin([[(100.0, 100.0, 0.0, 0.0), (120.0, 100.0, 0.0, 0.25)]]), "above the bed"),
        ([*make_marlin(start=["G28", "M109 S200"])[:5], "G1 X10 E1", "M104 S0"], "has set X, Y and Z"),
        (make_marlin(make_square(e_per_mm=0.4 * 0.2)), "mm3"),
        (make_marlin(make_square(e_per_mm=0.4 * 0.2 / 2.405)), "diameter"),
        (make_ultigcode(make_square(e_per_mm=0.4 * 0.2 / FILAMENT_MM2**2)), "mm3"),
        ([line for line in make_ultigcode() if "LAYER" not in line], "start of its print"),
    ],
)
def test_file_with_another_meaning_is_refused(lines, message):
    assert_refused(lines, message)


LINES = st.one_of(
    st.sampled_from(
        encode_lines(
            [*make_marlin(), *make_ultigcode(), "G91", "G90", "M83", "G10", "G11", "M221 S95", "G4 P9"]
        )
    ),
    st.sampled_from(
        encode_lines(
            ["G1 Z-3", "G1 Z0", "G1 E-60", "G1 E-6", "G1 X5 Y5 Z0.3", "G92 E0", "G1 E30", ";LAYER:0"]
        )
    ),
    st.from_regex(rb"[GMTN][0-9]{1,3}( [XYZEFSPIJRT]-?[0-9]{1,5}(\.[0-9]{0,3})?){0,4}\n", fullmatch=True),
    st.binary(max_size=30),
)


@given(
    st.lists(LINES, max_size=12), st.lists(LINES, max_size=12), st.sampled_from([make_marlin, make_ultigcode])
)
@example([], [b"G91\n", b"G1 E-1 X3 Z1\n"], make_marlin)
@example([b";LAYER:0\n"], [], make_ultigcode)
@settings(max_examples=300, deadline=None)
def test_any_file_is_refused_or_safe(lines_before, lines_inside, dialect):
    valid_lines = encode_lines(dialect())
    middle = len(valid_lines) - 8
    try:
        result = accept([*lines_before, *valid_lines[:middle], *lines_inside, *valid_lines[middle:]])
    except GcodeRefused as error:
        assert "\n" not in str(error)
    else:
        check_rules(result)
        assert result.min_mm[2] > 0
        retracted_mm = 0.0
        for x, y, z, e in list_moves(extract_body(result)):
            assert z >= 0
            retracted_mm = max(0.0, retracted_mm - e)
            assert retracted_mm <= 20.5 + 1e-4
            if z < 10:
                limits = zip(result.min_mm[:2], (x, y), result.max_mm[:2], strict=True)
                assert all(low - 1e-3 <= value <= high + 1e-3 for low, value, high in limits)
        assert retracted_mm == pytest.approx(0.0, abs=1e-4)
