"""A person's own G-code: what is printed of it, and what is refused."""

import gzip
import itertools
import math
import re
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.filament import retracted_mm
from drivers.gcode import HeaterName, strip
from drivers.profiles import PROFILES
from farm.services.movetime import FirmwareTime
from make_gcode import FILAMENT_MM2, PURGE, Summed, as_bytes, marlin, square, ultigcode
from slicing.errors import GcodeRefused
from slicing.foreign.accept import accept
from slicing.foreign.lines import LONGEST
from slicing.startcode import end_code, start_code

ON_THE_LIST = re.compile(
    rb"(G0|G1|G4|G28|G90|G91|G92|G21|M82|M84|M104|M106|M107|M109|M140|M190|M220 S100|M221 S100)( |\Z)"
)
MOVE = re.compile(rb"G[01] ")


def take(lines, stopwatch=None, end=b"\n", nozzle_mm=0.4):
    return accept(
        [line if isinstance(line, bytes) else line.encode() + end for line in lines],
        stopwatch=stopwatch or Summed(),
        filament_mm2=FILAMENT_MM2,
        nozzle_mm=nozzle_mm,
        nozzle_c=210.0,
        bed_c=65.0,
    )


def body(accepted):
    """What stands between the farm's own start and end."""
    start = start_code(accepted.nozzle_c, accepted.bed_c, FILAMENT_MM2)
    text = accepted.gcode.decode().removeprefix(f";FLAVOR:Marlin\n{start}\n")
    assert text.endswith(f"{end_code(0.0)}\n")
    return text.removesuffix(f"{end_code(0.0)}\n").splitlines()


def followed(lines):
    """Every move of a body as (x, y, z, fed mm), by a reading of its own."""
    at, moves = {"X": 5.0, "Y": 50.0, "Z": 20.0, "E": 0.0}, []
    for line in lines:
        words = {w[0]: float(w[1:]) for w in line.split()[1:] if not line.startswith((";", "M"))}
        if line.startswith("G92"):
            at["E"] = 0.0
        elif line.startswith("G"):
            new = {**at, **{k: v for k, v in words.items() if k != "F"}}
            moves.append((new["X"], new["Y"], new["Z"], new["E"] - at["E"]))
            at = new
    return moves


def fed(moves):
    return [m for m in moves if m[3] > 1e-6]


def refused(lines, said):
    with pytest.raises(GcodeRefused, match=said):
        take(lines)


def safe(accepted):
    """What every program of the farm's keeps."""
    program = strip(accepted.gcode.splitlines())
    assert all(ON_THE_LIST.match(line) for line in program.lines(0, program.count))
    for heater in HeaterName:
        assert program.target_c(heater, program.count) == 0
    assert retracted_mm(program, program.count) == pytest.approx(20.0, abs=1e-3)
    assert program.homes < program.extrudes < program.count
    assert program.time_s == pytest.approx(accepted.print_time_s, abs=1e-3)
    return program


def test_a_marlin_file_keeps_its_print_and_loses_its_start_and_end():
    accepted = take(marlin())
    safe(accepted)
    lines = body(accepted)
    printed = [(x, y, z, e) for layer in square() for x, y, z, e in layer if e]
    assert fed(followed(lines)) == [pytest.approx(move, abs=2e-5) for move in printed]
    assert not any("X5.000" in line for line in lines)  # the purge
    assert (accepted.nozzle_c, accepted.bed_c, accepted.layers) == (205.0, 60.0, 3)
    assert accepted.filament_mm == pytest.approx(240 * 0.08 / FILAMENT_MM2, abs=1e-4)
    assert accepted.min_mm == pytest.approx((100, 100, 0.2))
    assert accepted.max_mm == pytest.approx((120, 120, 0.6))


def test_the_head_comes_to_the_first_point_from_above():
    moves = followed(body(take(marlin())))
    assert [move[2] for move in moves[:2]] == [20.0, pytest.approx(0.2)]
    assert moves[0][:2] == moves[1][:2] == (100.0, 100.0)


