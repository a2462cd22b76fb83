"""Acceptance of own G-code, and the lines that are printed."""

import gzip
import itertools
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.printers import PROFILES
from farm.planning.inspection.own_gcode import FirmwareTimeEstimator
from model_files.make_gcode import FILAMENT_MM2, PURGE_LINES, make_marlin, make_square, make_ultigcode
from model_files.own_gcode import (
    accept,
    assert_refused,
    check_rules,
    extract_body,
    list_moves,
    select_extrusions,
)
from slicing.errors import GcodeRefused


def test_start_and_end_of_a_marlin_file_are_replaced():
    result = accept(make_marlin())
    check_rules(result)
    lines = extract_body(result)
    extrusions = [(x, y, z, e) for layer in make_square() for x, y, z, e in layer if e]
    assert select_extrusions(list_moves(lines)) == [pytest.approx(move, abs=2e-5) for move in extrusions]
    assert not any("X5.000" in line for line in lines)  # the purge
    assert (result.nozzle_c, result.bed_c, result.layers) == (205.0, 60.0, 3)
    assert result.filament_mm == pytest.approx(240 * 0.08 / FILAMENT_MM2, abs=1e-4)
    assert result.min_mm == pytest.approx((100, 100, 0.2))
    assert result.max_mm == pytest.approx((120, 120, 0.6))


def test_head_approaches_the_first_point_from_above():
    moves = list_moves(extract_body(accept(make_marlin())))
    assert [move[2] for move in moves[:2]] == [20.0, pytest.approx(0.2)]
    assert moves[0][:2] == moves[1][:2] == (100.0, 100.0)


def test_position_after_the_start_script_is_irrelevant():
    """Raise the head and retract before the move to the first point, as PrusaSlicer does."""
    lines = make_marlin(start=["G28", "M109 S200", "G1 X5 Y5 Z0.3 F3000"], relative=True)
    index = lines.index(";LAYER:0") + 1
    lines[index:index] = ["G1 Z0.2", "G1 E-2 F2400"]
    lines.insert(index + 3, "G1 E2")
    result = accept(lines)
    check_rules(result)
    assert result.min_mm == result.reach_min_mm == pytest.approx((100, 100, 0.2))
    assert list_moves(extract_body(result))[:4] == [
        (5.0, 50.0, 20.0, -2.0),
        (100.0, 100.0, 20.0, 0.0),
        (100.0, 100.0, 0.2, 0.0),
        (100.0, 100.0, 0.2, 2.0),
    ]


def test_ultigcode_is_converted_to_mm_and_gets_explicit_retractions():
    result = accept(make_ultigcode())
    check_rules(result)
    assert (result.nozzle_mm, result.nozzle_c, result.bed_c) == (0.4, 210.0, 65.0)
    moves = list_moves(extract_body(result))
    assert result.filament_mm == pytest.approx(240 * 0.08 / FILAMENT_MM2, abs=1e-4)
    assert [m[3] for m in moves if m[3] < 0] == [pytest.approx(-6.5, abs=1e-4)] * 3
    assert sum(m[3] for m in moves) == pytest.approx(result.filament_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("slicer", "filament_mm", "seconds"),
    [("prusaslicer", 19.61, 78), ("slic3r", 20.04, None), ("ultigcode", 246 / FILAMENT_MM2, 104.9)],
)
def test_output_of_slicers_has_their_stated_filament_and_time(slicer, filament_mm, seconds):
    """Read a tile of 10 x 10 x 1 mm, sliced by PrusaSlicer 2.5.0, Slic3r 1.3.0 and CuraEngine 4.13."""
    recording_path = Path(__file__).parents[1] / "fixtures" / f"tile-{slicer}.gcode.gz"
    result = accept(
        gzip.decompress(recording_path.read_bytes()).splitlines(keepends=True),
        FirmwareTimeEstimator(PROFILES["ultimaker2_plus"]),
    )
    check_rules(result)
    assert (result.nozzle_mm, result.layers) == (0.4, 5)
    assert result.filament_mm == pytest.approx(filament_mm, rel=0.003)
    assert result.print_time_s == pytest.approx(seconds or result.print_time_s, rel=0.06)


def rewrite_lines(lines, notation):
    match notation:
        case "lower case":
            return [line if line.startswith(";") else line.lower() for line in lines]
        case "numbered":
            numbered_lines = [
                f"N{n} {line}" for n, line in enumerate(line for line in lines if line[0] != ";")
            ]
            numbered_lines = [f"{line}*{compute_xor(line)}" for line in numbered_lines]
            return [line if line[0] == ";" else numbered_lines.pop(0) for line in lines]
        case "commented":
            return [f"{line} ; and (so) on" if line[0] != ";" else line for line in lines]
        case "parenthesis":
            return [line.replace(" ", " (so) ", 1) if line[0] != ";" else line for line in lines]
        case "indented":
            return [f"\t {line}  " if line[0] != ";" else line for line in lines]
    return lines


def compute_xor(line):
    value = 0
    for byte in line.encode():
        value ^= byte
    return value


