"""Slicing of a part: placement, shrinkage and height, with real slices."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh

from drivers.printers import PROFILES, Rect, UsableVolume, list_usable_volumes
from farm.config import PrinterSection
from farm.errors import FarmError
from farm.model import PartPrintOptions
from farm.planning.part_records import SliceTask
from farm.planning.parts.slice_part import (
    find_support_angle_deg,
    place_hidden_recesses,
    place_hidden_sides,
    slice_part,
)
from farm.planning.printer_settings import find_usable_volumes, list_max_part_sizes_mm
from printers.slicing_printers import PRINTERS
from slicing.glued_parts import TRANSITION_MM
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings

PRINTER_MODEL = "ultimaker2_plus"


@pytest.fixture
def make_task(tmp_path):
    def make(mesh, *, material="generic_pla", quality="glue", **options):
        stl = tmp_path / "part.stl"
        mesh.export(stl)
        request = SettingsRequest(PRINTERS[PRINTER_MODEL], quality, material)
        resources = find_resources()
        settings = resolve_settings(request, resources)
        return SliceTask(
            part_name="p1",
            stl=stl,
            request=request,
            resources=resources,
            settings=settings,
            usable_volumes=list_usable_volumes(PROFILES[PRINTER_MODEL], settings.brim_width_mm),
            engine=find_engine(),
            out=tmp_path / "part.gcode",
            cache=None,
            print_options=PartPrintOptions(**options),
        )

    return make


def test_abs_is_enlarged_by_its_shrinkage(make_task):
    cube = trimesh.creation.box((100.0, 100.0, 100.0))
    for material, scale_xy, scale_z in (("generic_abs", 1.007, 1.0035), ("generic_pla", 1.002, 1.001)):
        task = make_task(cube, material=material, brim_width_mm=0.0)
        plate = slice_part(task)
        # The nozzle's centre stays half a nozzle inside the outline; Cura 5 makes parts slightly narrower.
        side_mm = 100 * scale_xy - 0.4 + 2 * float(task.settings.extruder["xy_offset"])
        assert plate.max_mm[0] - plate.min_mm[0] == pytest.approx(side_mm, abs=0.01)
        assert plate.max_mm[1] - plate.min_mm[1] == pytest.approx(side_mm, abs=0.01)
        assert plate.height_mm == pytest.approx(100 * scale_z, abs=0.02)


def test_part_has_its_own_brim_first_layer_and_height(make_task):
    # The first layer can be measured only in a part that has no other layer.
    flat_box = trimesh.creation.box((40.0, 30.0, 0.27))
    plain_slice, narrow_slice = (
        slice_part(make_task(flat_box, quality="fast", brim_width_mm=0.0, layer_0_expansion_mm=offset))
        for offset in (None, -0.2)
    )
    assert plain_slice.layers == narrow_slice.layers == 1
    shrinkage_mm = (plain_slice.max_mm[0] - plain_slice.min_mm[0]) - (
        narrow_slice.max_mm[0] - narrow_slice.min_mm[0]
    )
    assert shrinkage_mm == pytest.approx(0.4, abs=0.01)
    tall_box = trimesh.creation.box((12.0, 12.0, 33.33))
    brim_slice = slice_part(make_task(tall_box, brim_width_mm=3.0))
    assert brim_slice.max_mm[0] == pytest.approx(12 * 1.002 / 2 + 9 * 0.35 - 0.175, abs=0.05)
    assert brim_slice.height_mm == pytest.approx(33.33 * 1.001, abs=0.02)


@pytest.mark.parametrize("material", ["generic_pla", "generic_abs"])
def test_part_that_fills_its_usable_volume_fits_after_enlarging(make_task, material):
    section = PrinterSection(name="a", model=PRINTER_MODEL, port=f"sim://{PRINTER_MODEL}", material=material)
    settings = resolve_settings(SettingsRequest(PRINTERS[PRINTER_MODEL], material=material), find_resources())
    x, y, _ = list_max_part_sizes_mm(find_usable_volumes(section, settings.brim_width_mm), settings)[0]
    plate = slice_part(make_task(trimesh.creation.box((x, y, 1.0)), material=material))
    assert plate.max_mm[0] - plate.min_mm[0] > x
    with pytest.raises(FarmError, match="does not fit on the bed"):
        slice_part(make_task(trimesh.creation.box((x * 1.003, y * 1.003, 1.0)), material=material))


def test_enlarged_part_is_not_moved(make_task):
    """Keep the underside of an off-centre part on the bed, and its bounding box in the centre of the bed."""
    corners = [[x, y, 5.0] for x in (0, 30) for y in (0, 20)] + [[0.0, 0.0, 25.0]]
    plate = slice_part(make_task(trimesh.convex.convex_hull(np.array(corners)), brim_width_mm=0.0))
    assert plate.min_mm[:2] == pytest.approx((-15.0, -10.0), abs=0.45)
    assert plate.max_mm[:2] == pytest.approx((15.0, 10.0), abs=0.45)


def test_part_whose_brim_passes_the_edge_is_shifted(make_task):
    """Fill the usable volume with a part that has an expanded first layer and a right side that leans out."""
    outline_mm = [(-103.2, 0), (90, 0), (103.2, 20), (-103.2, 20)]
    mesh = trimesh.creation.extrude_polygon(shapely.Polygon(outline_mm), 20.0)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    task = make_task(mesh, layer_0_expansion_mm=1.0)
    plate = slice_part(task)
    bed_mm = task.usable_volumes[0].rect.expand(task.settings.brim_width_mm)
    assert plate.min_mm[0] == pytest.approx(bed_mm.min_x_mm, abs=0.01)
    low_mm, high_mm = trimesh.load_mesh(task.out.with_suffix(".placed.stl")).bounds[:, 0]
    assert 0.5 < (low_mm + high_mm) / 2 < 1.5


@pytest.mark.parametrize("tops_hidden", [False, True])
def test_only_the_uppermost_layer_of_a_visible_top_is_printed_slowly(make_task, tops_hidden):
    task = make_task(trimesh.creation.box((40.0, 30.0, 6.0)), brim_width_mm=0.0, tops_hidden=tops_hidden)
    *lower_layers, top_layer = slice_part(task).gcode.read_text().split(";LAYER:")[1:]
    lower_mm_s = [read_skin_speeds_mm_s(layer) for layer in lower_layers]
    assert lower_mm_s[0] == {30.0}  # the first layer
    assert lower_mm_s[2] == lower_mm_s[-1] == {60.0}  # the speed of inner walls
    assert max(read_skin_speeds_mm_s(top_layer)) == 60.0
    assert (30.0 in read_skin_speeds_mm_s(top_layer)) == (not tops_hidden)


def test_slopes_are_printed_without_travel_between_their_sides(make_task):
    """Slice a flat cone: each layer shows a ring, and lines in an even order alternate between its sides."""
    cone = trimesh.creation.cone(40.0, 4.0)
    times_s = [
        slice_part(make_task(cone, flat_tops_visible=flat_tops_visible)).sliced_s
        for flat_tops_visible in (False, True)
    ]
    assert times_s[0] < 0.98 * times_s[1]


def read_skin_speeds_mm_s(layer):
    """Read the speeds of the lines of skin in a layer of G-code."""
    speeds_mm_s, is_skin, speed_mm_s = set(), False, 0.0
    for line in layer.splitlines():
        is_skin = line == ";TYPE:SKIN" if line.startswith(";TYPE:") else is_skin
        words = {word[0]: word[1:] for word in line.split(";")[0].split()}
        speed_mm_s = float(words.get("F", 60.0 * speed_mm_s)) / 60.0
        if is_skin and words.keys() >= {"G", "X", "E"} and words["G"] == "1":
            speeds_mm_s.add(round(speed_mm_s, 1))
    return speeds_mm_s


@pytest.mark.parametrize("is_turned", [False, True])
@pytest.mark.parametrize("side", [(1.0, 0.0), (0.0, -1.0)])
def test_walls_along_hidden_sides_are_fast_where_the_part_is_placed(make_task, is_turned, side):
    """Print a block off the bed's centre, turned or not, and compensate its shrinkage."""
    size_mm, centre_mm = np.array([80.0, 50.0]), np.array([7.0, -3.0])
    mesh = trimesh.creation.box((*size_mm, 6.0))
    mesh.apply_translation((*centre_mm, 0.0))
    offset_mm = float(side @ centre_mm + np.abs(side) @ size_mm / 2)
    rect = Rect(-90.0, -90.0, -30.0, 10.0) if is_turned else Rect(-90.0, -90.0, 10.0, -30.0)

    def measure_sliced_s(*sides):
        task = make_task(mesh, brim_width_mm=0.0, hidden_sides=sides)
        # All walls are printed if their number is set.
        request = replace(task.request, overrides={"wall_line_count": 2})
        return slice_part(
            replace(task, request=request, usable_volumes=(UsableVolume(rect, 100.0),))
        ).sliced_s

    plain_s = measure_sliced_s()
    length_mm = float(np.abs(side[::-1]) @ size_mm) - TRANSITION_MM
    nominal_s = 27 * length_mm * (1.0 / 40.0 + 1.0 / 60.0 - 2.0 / 75.4)
    assert plain_s - measure_sliced_s((*side, offset_mm)) == pytest.approx(nominal_s, rel=0.1)
    assert measure_sliced_s((*side, offset_mm - 1.0)) == plain_s