def test_where_the_start_left_the_head_does_not_matter():
    """PrusaSlicer raises it, then draws back, before it goes to the first point."""
    lines = marlin(start=["G28", "M109 S200", "G1 X5 Y5 Z0.3 F3000"], relative=True)
    at = lines.index(";LAYER:0") + 1
    lines[at:at] = ["G1 Z0.2", "G1 E-2 F2400"]
    lines.insert(at + 3, "G1 E2")
    accepted = take(lines)
    safe(accepted)
    assert accepted.min_mm == accepted.reach_min_mm == pytest.approx((100, 100, 0.2))
    assert followed(body(accepted))[:4] == [
        (5.0, 50.0, 20.0, -2.0),
        (100.0, 100.0, 20.0, 0.0),
        (100.0, 100.0, 0.2, 0.0),
        (100.0, 100.0, 0.2, 2.0),
    ]


def test_ultigcode_is_converted_to_mm_with_retractions_of_its_own():
    accepted = take(ultigcode())
    safe(accepted)
    assert (accepted.nozzle_mm, accepted.nozzle_c, accepted.bed_c) == (0.4, 210.0, 65.0)
    moves = followed(body(accepted))
    assert accepted.filament_mm == pytest.approx(240 * 0.08 / FILAMENT_MM2, abs=1e-4)
    assert [m[3] for m in moves if m[3] < 0] == [pytest.approx(-6.5, abs=1e-4)] * 3
    assert sum(m[3] for m in moves) == pytest.approx(accepted.filament_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("slicer", "filament_mm", "seconds"),
    [("prusaslicer", 19.61, 78), ("slic3r", 20.04, None), ("ultigcode", 246 / FILAMENT_MM2, 104.9)],
)
def test_what_slicers_write_takes_the_filament_and_the_time_that_they_say(slicer, filament_mm, seconds):
    """Recorded on Debian 12: a tile of 10 x 10 x 1 mm by PrusaSlicer 2.5.0, Slic3r 1.3.0, CuraEngine 4.13."""
    recorded = Path(__file__).parent / "fixtures" / f"tile-{slicer}.gcode.gz"
    accepted = take(
        gzip.decompress(recorded.read_bytes()).splitlines(), FirmwareTime(PROFILES["ultimaker2_plus"])
    )
    safe(accepted)
    assert (accepted.nozzle_mm, accepted.layers) == (0.4, 5)
    assert accepted.filament_mm == pytest.approx(filament_mm, rel=0.003)
    assert accepted.print_time_s == pytest.approx(seconds or accepted.print_time_s, rel=0.06)


def rewritten(lines, how):
    match how:
        case "lower case":
            return [line if line.startswith(";") else line.lower() for line in lines]
        case "numbered":
            plain = [f"N{n} {line}" for n, line in enumerate(line for line in lines if line[0] != ";")]
            plain = [f"{line}*{xor(line)}" for line in plain]
            return [line if line[0] == ";" else plain.pop(0) for line in lines]
        case "commented":
            return [f"{line} ; and (so) on" if line[0] != ";" else line for line in lines]
        case "aside":
            return [line.replace(" ", " (so) ", 1) if line[0] != ";" else line for line in lines]
        case "indented":
            return [f"\t {line}  " if line[0] != ";" else line for line in lines]
    return lines


def xor(line):
    value = 0
    for byte in line.encode():
        value ^= byte
    return value


@pytest.mark.parametrize("how", ["lower case", "numbered", "commented", "aside", "indented"])
def test_it_does_not_matter_how_a_line_is_written(how):
    assert body(take(rewritten(marlin(), how))) == body(take(marlin()))
    assert body(take(rewritten(marlin(), how), end=b"\r\n")) == body(take(marlin()))


