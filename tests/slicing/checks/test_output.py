"""Facts that are read from a G-code file, and violations of each rule."""

import pickle

import pytest

from slicing.checks import read_toolpath
from slicing.checks.output import (
    check_bed,
    check_end_retraction,
    check_facts,
    check_log,
    count_removed_layers,
    gather_facts,
    replace_header,
)
from slicing.errors import OutsideBed, Rule, SliceRejected

VALID_GCODE = b""";FLAVOR:Marlin
;Generated with Cura_SteamEngine 4.13.0
M82 ;absolute extrusion mode
G28
M190 S60
M109 S200
G92 E0
G1 F47 E7.8
G92 E0
;LAYER_COUNT:2
;LAYER:0
G0 F4500 X100 Y100 Z0.27
;TYPE:WALL-OUTER
G1 F1800 X120 Y100 E1.5
G1 X120 Y110 E2
;TIME_ELAPSED:10.5
;LAYER:1
G0 X100 Z0.42
G1 X100 Y90 E3
;TIME_ELAPSED:21.25
G1 F1500 E-3.5
M104 S0
M140 S0
G91
G1 F1500 E-13.5
G90
G28
;End of Gcode
"""
BED = ((-20.0, -25.0, 20.0, 25.0, 205.0),)


def check_gcode(gcode, *, height_mm=0.4, removed_mm=0.0, is_top_checked=True, bed=BED):
    facts = gather_facts(read_toolpath(gcode), 170.0)
    check_facts(
        facts,
        height_mm=height_mm,
        removed_mm=removed_mm,
        is_top_checked=is_top_checked,
        layer_height_mm=0.27,
        min_extrusion_c=170.0,
    )
    check_bed(facts, (111.5, 111.5), bed, 0.14)
    check_end_retraction(facts, 20.0)
    return facts


def test_facts_are_read_from_a_valid_file():
    facts = check_gcode(VALID_GCODE)
    assert facts.sliced_s == 21.25
    assert facts.filament_mm == pytest.approx(3.0)  # without priming and retraction
    assert (facts.planned_layer_count, facts.layers, facts.top_layer) == (2, 2, 1)
    assert facts.min_mm == (100.0, 90.0, 0.27)
    assert facts.max_mm == (120.0, 110.0, 0.42)
    assert facts.park_retraction_mm == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("rule", "old_text", "new_text"),
    [
        (Rule.FLAVOUR, ";FLAVOR:Marlin", ";FLAVOR:UltiGCode"),
        (Rule.FLAVOUR, "G1 F1500 E-3.5", "G1 F1500 E-3.5\nG10"),
        (Rule.HOMING, "M82 ;absolute extrusion mode\nG28", "M82\nG1 X5\nG28"),
        (Rule.COLD_EXTRUSION, "M109 S200", "M104 S200"),
        (Rule.COLD_EXTRUSION, "M109 S200", "M109 S160"),
        (Rule.HEATERS_ON, "M140 S0", "M107"),
        (Rule.HEATERS_ON, ";End of Gcode", "M104 S30"),
        (Rule.PARKING, "E-13.5", "E-1"),
        (Rule.LAYERS, "G1 F1800 X120 Y100 E1.5\nG1 X120 Y110 E2", "G92 E2"),
        (Rule.LAYERS, ";LAYER_COUNT:2", ";LAYER_COUNT:1"),
        (Rule.OUTSIDE_BED, "X120 Y100", "X133 Y100"),
        (Rule.OUTSIDE_BED, "X100 Y90", "X100 Y-90"),
    ],
)
def test_each_rule_refuses_a_violation(rule, old_text, new_text):
    assert old_text.encode() in VALID_GCODE
    with pytest.raises(SliceRejected) as error:
        check_gcode(VALID_GCODE.replace(old_text.encode(), new_text.encode()))
    assert error.value.rule is rule
    assert "\n" not in str(error.value)
    assert "; " in str(error.value)  # separates the finding from the action


def test_file_without_extrusion_is_refused():
    start, _, gcode_end = VALID_GCODE.partition(b";LAYER_COUNT")
    end = gcode_end.partition(b"G1 F1500 E-3.5")[2]
    with pytest.raises(SliceRejected) as error:
        check_gcode(start + end)
    assert error.value.rule is Rule.NOTHING_PRINTED