@pytest.mark.parametrize("angle_deg", [0.0, 90.0])
def test_grooves_of_hidden_sides_are_placed_with_the_part(angle_deg):
    """Place a groove from y = 4 to y = 7 in the face x = 10 of a part that is turned, scaled and moved."""
    options = PartPrintOptions(hidden_sides=((1.0, 0.0, 10.0),), hidden_grooves=((0, 4.0, 7.0, 2.0),))
    to_bed = trimesh.transformations.rotation_matrix(np.radians(angle_deg), (0.0, 0.0, 1.0))
    to_bed[:3, :3] *= 1.002
    to_bed[:2, 3] = (-30.0, 12.0)
    (side,) = place_hidden_sides(options, to_bed)
    corners_mm = trimesh.transform_points([(10.0, 4.0, 0.0), (8.0, 7.0, 0.0)], to_bed)[:, :2]
    assert side.measure_depths_mm(corners_mm) == pytest.approx([0.0, 2.0 * 1.002])
    (groove,) = side.grooves
    limits_mm = groove.low_mm, groove.high_mm
    assert side.measure_positions_mm(corners_mm) == pytest.approx(limits_mm)
    assert groove.depth_mm == pytest.approx(2.0 * 1.002)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0])
def test_hidden_recesses_are_placed_with_the_part(angle_deg):
    options = PartPrintOptions(hidden_recesses=((1.0, 2.0, 8.0, 6.0, 0.0, 0.5),))
    to_bed = trimesh.transformations.rotation_matrix(np.radians(angle_deg), (0.0, 0.0, 1.0))
    to_bed[:3, :3] *= 1.002
    to_bed[:3, 3] = (-30.0, 12.0, 0.1)
    (recess,) = place_hidden_recesses(options, to_bed)
    corners_mm = trimesh.transform_points([(1.0, 2.0, 0.0), (8.0, 6.0, 0.5)], to_bed)
    assert (recess.min_x_mm, recess.max_x_mm) == pytest.approx(sorted(corners_mm[:, 0]))
    assert (recess.min_y_mm, recess.max_y_mm) == pytest.approx(sorted(corners_mm[:, 1]))
    assert (recess.face_z_mm, recess.bottom_z_mm) == pytest.approx((0.1, 0.1 + 0.5 * 1.002))