@st.composite
def prints(draw):
    """Layers of moves on the bed, each line of a plausible width."""
    layers = []
    for number in range(draw(st.integers(1, 4))):
        z = 0.2 * (number + 1)
        points = draw(st.lists(st.tuples(*[st.integers(20, 200)] * 2), min_size=2, max_size=6, unique=True))
        moves = [(*map(float, points[0]), z, 0.0)]
        for (ax, ay), (bx, by) in itertools.pairwise(points):
            way_mm = ((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5
            moves.append((float(bx), float(by), z, round(way_mm * 0.0125, 5)))
        layers.append(moves)
    return layers


@given(prints())
@settings(max_examples=40, deadline=None)
def test_the_same_print_in_every_dialect_is_the_same_print(layers):
    wanted = [move for layer in layers for move in layer if move[3]]
    no_comments = marlin(layers, comments=False)
    for lines in (marlin(layers), marlin(layers, relative=True), ultigcode(layers), no_comments):
        accepted = take(lines)
        safe(accepted)
        moves = followed(body(accepted))
        printed = [m for m, before in zip(moves[1:], moves, strict=False) if m[3] > 0 and m[:3] != before[:3]]
        assert printed == [pytest.approx(move, abs=5e-5) for move in wanted]
        assert accepted.layers == len(layers)


def test_relative_moves_become_absolute():
    there = ["G91", "G1 X10 E0.12 F1800", "G1 Y10 E0.12", "G90", "G92 E0.5019"]
    lines = marlin(square(layers=1), tail=[*there, "M104 S0"])
    assert [m[:2] for m in fed(followed(body(take(lines))))[-2:]] == [(110.0, 100.0), (110.0, 110.0)]


def test_a_low_move_counts_as_a_printed_one_where_clips_are():
    low, high = take(marlin(body=["G0 X1 Y2 Z0.5"])), take(marlin(body=["G0 Z12", "G0 X1 Y2"]))
    assert low.min_mm == pytest.approx((1, 2, 0.2))
    assert high.min_mm == pytest.approx((100, 100, 0.2))
    assert low.reach_min_mm[:2] == high.reach_min_mm[:2] == (1, 2)


def test_factors_of_speed_and_flow_are_multiplied_out():
    whole, half = take(marlin()), take(marlin(body=["M221 S50", "M220 S200"]))
    assert half.filament_mm == pytest.approx(whole.filament_mm * (1 + 0.5 + 0.5) / 3, rel=1e-4)
    assert "G1 F3600 X120.000" in "\n".join(body(half))


def test_an_arc_becomes_straight_moves_on_its_circle():
    arc = ["G3 F1800 X100 Y140 I0 J20 E0.8", "M104 S0"]
    moves = fed(followed(body(take(marlin([square(layers=1)[0][:1]], tail=arc)))))
    assert len(moves) > 50
    assert all(abs(((x - 100) ** 2 + (y - 120) ** 2) ** 0.5 - 20) < 2e-3 for x, y, _, _ in moves)
    assert max(x for x, *_ in moves) == pytest.approx(120, abs=0.02)
    assert sum(m[3] for m in moves) == pytest.approx(0.8, abs=1e-4)


def test_what_a_start_has_drawn_back_is_drawn_back_before_the_first_layer():
    start = [";FLAVOR:Marlin", "G28", "M109 S200", *PURGE, "G92 E0", "G1 E-4 F1500"]
    lines = marlin(start=start, relative=True)
    lines.insert(lines.index(";LAYER:0") + 2, "G1 E4 F1500")
    moves = followed(body(take(lines)))
    assert moves[0] == (5.0, 50.0, 20.0, pytest.approx(-4.0))
    assert [m[3] for m in moves if m[3]][1] == pytest.approx(4.0)


@pytest.mark.parametrize("tail", [[], ["G1 E0 F1500"]])
def test_a_start_that_draws_the_filament_out_of_the_hot_end_is_refused(tail):
    start = [";FLAVOR:Marlin", "G28", "M109 S200", "G92 E0", "G1 E-60 F1500", "M82", "G92 E-60"]
    lines = marlin(start=start)
    at = lines.index(";LAYER:0")
    refused([*lines[: at - 2], ";LAYER:0", *tail, *lines[at + 1 :]], "60.0 mm back, out of the hot end")


@pytest.mark.parametrize(("z", "said"), [("-3", "to Z -3, into the bed"), ("0", "at Z 0: .* above the bed")])
def test_a_start_that_leaves_the_head_in_the_bed_is_refused(z, said):
    tail = [f"G1 X100 Y100 Z{z}", ";LAYER:0", "G1 F1800 X120 Z0.2 E0.25", "G1 X140 E0.5"]
    refused(marlin([], tail=tail), said)


def test_a_file_says_its_nozzle_where_there_are_several():
    with pytest.raises(GcodeRefused, match=r"nozzle_diameter = 0\.4"):
        take(marlin(), nozzle_mm=None)
    assert take(["; nozzle_diameter = 0.4", *marlin()], nozzle_mm=None).nozzle_mm == 0.4
    safe(take(ultigcode(), nozzle_mm=None))


def spiral(section_mm, turns=20, layer_mm=0.2):
    """A vase without a floor: `section_mm` of E on each mm of its wall."""
    points, radius_mm = 60, 20.0
    moves = [(130.0, 110.0, layer_mm, 0.0)]
    for n in range(turns * points):
        angle = math.tau * (n + 1) / points
        x, y = 110 + radius_mm * math.cos(angle), 110 + radius_mm * math.sin(angle)
        moves.append((x, y, layer_mm * (1 + (n + 1) / points), math.tau * radius_mm / points * section_mm))
    lines = [";FLAVOR:Marlin", "G28", "M109 S200", "M83", ";LAYER:0", "G0 X130 Y110 Z0.2 F9000"]
    return lines + [f"G1 F1800 X{x:.3f} Y{y:.3f} Z{z:.4f} E{e:.5f}" for x, y, z, e in moves[1:]]


def test_a_spiral_is_printed_and_its_e_is_held_to_a_lines_width_too():
    accepted = take(spiral(0.4 * 0.2 / FILAMENT_MM2))
    assert accepted.max_mm[2] == pytest.approx(4.2)
    safe(accepted)
    refused(spiral(0.4 * 0.2), "mm3")


def test_objects_one_after_the_other_are_printed_only_as_high_as_the_head_clears_them():
    def two(layers):
        more = square(at_mm=140.0, layers=2)
        return marlin([*square(layers=layers), *more])

    safe(take(two(layers=50)))
    refused(two(layers=53), "Z 0.2 beside what is 10.6 mm high.*Print Sequence")


def test_fan_and_temperatures_of_the_print_are_kept():
    start = [";FLAVOR:Marlin", "G28", "M109 R200", "M106 S100"]
    lines = body(take(marlin(start=start, body=["M104 S195", "M140 S55", "M106 S255", "G4 P500"])))
    assert lines[0] == "M106 S100"
    assert [line for line in lines if line[0] == "M" or line.startswith("G4")] == [
        *("M106 S100", "M104 S195", "M140 S55", "M106 S255", "G4 P500")
    ]


def test_e_starts_anew_before_its_steps_get_coarse():
    long = [[(50.0, 50.0, 5.0, 0.0)] + [(50.0 + 100 * (n % 2), 50.0, 5.0, 60.0) for n in range(1, 41)]]
    accepted = take(marlin(long))
    assert "G92 E0" in body(accepted)
    assert sum(m[3] for m in followed(body(accepted))) == pytest.approx(2400.0, abs=0.01)
    safe(accepted)


def test_progress_has_marks_from_the_stopwatch_not_from_the_file():
    lines = [line.replace(";LAYER:1", ";TIME_ELAPSED:99999\n;LAYER:1") for line in marlin()]
    program = safe(take([part for line in lines for part in line.split("\n")]))
    assert {mark.layer for mark in program.timeline} == {0, 1, 2}
    assert 8 < program.time_s < 30


def test_a_slow_layer_has_more_than_one_mark():
    slow = [line.replace("F1800", "F30") for line in marlin()]
    assert len(safe(take(slow)).timeline) > 6


def test_what_a_line_prints_is_kept_where_the_file_says_it():
    lines = body(take(marlin(body=[";TYPE:WALL-OUTER", ";TYPE:External perimeter", ";MESH:a.stl"])))
    assert [line for line in lines if line.startswith((";TYPE", ";MESH"))] == [";TYPE:WALL-OUTER"]


def test_an_end_script_may_do_what_a_print_must_not():
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
    accepted = take(marlin(tail=tail))
    safe(accepted)
    assert accepted.reach_min_mm == accepted.min_mm
    assert take(marlin(tail=["G1 E90"])).filament_mm == accepted.filament_mm


def test_what_is_left_out_is_said():
    notices = take(marlin(body=["M204 S500", "M900 K0.1", "M73 P10", "M117 Go: N*"])).notices
    assert notices[-1] == "Left out, for the printer has its own: M204 (acceleration), M900 (linear advance)."


@pytest.mark.parametrize(
    ("line", "said"),
    [
        *((f"M{n}", rf"line \d+: M{n} ") for n in (0, 1, 226, 600, 601, 20, 23, 24, 28, 30, 92, 112, 200)),
        *((f"M{n} P1", rf"line \d+: M{n} .*take it out") for n in (301, 302, 303, 500, 501, 502, 999)),
        *((f"M{n} X1", rf"line \d+: M{n} ") for n in (92, 201, 203, 206)),
        ("G20", "millimetres"),
        ("T1", "single extruder"),
        ("G28", "homes in the middle"),
        ("G29", "not on the list"),
        ("M84", "motors"),
        ("M42 P3", "not on the list"),
        ("G5 X1", "not on the list"),
        ("G92 X0", "E anew"),
        ("G92 X0 E0", "E anew"),
        ("G92", "E anew"),
        ("M104 S0", "cold .0 C. and the print goes on"),
        ("M109 S150", "cold"),
        ("M104 S261", "at most 260"),
        ("M104 S-5", "at most 260"),
        ("M104", "no temperature"),
        ("M104 S200 T1", "single extruder"),
        ("M140 S0", "bed off"),
        ("M140 S0.3", "bed off"),
        ("M140 S116", "at most 115"),
        ("M220", "needs S10 to S500"),
        ("M221 S0", "needs S10 to S300"),
        ("G4 S3600", "waits 3600 s"),
        ("G1 X10 E900", "pushes 899 mm"),
        ("G1 F1500 E-30", "out of the hot end"),
        ("G1 F1 X10", "for ever"),
        ("G1 Z-1", "into the bed"),
        ("G1 X1e9", "damaged|blank"),
        ("G1 X1000000000", "more than any printer"),
        ("G1 Xnan", "cannot be read|twice"),
        ("G1 Xinf", "cannot be read|damaged"),
        ("G1 X1E5", "a blank before each E"),
        ("G1 X1 X2", "twice"),
        ("G1 X--1", "cannot be read"),
        ("G1 X1 : M112", "cannot be read"),
        ("G2 X10 Y10 R5", "I and J"),
        ("G2 X10 Y10 I1 J1", "no printer can make this arc"),
        ("G2 X100 Y100 I5000 J0", "no printer can make this arc"),
        ("N5 G1 X10*1", "checksum"),
        ("G1 X10*33", "cannot be read"),
        ("G1 X Y10", "cannot be read"),
        ("START_PRINT BED=60", "no command"),
        ("hello", "no command"),
        ("G1.5 X1", "not on the list"),
        ("M117\0", "plain text"),
        ("G1 X1 \x07", "plain text"),
        ("G1 Xé", "plain text"),
        ("M200", "mm3"),
        ("M200 D1.75", "mm3"),
        (";" + "x" * LONGEST, "longer than"),
        ("(open", "no command"),
    ],
)
def test_what_a_print_must_not_hold_is_refused_by_line(line, said):
    refused(marlin(body=[line]), said)


def test_a_text_for_the_display_and_a_byte_order_mark_mean_nothing():
    plain, lines = marlin(), marlin(body=["M117 Größe (50 %: N5*7", "m118 née"])
    lines[0] = "\ufeff" + lines[0]
    assert body(take(lines)) == body(take(plain))


@pytest.mark.parametrize(
    "line",
    ["M500", "M92 E400", "M302 P1", "M0", "T1", "G20", "M206 X5", "M200 D2.85", "G92 Z0", "M104 S200 T1"],
)
def test_what_gives_a_file_another_meaning_is_refused_in_its_start_too(line):
    refused([";FLAVOR:Marlin", line, *marlin()[1:]], f"line 2: {line.split()[0]} ")


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
def test_what_a_start_does_to_the_printer_is_left_out(line):
    assert body(take([";FLAVOR:Marlin", line, *marlin()[1:]])) == body(take(marlin()))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "where its print begins"),
        ([";FLAVOR:Griffin", *marlin()[1:]], "flavour is 'Griffin'.*Marlin"),
        ([";FLAVOR:Marlin(Volumetric)", *marlin()[1:]], "Marlin"),
        (["; filament_diameter = 1.75", *marlin()], "1.75 mm"),
        (["; use_volumetric_e = 1", *marlin()], "Use volumetric E"),
        (["G28", "G1 X10 Y10 Z0.2 E1"], "where its print begins"),
        (["G28", "M109 S200"], "prints nothing"),
        ([";LAYER:0", "G28", "M109 S200"], "nozzle's temperature"),
        (marlin(start=["G28", "M190 S60"]), "nozzle's temperature"),
        (marlin([], start=["G28", "M109 S200"], tail=[]), "prints nothing"),
        (marlin([[(100.0, 100.0, 0.0, 0.0), (120.0, 100.0, 0.0, 0.25)]]), "above the bed"),
        ([*marlin(start=["G28", "M109 S200"])[:5], "G1 X10 E1", "M104 S0"], "has said where"),
        (marlin(square(e_per_mm=0.4 * 0.2)), "mm3"),
        (marlin(square(e_per_mm=0.4 * 0.2 / 2.405)), "diameter"),
        (ultigcode(square(e_per_mm=0.4 * 0.2 / FILAMENT_MM2**2)), "mm3"),
        ([line for line in ultigcode() if "LAYER" not in line], "where its print begins"),
    ],
)
def test_a_file_that_means_something_else_is_refused(lines, said):
    refused(lines, said)