@pytest.mark.parametrize("notation", ["lower case", "numbered", "commented", "parenthesis", "indented"])
def test_lines_are_read_in_any_notation(notation):
    assert extract_body(accept(rewrite_lines(make_marlin(), notation))) == extract_body(accept(make_marlin()))
    assert extract_body(accept(rewrite_lines(make_marlin(), notation), end=b"\r\n")) == extract_body(
        accept(make_marlin())
    )


@st.composite
def draw_layers(draw):
    """Draw layers of moves on the bed, each line of a plausible width."""
    layers = []
    for number in range(draw(st.integers(1, 4))):
        z = 0.2 * (number + 1)
        points = draw(st.lists(st.tuples(*[st.integers(20, 200)] * 2), min_size=2, max_size=6, unique=True))
        moves = [(*map(float, points[0]), z, 0.0)]
        for (ax, ay), (bx, by) in itertools.pairwise(points):
            distance_mm = ((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5
            moves.append((float(bx), float(by), z, round(distance_mm * 0.0125, 5)))
        layers.append(moves)
    return layers


@given(draw_layers())
@settings(max_examples=40, deadline=None)
def test_print_is_the_same_in_every_dialect_of_gcode(layers):
    extruding_moves = [move for layer in layers for move in layer if move[3]]
    uncommented_lines = make_marlin(layers, comments=False)
    for lines in (
        make_marlin(layers),
        make_marlin(layers, relative=True),
        make_ultigcode(layers),
        uncommented_lines,
    ):
        result = accept(lines)
        check_rules(result)
        moves = list_moves(extract_body(result))
        extrusions = [
            m for m, previous in zip(moves[1:], moves, strict=False) if m[3] > 0 and m[:3] != previous[:3]
        ]
        assert extrusions == [pytest.approx(move, abs=5e-5) for move in extruding_moves]
        assert result.layers == len(layers)


def test_relative_moves_become_absolute():
    relative_lines = ["G91", "G1 X10 E0.12 F1800", "G1 Y10 E0.12", "G90", "G92 E0.5019"]
    lines = make_marlin(make_square(layers=1), tail=[*relative_lines, "M104 S0"])
    assert [m[:2] for m in select_extrusions(list_moves(extract_body(accept(lines))))[-2:]] == [
        (110.0, 100.0),
        (110.0, 110.0),
    ]


def test_low_move_over_clips_counts_as_printed():
    low_result, high_result = (
        accept(make_marlin(body=["G0 X1 Y2 Z0.5"])),
        accept(make_marlin(body=["G0 Z12", "G0 X1 Y2"])),
    )
    assert low_result.min_mm == pytest.approx((1, 2, 0.2))
    assert high_result.min_mm == pytest.approx((100, 100, 0.2))
    assert low_result.reach_min_mm[:2] == high_result.reach_min_mm[:2] == (1, 2)


def test_factors_of_speed_and_flow_are_applied_to_the_moves():
    full_result, half_result = accept(make_marlin()), accept(make_marlin(body=["M221 S50", "M220 S200"]))
    assert half_result.filament_mm == pytest.approx(full_result.filament_mm * (1 + 0.5 + 0.5) / 3, rel=1e-4)
    assert "G1 F3600 X120.000" in "\n".join(extract_body(half_result))


def test_arc_becomes_straight_moves_on_its_circle():
    arc = ["G3 F1800 X100 Y140 I0 J20 E0.8", "M104 S0"]
    moves = select_extrusions(
        list_moves(extract_body(accept(make_marlin([make_square(layers=1)[0][:1]], tail=arc))))
    )
    assert len(moves) > 50
    assert all(abs(((x - 100) ** 2 + (y - 120) ** 2) ** 0.5 - 20) < 2e-3 for x, y, _, _ in moves)
    assert max(x for x, *_ in moves) == pytest.approx(120, abs=0.02)
    assert sum(m[3] for m in moves) == pytest.approx(0.8, abs=1e-4)


def test_retraction_of_the_start_is_kept_before_the_first_layer():
    start = [";FLAVOR:Marlin", "G28", "M109 S200", *PURGE_LINES, "G92 E0", "G1 E-4 F1500"]
    lines = make_marlin(start=start, relative=True)
    lines.insert(lines.index(";LAYER:0") + 2, "G1 E4 F1500")
    moves = list_moves(extract_body(accept(lines)))
    assert moves[0] == (5.0, 50.0, 20.0, pytest.approx(-4.0))
    assert [m[3] for m in moves if m[3]][1] == pytest.approx(4.0)


def test_file_must_name_its_nozzle_if_those_of_the_printers_differ():
    with pytest.raises(GcodeRefused, match=r"nozzle_diameter = 0\.4"):
        accept(make_marlin(), nozzle_mm=None)
    assert accept(["; nozzle_diameter = 0.4", *make_marlin()], nozzle_mm=None).nozzle_mm == 0.4
    check_rules(accept(make_ultigcode(), nozzle_mm=None))


def make_spiral(e_per_mm, turn_count=20, layer_mm=0.2):
    """Make a vase without a floor; each mm of its wall takes `e_per_mm` of E."""
    points, radius_mm = 60, 20.0
    moves = [(130.0, 110.0, layer_mm, 0.0)]
    for n in range(turn_count * points):
        angle_rad = math.tau * (n + 1) / points
        x, y = 110 + radius_mm * math.cos(angle_rad), 110 + radius_mm * math.sin(angle_rad)
        moves.append((x, y, layer_mm * (1 + (n + 1) / points), math.tau * radius_mm / points * e_per_mm))
    lines = [";FLAVOR:Marlin", "G28", "M109 S200", "M83", ";LAYER:0", "G0 X130 Y110 Z0.2 F9000"]
    lines += [f"G1 F1800 X{x:.3f} Y{y:.3f} Z{z:.4f} E{e:.5f}" for x, y, z, e in moves[1:]]
    return [*lines, "M104 S0"]


def test_spiral_is_accepted_with_the_limit_on_line_width():
    result = accept(make_spiral(0.4 * 0.2 / FILAMENT_MM2))
    assert result.max_mm[2] == pytest.approx(4.2)
    check_rules(result)
    assert_refused(make_spiral(0.4 * 0.2), "mm3")


def test_fan_and_temperatures_of_the_print_are_kept():
    start = [";FLAVOR:Marlin", "G28", "M109 R200", "M106 S100"]
    lines = extract_body(
        accept(make_marlin(start=start, body=["M104 S195", "M140 S55", "M106 S255", "G4 P500"]))
    )
    assert lines[0] == "M106 S100"
    assert [line for line in lines if line[0] == "M" or line.startswith("G4")] == [
        *("M106 S100", "M104 S195", "M140 S55", "M106 S255", "G4 P500")
    ]


def test_e_is_reset_before_its_resolution_decreases():
    long_layer = [[(50.0, 50.0, 2.0, 0.0)] + [(50.0 + 100 * (n % 2), 50.0, 2.0, 10.0) for n in range(1, 241)]]
    result = accept(make_marlin(long_layer))
    assert "G92 E0" in extract_body(result)
    assert sum(m[3] for m in list_moves(extract_body(result))) == pytest.approx(2400.0, abs=0.01)
    check_rules(result)


def test_times_of_progress_are_measured_and_not_taken_from_the_file():
    lines = [line.replace(";LAYER:1", ";TIME_ELAPSED:99999\n;LAYER:1") for line in make_marlin()]
    program = check_rules(accept([part for line in lines for part in line.split("\n")]))
    assert {mark.layer for mark in program.timeline} == {0, 1, 2}
    assert 8 < program.time_s < 30


def test_slow_layer_has_more_than_one_mark():
    slow_gcode = [line.replace("F1800", "F30") for line in make_marlin()]
    assert len(check_rules(accept(slow_gcode)).timeline) > 6


def test_type_comments_are_kept():
    lines = extract_body(
        accept(make_marlin(body=[";TYPE:WALL-OUTER", ";TYPE:External perimeter", ";MESH:a.stl"]))
    )
    assert [line for line in lines if line.startswith((";TYPE", ";MESH"))] == [";TYPE:WALL-OUTER"]


def test_commands_forbidden_in_a_print_are_allowed_in_an_end_script():
    tail = [
        "M104 S0",
        "M140 S0",
        "G28",
        "M84",
        "M81",
        "M18",
        "G29",
        "G1 E-30 F1500",
        "M82",
        "M104 S0 T1",
        "G92 X0 Y0 E0",
        "G1 X-50 Z400 F0.1",
    ]
    result = accept(make_marlin(tail=tail))
    check_rules(result)
    assert result.reach_min_mm == result.min_mm
    assert accept(make_marlin(tail=["M84", "G1 E90"])).filament_mm == result.filament_mm


def test_omitted_commands_are_reported():
    notices = accept(make_marlin(body=["M204 S500", "M900 K0.1", "M73 P10", "M117 Go: N*"])).notices
    assert notices[-1] == (
        "Left out, because the printer has its own: M204 (acceleration), M900 (linear advance)."
    )


def test_display_text_and_byte_order_mark_are_ignored():
    plain_lines, lines = make_marlin(), make_marlin(body=["M117 Größe (50 %: N5*7", "m118 née"])
    lines[0] = "\ufeff" + lines[0]
    assert extract_body(accept(lines)) == extract_body(accept(plain_lines))


@pytest.mark.parametrize(
    "line",
    [
        "M201 X500",
        "M203 E5",
        "G10 P0 R0",
        "G2 X9 Y9 I1 J1",
        "M205 X8",
        "G29",
        "M420 S1",
        'M862.3 P "MK3"',
        "G80",
        "M200 D0",
        "M200D0.0",
    ],
)
def test_printer_settings_of_a_start_are_left_out(line):
    assert extract_body(accept([";FLAVOR:Marlin", line, *make_marlin()[1:]])) == extract_body(
        accept(make_marlin())
    )