def test_hidden_faces_are_printed_with_fewer_solid_layers(make_task):
    """Print a tee on its foot: the undersides of its arms, on supports, keep their skin."""
    tee = trimesh.util.concatenate(
        [
            trimesh.creation.box((20.0, 20.0, 10.0)),
            trimesh.creation.box(
                (40.0, 20.0, 5.0), trimesh.transformations.translation_matrix((0.0, 0.0, 7.4))
            ),
        ]
    )

    def list_skin_layers(**options):
        gcode = slice_part(make_task(tee, brim_width_mm=0.0, **options)).gcode.read_text()
        layers = gcode.split(";LAYER:")[1:]
        return [n for n, layer in enumerate(layers) if ";TYPE:SKIN" in layer], len(layers)

    plain_layers, layer_count = list_skin_layers()
    hidden_layers, _ = list_skin_layers(bed_face_hidden=True, tops_hidden=True)
    assert plain_layers[:4] == [0, 1, 2, 3]
    assert hidden_layers[:2] == [0, 1]
    arm_layers = [n for n in plain_layers if 3 < n < layer_count - 4]
    assert len(arm_layers) == 4
    assert [n for n in hidden_layers if 3 < n < layer_count - 4] == arm_layers
    assert (plain_layers[-4:], hidden_layers[-3:]) == (
        [*range(layer_count - 4, layer_count)],
        [*range(layer_count - 3, layer_count)],
    )
    assert len(hidden_layers) == len(plain_layers) - 3


def build_overhang(angle_deg, slope_mm):
    """Build a block with a 10 mm wide overhang at its side, of an angle and a length along its slope."""
    angle = np.radians(angle_deg)
    x_mm, z_mm = slope_mm * np.sin(angle), slope_mm * np.cos(angle)
    outline_mm = [(0, 0), (60, 0), (60, 40 - z_mm), (60 + x_mm, 40), (0, 40)]
    mesh = trimesh.creation.extrude_polygon(shapely.Polygon(outline_mm), 10.0)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    return mesh


