"""Clearance of the head over printed lines."""

import json
import subprocess

import pytest
import trimesh

from model_files.make_gcode import join_objects, make_marlin, make_square
from model_files.make_stl import write_stl_bytes
from model_files.own_gcode import accept, assert_refused, check_rules
from printers.slicing_printers import UM2_PLUS
from slicing.engine import EngineLimits, run_engine
from slicing.own_gcode.clearance import Clearance

translate = trimesh.transformations.translation_matrix
TOWER = make_square(layers=90)


@pytest.mark.parametrize(
    ("moves", "colliding_move"),
    [
        (["G0 X90 Y110 Z20", "G0 Z0.3", "G0 X130"], 2),  # through the middle of the tower
        (["G0 X90 Y110 Z30", "G0 X130 Z0.3"], 2),  # along a slanted line
        (["G0 X90 Y110 Z20", "G0 X130"], None),  # above the tower
        # into a hollow tower, by less than the length of the nozzle
        (
            ["G0 Z25", "G0 X110 Y110", "G0 Z14", "G0 Z25"],
            None,
        ),
        (["G0 Z25", "G0 X60 Y110", "G0 Z5"], 3),  # beside the tower: the head extends 64 mm on this side
        (["G0 Z25", "G0 X190 Y190", "G0 Z5", "G0 Z25"], None),  # further away than the width of the head
    ],
)
def test_move_through_printed_lines_is_refused(moves, colliding_move):
    lines = make_marlin(TOWER)
    index = lines.index(";LAYER:89") + 1
    lines[index:index] = moves
    if colliding_move:
        assert_refused(
            lines, rf"line {index + colliding_move}: moves at Z .* into parts printed up to Z 17.8"
        )
    else:
        check_rules(accept(lines))


def test_extent_of_the_head_matches_the_definition_of_cura():
    clearance = Clearance(slack_mm=0.4, head=UM2_PLUS.head)
    clearance.add_line([100.0, 100.0, 9.0], [100.5, 100.0, 9.0])

    def collides_at(x, y, z=3.0):
        return clearance.find_obstacle_height_mm([x, y, z], [x, y, z]) is not None

    assert collides_at(100, 100, 8.0) and not collides_at(100, 100, 8.7)
    assert collides_at(102, 100) and not collides_at(102, 100, 4.0)
    # the head covers 44 mm left of the nozzle, 64 mm right, 34 mm in front and 14 mm behind
    assert [collides_at(*position_mm) for position_mm in ((143, 100), (146, 100), (37, 100), (34, 100))] == [
        True,
        False,
        True,
        False,
    ]
    assert [collides_at(*position_mm) for position_mm in ((100, 133), (100, 136), (100, 87), (100, 84))] == [
        True,
        False,
        True,
        False,
    ]


def test_sequential_objects_need_the_width_of_the_head_between_them():
    def make_two_towers(at_mm, layers):
        return make_marlin(join_objects(make_square(layers=layers), make_square(at_mm=at_mm, layers=2)))

    check_rules(accept(make_two_towers(170.0, layers=45)))
    check_rules(accept(make_two_towers(135.0, layers=25)))  # objects of 5 mm stay below the head
    assert_refused(make_two_towers(135.0, layers=45), r"Z 0\.2 into parts printed up to Z 9")


def test_later_lines_are_obstacles_too():
    """Let the third object collide with the second one, which was still low at the first travel over it."""
    first_object, second_object, third_object = (
        make_square(layers=40),
        make_square(at_mm=20.0, layers=40),
        make_square(at_mm=50.0, layers=1),
    )
    assert_refused(
        make_marlin(join_objects(join_objects(first_object, second_object), third_object)),
        r"Z 0\.2 into parts printed up to Z 8",
    )


