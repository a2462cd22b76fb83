"""Printed outlines compared with the model, in G-code of the tests and of the real engine."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh

from slicing.checks import WallLayout, check_outline, read_toolpath, read_wall_layout
from slicing.errors import Rule, SliceRejected
from slicing.plate import slice_plate

LAYOUT = WallLayout(
    layer_height_0_mm=0.3,
    layer_height_mm=0.2,
    width_mm=0.35,
    line_width_factor_0=1.0,
    inset_mm=0.025,
    offset_0_mm=0.0,
    offset_mm=0.0,
    slack_mm=0.0,
)
FILAMENT_MM2 = 6.379
make_translation = trimesh.transformations.translation_matrix
BOX = trimesh.creation.box((30, 20, 6), make_translation((0, 0, 3)))
CONE = trimesh.creation.cone(15, 20, sections=64)
TUBE = trimesh.boolean.difference([BOX, trimesh.creation.cylinder(5, 20, sections=64)])

FIN = trimesh.boolean.union([BOX, trimesh.creation.box((0.3, 12, 9), make_translation((4, 0, 9)))])


def draw_rings(shape, layout=LAYOUT):
    """Yield the centre lines of the outer wall of a shape."""
    inner_shape = shape.buffer(-layout.width_mm / 2 - layout.inset_mm, join_style="mitre")
    for part in shapely.get_parts(inner_shape):
        if part.is_empty:
            continue
        yield from (part.exterior.coords, *(hole.coords for hole in part.interiors))


def draw_gcode(layers, layout=LAYOUT):
    """Write G-code of an outer wall from the rings of each layer, which are lists of points."""
    text, fed_mm = [";LAYER_COUNT:9"], 0.0
    for number, paths in enumerate(layers):
        text += [f";LAYER:{number}", ";TYPE:WALL-OUTER"]
        top_mm = layout.compute_top_mm(number)
        layer_mm = layout.layer_height_mm if number else layout.layer_height_0_mm
        for points in paths:
            points = np.asarray(points)[:, :2] + 100.0
            text.append(f"G0 F9000 X{points[0][0]:.3f} Y{points[0][1]:.3f} Z{top_mm:.3f}")
            for start_point, end_point in pairwise(points):
                fed_mm += np.hypot(*(end_point - start_point)) * layout.width_mm * layer_mm / FILAMENT_MM2
                text.append(f"G1 F1800 X{end_point[0]:.3f} Y{end_point[1]:.3f} E{fed_mm:.5f}")
    return "\n".join(text).encode()


def count_layers(mesh, layout=LAYOUT):
    return round((mesh.extents[2] - layout.layer_height_0_mm) / layout.layer_height_mm) + 1


def make_circle(radius_mm):
    angles_rad = np.arange(64) * 2 * np.pi / 64
    return shapely.Polygon(radius_mm * np.column_stack((np.cos(angles_rad), np.sin(angles_rad))))


RECTANGLE = shapely.box(-15, -10, 15, 10)
SHAPES = {
    id(BOX): lambda z_mm: RECTANGLE,
    id(TUBE): lambda z_mm: RECTANGLE.difference(make_circle(5)),
    id(CONE): lambda z_mm: make_circle(15 - 0.75 * z_mm),
    id(FIN): lambda z_mm: RECTANGLE if z_mm < 6 else shapely.box(3.85, -6, 4.15, 6),
}


def list_shapes(mesh, layout=LAYOUT):
    """Return the sections of one of the models above."""
    return [SHAPES[id(mesh)](z_mm) for z_mm in layout.compute_section_heights_mm(count_layers(mesh, layout))]


def check_layers(mesh, layers, layout=LAYOUT, removed_layers=0):
    return check_outline(
        read_toolpath(draw_gcode(layers, layout)),
        np.asarray(mesh.triangles, float),
        layout,
        removed_layer_count=removed_layers,
        centre_mm=(100.0, 100.0),
        filament_mm2=FILAMENT_MM2,
    )


@pytest.mark.parametrize("mesh", [BOX, TUBE], ids=["box", "tube"])
def test_wall_along_the_outline_passes(mesh):
    layers = [list(draw_rings(shape)) for shape in list_shapes(mesh)]
    assert check_layers(mesh, layers) == ()
    # Cura 5 draws rings in the other direction.
    reversed_layers = [[np.asarray(ring)[::-1] for ring in layer] for layer in layers]
    assert check_layers(mesh, reversed_layers) == ()
    inverted_mesh = mesh.copy()
    inverted_mesh.invert()
    assert check_layers(inverted_mesh, layers) == ()


def test_outline_of_the_model_is_offset_according_to_the_settings():
    layout = replace(LAYOUT, offset_mm=0.4, offset_0_mm=-0.3)
    grown_layers = [
        list(draw_rings(shape.buffer(0.4 if number else -0.3, join_style="mitre")))
        for number, shape in enumerate(list_shapes(BOX))
    ]
    assert check_layers(BOX, grown_layers, layout) == ()
    with pytest.raises(SliceRejected, match="layer 0"):
        check_layers(BOX, grown_layers)


def change_layer_5(change):
    """Return the layers of the tube with layer 5 changed."""
    layers = [list(draw_rings(shape)) for shape in list_shapes(TUBE)]
    layers[5] = change(layers[5])
    return layers


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda layer: [], r"layer 5 \(Z 1.30 mm\) leaves out 5\d\d"),
        (lambda layer: layer[:1], r"layer 5 .* prints 7\d.\d mm2 outside"),
        (lambda layer: [np.asarray(ring) + (2.0, 0, 0)[:2] for ring in layer], "layer 5"),
        (lambda layer: [np.asarray(ring) * 0.9 for ring in layer], "layer 5"),
        (
            lambda layer: [*layer, [(20, 0), (25, 0), (25, 5), (20, 5), (20, 0)]],
            r"outside the model at X2",
        ),
    ],
    ids=["nothing", "no hole", "shifted", "shrunk", "separate square"],
)
def test_layer_that_differs_from_the_model_is_refused(change, message):
    with pytest.raises(SliceRejected, match=message) as error:
        check_layers(TUBE, change_layer_5(change))
    assert error.value.rule is Rule.OUTLINE
    assert "repair the mesh" in str(error.value)


def test_missing_top_is_refused():
    layers = [list(draw_rings(shape)) for shape in list_shapes(TUBE)]
    with pytest.raises(SliceRejected, match="leaves out"):
        check_layers(TUBE, layers[:20])
    with pytest.raises(SliceRejected, match="% of the model is missing"):
        check_layers(TUBE, layers[:10])


def test_short_gap_without_flow_does_not_open_a_ring():
    layers = [list(draw_rings(shape)) for shape in list_shapes(BOX)]
    outer_ring = np.asarray(layers[5][0])
    gap_end = outer_ring[2] + (outer_ring[3] - outer_ring[2]) / 20
    layers[5] = [outer_ring[:3], np.vstack((gap_end, outer_ring[3:]))]
    assert check_layers(BOX, layers) == ()


def test_removed_bottom_layers_are_considered():
    layers = [list(draw_rings(shape)) for shape in list_shapes(CONE)]
    assert check_layers(CONE, layers) == ()
    assert check_layers(CONE, layers[2:], removed_layers=2) == ()
    assert check_layers(CONE, layers[2:], replace(LAYOUT, offset_0_mm=-0.3), removed_layers=2) == ()
    with pytest.raises(SliceRejected, match="layer"):
        check_layers(CONE, layers[2:])


def test_unprintable_wall_is_reported_with_its_size_and_position():
    layers = [list(draw_rings(shape)) for shape in list_shapes(FIN)]
    (wall,) = check_layers(FIN, layers)
    assert wall.area_mm2 == pytest.approx(12 * 7.5, rel=0.05)
    assert (wall.x_mm, wall.y_mm) == pytest.approx((4, 0), abs=0.1)
    assert (wall.from_z_mm, wall.to_z_mm) == pytest.approx((6, 13.5), abs=0.11)
    assert str(wall).startswith("walls too thin to print: 9")


def test_wall_of_one_line_is_printed():
    layers = [list(draw_rings(shape)) for shape in list_shapes(FIN)]
    layers = [layer or [[(4, -5.8), (4, 5.8)]] for layer in layers]
    assert check_layers(FIN, layers) == ()


@pytest.mark.parametrize(
    "setting",
    [
        {"magic_spiralize": "True"},
        {"slicing_tolerance": "exclusive"},
        {"magic_fuzzy_skin_enabled": "True"},
        {"coasting_enable": "True"},
    ],
)
def test_settings_that_change_the_outline_are_considered(make_settings, setting):
    settings = make_settings()
    assert read_wall_layout(settings) is not None
    for scope in (settings.global_, settings.extruder):
        name = "global_" if scope is settings.global_ else "extruder"
        assert read_wall_layout(replace(settings, **{name: scope | setting})) is None
    assert read_wall_layout(replace(settings, wall_count=0)) is None


SPHERE = trimesh.creation.icosphere(3, 12)
CLOSED_MESHES = {
    "sphere": SPHERE,
    "hollow": trimesh.boolean.difference([SPHERE, trimesh.creation.icosphere(3, 8)]),
    "torus": trimesh.creation.torus(14, 5),
    "on its edge": trimesh.creation.box(
        (12, 12, 12), trimesh.transformations.rotation_matrix(0.8, (1, 0, 0))
    ),
    "holes": trimesh.boolean.difference(
        [trimesh.creation.box((30, 12, 4))]
        + [
            trimesh.creation.cylinder(0.4 + 0.2 * i, 9, transform=make_translation((5 * i - 12, 0, 0)))
            for i in range(6)
        ]
    ),
    "nearly flat": trimesh.creation.icosphere(3, 12).apply_scale((1, 1, 0.06)),
    "shell": trimesh.creation.annulus(7, 7.7, 12),
}


@pytest.mark.parametrize("mesh", CLOSED_MESHES.values(), ids=CLOSED_MESHES.keys())
def test_real_slices_of_sound_models_pass(make_request, mesh):
    assert slice_plate(make_request(mesh)).unprinted_walls == ()


def test_thin_fins_of_a_real_slice_are_reported(make_request, tmp_path):
    block = [trimesh.creation.box((40, 40, 5))]
    fins = [trimesh.creation.box((0.3, 30, 12), make_translation((x, 0, 5))) for x in (-10, 0, 10)]
    model = trimesh.boolean.union(block + fins)
    request = make_request(model, cache=tmp_path / "cache")
    result = slice_plate(request)
    assert sorted(round(wall.x_mm) for wall in result.unprinted_walls) == [-10, 0, 10]
    assert all(wall.area_mm2 == pytest.approx(30 * 8.5, rel=0.05) for wall in result.unprinted_walls)
    assert all(
        (wall.from_z_mm, wall.to_z_mm) == pytest.approx((5, 13.5), abs=0.2) for wall in result.unprinted_walls
    )
    second_result = slice_plate(request)
    assert second_result == replace(result, is_cached=True)