LINES = st.one_of(
    st.sampled_from(
        as_bytes([*marlin(), *ultigcode(), "G91", "G90", "M83", "G10", "G11", "M221 S95", "G4 P9"])
    ),
    st.sampled_from(
        as_bytes(["G1 Z-3", "G1 Z0", "G1 E-60", "G1 E-6", "G1 X5 Y5 Z0.3", "G92 E0", "G1 E30", ";LAYER:0"])
    ),
    st.from_regex(rb"[GMTN][0-9]{1,3}( [XYZEFSPIJRT]-?[0-9]{1,5}(\.[0-9]{0,3})?){0,4}\n", fullmatch=True),
    st.binary(max_size=30),
)


@given(st.lists(LINES, max_size=12), st.lists(LINES, max_size=12), st.sampled_from([marlin, ultigcode]))
@example([], [b"G91\n", b"G1 E-1 X3 Z1\n"], marlin)
@example([b";LAYER:0\n"], [], ultigcode)
@settings(max_examples=300, deadline=None)
def test_whatever_a_file_holds_it_is_refused_or_safe(before, inside, dialect):
    good = as_bytes(dialect())
    middle = len(good) - 8
    try:
        accepted = take([*before, *good[:middle], *inside, *good[middle:]])
    except GcodeRefused as error:
        assert "\n" not in str(error)
    else:
        safe(accepted)
        assert accepted.min_mm[2] > 0
        back_mm = 0.0
        for x, y, z, e in followed(body(accepted)):
            assert z >= 0
            back_mm = max(0.0, back_mm - e)
            assert back_mm <= 20.5 + 1e-4
            if z < 10:
                inside = zip(accepted.min_mm[:2], (x, y), accepted.max_mm[:2], strict=True)
                assert all(low - 1e-3 <= value <= high + 1e-3 for low, value, high in inside)
        assert back_mm == pytest.approx(0.0, abs=1e-4)