def test_total_pause_time_is_limited():
    def add_pauses(seconds, layers):
        lines = make_marlin(make_square(layers=layers))
        for number in range(layers):
            index = lines.index(f";LAYER:{number}") + 2
            lines[index:index] = [f"G4 S{seconds}"]
        return lines

    check_rules(accept(add_pauses(30, 100)))
    assert_refused(add_pauses(40, 100), r"pauses of G4 add up to 3640 s; the limit is 3600 s")
    assert_refused(
        make_marlin(body=["G4 S50", "G0 X99", "G4 P20000"]), r"waits 70 s in one place; the limit is 60 s"
    )


MODELS = {
    "towers": trimesh.util.concatenate(
        [
            trimesh.creation.box((12, 12, 12), translate((0, 0, 6))),
            trimesh.creation.cone(6, 8, transform=translate((25, 0, 0))),
        ]
    ),
    "spire": trimesh.creation.cone(1.5, 20),
    "bridge": trimesh.boolean.union(
        [
            trimesh.creation.box((8, 8, 8), translate((0, 0, 4))),
            trimesh.creation.box((24, 8, 2), translate((0, 0, 9))),
        ]
    ),
}
STYLES = {
    "brim": {"adhesion_type": "brim"},
    "raft": {"adhesion_type": "raft"},
    "no combing, hops": {"retraction_combing": "off", "retraction_hop_enabled": "True"},
    "vase": {"magic_spiralize": "True"},
    "supports": {"support_enable": "True"},
    "adaptive layers": {"adaptive_layer_height_enabled": "True"},
    "prime blob": {"prime_blob_enable": "True"},
    "lifted head": {"cool_lift_head": "True", "cool_min_layer_time": "15", "cool_min_speed": "20"},
    "thick infill": {"infill_sparse_thickness": "0.4"},
    "relative E": {"relative_extrusion": "True"},
    "retraction by the firmware": {"machine_firmware_retract": "True"},
}


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("model", MODELS)
def test_output_of_cura_is_accepted(model, style, engine, make_settings, tmp_path):
    stl, settings_by_scope = tmp_path / "model.stl", make_settings()
    stl.write_bytes(write_stl_bytes(MODELS[model]))
    stacks = [
        {**settings, **STYLES[style]} for settings in (settings_by_scope.global_, settings_by_scope.extruder)
    ]
    result = run_engine(engine, stl, *stacks, EngineLimits(200, 60.0))
    check_rules(accept(result.gcode.splitlines(keepends=True)))


@pytest.mark.parametrize(("distance_mm", "is_accepted"), [(150.0, True), (25.0, False)])
def test_one_at_a_time_output_is_accepted_with_clearance_for_the_head(
    distance_mm, is_accepted, engine, make_settings, tmp_path
):
    """Add the bed's centre to the first object, because the engine adds it only to the later ones."""
    settings_by_scope = make_settings()
    for scope, values in (("global", settings_by_scope.global_), ("extruder", settings_by_scope.extruder)):
        settings = {**values, "print_sequence": "one_at_a_time"}
        entries = {key: {"default_value": value} for key, value in settings.items()}
        (tmp_path / f"{scope}.json").write_text(json.dumps({"settings": entries}))
    for name, x, centre_mm in (("a", -distance_mm / 2, 111.5), ("b", distance_mm / 2, 0.0)):
        post = trimesh.creation.cylinder(5, 8, transform=translate((centre_mm + x, centre_mm, 4)))
        (tmp_path / f"{name}.stl").write_bytes(post.export(file_type="stl"))
    command = [engine, "slice", "-j", "global.json", "-e0", "-j", "extruder.json", "-o", "out.gcode"]
    command += ["-l", "a.stl", "--next", "-l", "b.stl"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    lines = (tmp_path / "out.gcode").read_bytes().splitlines(keepends=True)
    assert sum(line.startswith(b";LAYER:0") for line in lines) == 2
    if is_accepted:
        check_rules(accept(lines))
    else:
        assert_refused(lines, r"Z 0\.27 into parts printed up to Z 8")