@pytest.mark.parametrize(
    ("height_mm", "removed_mm", "is_top_checked", "is_valid"),
    [
        (0.3, 0.0, True, True),
        (0.2, 0.0, True, False),
        (1.3, 0.0, False, True),
        (9.0, 0.0, False, False),
        (9.0, 0.0, True, True),
        (0.8, 0.4, True, True),
        (0.6, 0.4, True, False),
        (2.5, 2.0, True, False),
    ],
)
def test_wrong_height_is_refused(height_mm, removed_mm, is_top_checked, is_valid):
    if is_valid:
        check_gcode(VALID_GCODE, height_mm=height_mm, removed_mm=removed_mm, is_top_checked=is_top_checked)
        return
    with pytest.raises(SliceRejected) as error:
        check_gcode(VALID_GCODE, height_mm=height_mm, removed_mm=removed_mm, is_top_checked=is_top_checked)
    assert error.value.rule is Rule.HEIGHT


def test_one_rectangle_of_the_bed_must_contain_the_print():
    left_box, right_box = (-20.0, -25.0, 0.0, 25.0, 205.0), (0.0, -25.0, 20.0, 25.0, 205.0)
    with pytest.raises(SliceRejected, match="build volume"):
        check_gcode(VALID_GCODE, bed=(left_box, right_box))
    check_gcode(VALID_GCODE, bed=(left_box, right_box, *BED))
    with pytest.raises(SliceRejected, match="build volume"):
        check_gcode(VALID_GCODE, bed=((-20.0, -25.0, 20.0, 25.0, 0.1),))


@pytest.mark.parametrize(
    "line", ["[WARNING] Mesh has disconnected faces!", "[WARNING] Face count reported: 1"]
)
def test_warnings_of_an_incomplete_mesh_refuse_the_slice(line):
    with pytest.raises(SliceRejected) as error:
        check_log(f"Starting slice...\n{line}\nPrint time (s): 3\n")
    assert error.value.rule is Rule.BROKEN_MESH
    check_log("Starting slice...\nPrint time (s): 3\n")


def test_header_from_the_log_replaces_the_placeholder():
    log = (
        "x\nGcode header after slicing:\n;FLAVOR:Marlin\n;TIME:21\n;Filament used: 0.9m\n;MAXZ:12.4\n"
        "End of gcode header.\nPrint time (s): 21\n"
    )
    gcode = replace_header(VALID_GCODE, log, 19.9, filament_mm=812.5, height_mm=12.3456)
    assert gcode.startswith(b";FLAVOR:Marlin\n;TIME:19\n;Filament used: 0.8125m\n;MAXZ:12.346\n\n;Generated")
    assert gcode.partition(b"M82")[2] == VALID_GCODE.partition(b"M82")[2]
    assert replace_header(VALID_GCODE, "no header here", 19.9) == VALID_GCODE


def test_number_of_removed_layers_is_read_from_the_log():
    assert count_removed_layers("Starting\nRemoving 2 layers because they are empty\nLayer count: 9\n") == 2
    assert count_removed_layers("Layer count: 9\n") == 0


def test_rejection_can_be_sent_between_processes():
    rejection = pickle.loads(pickle.dumps(SliceRejected(Rule.COLD_EXTRUSION, "too cold")))
    assert rejection.rule == Rule.COLD_EXTRUSION
    assert str(rejection) == "the slice was rejected (cold extrusion): too cold"


@pytest.mark.parametrize(
    ("low_mm", "high_mm", "height_mm", "shift_mm"),
    [
        ((-21.0, -10.0), (15.0, 10.0), 50.0, (1.0, 0.0)),
        ((-15.0, -10.0), (20.5, 26.0), 50.0, (-0.5, -1.0)),
        ((-21.0, -10.0), (20.0, 10.0), 50.0, None),
        ((-21.0, -10.0), (15.0, 10.0), 206.0, None),
        ((-30.0, -10.0), (0.0, 10.0), 9.0, (5.0, 0.0)),  # the lower, wider box is nearer
    ],
)
def test_shift_moves_a_print_onto_the_nearest_part_of_the_bed(low_mm, high_mm, height_mm, shift_mm):
    error = OutsideBed("it prints outside", low_mm, high_mm, height_mm)
    bed = (*BED, (-25.0, -20.0, 10.0, 20.0, 10.0))
    assert error.find_shift(bed) == shift_mm
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.rule, copy.find_shift(bed)) == (str(error), Rule.OUTSIDE_BED, shift_mm)