@pytest.mark.parametrize(
    ("angle_deg", "slope_mm", "overrides", "is_supported"),
    [
        (53.0, 2.3, {}, False),  # 23 mm2
        (54.9, 2.3, {}, False),
        (53.0, 2.8, {}, True),
        (58.0, 2.3, {}, True),
        (53.0, 2.3, {"support_angle": "50"}, True),
        (53.0, 2.3, {"cool_fan_speed": "50"}, True),
        (45.0, 20.0, {}, False),
    ],
)
def test_strip_of_an_overhang_gets_no_tower_of_support(
    make_task, angle_deg, slope_mm, overrides, is_supported
):
    task = make_task(build_overhang(angle_deg, slope_mm), brim_width_mm=0.0)
    request = replace(task.request, overrides=overrides)
    task = replace(task, request=request, settings=resolve_settings(request, task.resources))
    gcode = slice_part(task).gcode.read_text()
    assert (";TYPE:SUPPORT\n" in gcode) == is_supported


def build_fin(edge_deg):
    """Build a block with a fin of 20 mm at its side: steep faces that meet in an edge with this lean."""
    height_mm = 21.0 / np.tan(np.radians(edge_deg))
    corners_mm = [(59, 0, 40 - height_mm), (80, 0, 40), (59, 0, 40), (59, 0.25 * height_mm, 40)]
    fin = trimesh.convex.convex_hull(np.array(corners_mm, float))
    block = trimesh.creation.box(bounds=[(0, 0, 0), (60, 10, 40)])
    return trimesh.boolean.union([block, fin], engine="manifold")


@pytest.mark.parametrize(
    ("edge_deg", "is_supported"), [(48.0, False), (60.0, False), (75.0, False), (84.0, True)]
)
def test_tip_of_a_steep_fin_gets_no_tower_of_support(make_task, edge_deg, is_supported):
    task = make_task(build_fin(edge_deg), brim_width_mm=0.0)
    gcode = slice_part(task).gcode.read_text()
    assert (";TYPE:SUPPORT\n" in gcode) == is_supported


@pytest.mark.parametrize("overrides", [{"support_angle": "50"}, {"cool_fan_speed": "50"}])
def test_fin_keeps_its_support_with_own_angle_or_slow_fan(make_task, overrides):
    task = make_task(build_fin(60.0), brim_width_mm=0.0)
    request = replace(task.request, overrides=overrides)
    task = replace(task, request=request, settings=resolve_settings(request, task.resources))
    assert ";TYPE:SUPPORT\n" in slice_part(task).gcode.read_text()


def test_fin_does_not_remove_the_support_of_a_ledge(make_task):
    """Use a ledge that extends by 1.4 mm, less than the angle for fins supports."""
    ledge = trimesh.creation.box(bounds=[(-1.4, 0, 20), (10, 10, 40)])
    mesh = trimesh.boolean.union([build_fin(60.0), ledge], engine="manifold")
    assert find_support_angle_deg(build_fin(60.0), make_task(mesh).settings) == pytest.approx(82.0, abs=0.6)
    assert find_support_angle_deg(mesh, make_task(mesh).settings) is None


def test_tips_over_air_are_limited_with_high_layers(make_task):
    task = make_task(build_fin(60.0))
    high_layers = replace(task.settings, layer_height_mm=0.6)
    angle_deg = find_support_angle_deg(build_fin(60.0), high_layers)
    assert angle_deg == pytest.approx(np.degrees(np.arctan(1.5 / 0.6)) + 0.5)
    assert find_support_angle_deg(build_fin(75.0), high_layers) is None


def test_chamfered_corner_is_no_fin(make_task):
    """Use a block whose two lower edges have chamfers of 45 degrees, which meet at 54.7 degrees."""
    bottom, top = (
        [(5, 5, 0), (40, 5, 0), (40, 40, 0), (5, 40, 0)],
        [(0, 0, 5), (40, 0, 5), (40, 40, 5), (0, 40, 5)],
    )
    block = trimesh.convex.convex_hull(np.array([*bottom, *top, *[(x, y, 40) for x, y, _ in top]], float))
    assert find_support_angle_deg(block, make_task(block).settings) is None


def test_overhanging_keel_keeps_its_support(make_task):
    """Use a roof that hangs from a column: its level edge has steep faces, but begins in mid-air."""
    corners_mm = [(x, y, z) for x in (20, 50) for y, z in ((5, 25), (0, 40), (10, 40))]
    keel = trimesh.convex.convex_hull(np.array(corners_mm, float))
    column = trimesh.creation.box(bounds=[(0, 0, 0), (21, 10, 40)])
    task = make_task(trimesh.boolean.union([column, keel], engine="manifold"), brim_width_mm=0.0)
    assert ";TYPE:SUPPORT\n" in slice_part(task).gcode.read_text()
