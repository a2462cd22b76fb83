"""Removal of inner walls along hidden sides, in slices of the real engine."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh

from slicing.checks import read_toolpath
from slicing.glued_parts import TRANSITION_MM, HiddenSide, SideGroove
from slicing.plate import slice_plate

CENTRE_MM = np.array((111.5, 111.5))
OUTER_LINE_DEPTH_MM = 0.2  # half a line and the inset of the outer wall
INNER_LINE_DEPTH_MM = 0.525  # one and a half lines
SPACING_MM = INNER_LINE_DEPTH_MM - OUTER_LINE_DEPTH_MM
BLOCK = trimesh.creation.box((60.0, 50.0, 8.0), trimesh.transformations.translation_matrix((0.0, 0.0, 4.0)))
RIGHT, LEFT = HiddenSide((1.0, 0.0), 30.0), HiddenSide((-1.0, 0.0), 30.0)
BACK, FRONT = HiddenSide((0.0, 1.0), 25.0), HiddenSide((0.0, -1.0), 25.0)
INFILL_LAYERS = range(6, 30)
"""Layers of the block well above the skin of its bottom and below that of its top."""


@pytest.fixture
def slice_walls(make_request):
    """Return a function that slices a mesh with hidden sides whose other walls keep their speed."""

    def slice_mesh(*sides, mesh=BLOCK, settings=None, **fields):
        request = make_request(mesh, hidden_sides=sides, settings=settings, **fields)
        result = slice_plate(replace(request, settings=replace(request.settings, hidden_wall_ratio=1.0)))
        return result, read_toolpath(result.gcode.read_bytes())

    return slice_mesh


def list_lines(path, feature, layers=None):
    """Return the lines (n, 2, 2) of a feature in bed-centred mm, and their layers (n,)."""
    is_line = path.is_feature(feature) & (path.extruded_mm > 0.0) & path.is_head_move
    if layers is not None:
        is_line &= np.isin(path.layer, layers)
    lines_mm = np.stack((path.start[is_line, :2], path.end[is_line, :2]), axis=1) - CENTRE_MM
    return lines_mm, path.layer[is_line]


def sum_lengths_mm(lines_mm):
    return float(np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1).sum())


def measure_layer_times_s(path):
    """Return the time of each layer by its number, from the comments, which also divide layers."""
    ends_s = {int(path.layer[move - 1]): end_s for move, end_s in path.list_layer_ends() if move}
    return np.diff([0.0, *(ends_s[layer] for layer in sorted(ends_s) if layer >= 0)])


def list_travel_mm(path, layers):
    is_travel = (path.extruded_mm == 0.0) & path.is_head_move & np.isin(path.layer, layers)
    return np.stack((path.start[is_travel, :2], path.end[is_travel, :2]), axis=1) - CENTRE_MM


def test_inner_wall_along_a_hidden_side_is_removed_except_near_its_ends(slice_walls):
    _, path = slice_walls(RIGHT)
    lines_mm, _ = list_lines(path, "WALL-INNER", INFILL_LAYERS)
    is_on_side = np.abs(30.0 - lines_mm[:, :, 0] - INNER_LINE_DEPTH_MM).max(axis=1) < 0.02
    ends_mm = np.abs(lines_mm[is_on_side][:, :, 1])
    assert ends_mm.min() == pytest.approx(25.0 - INNER_LINE_DEPTH_MM - TRANSITION_MM, abs=0.01)
    assert len(ends_mm) == 2 * len(INFILL_LAYERS)
    other_mm = 2 * 60.0 + 50.0 - 6 * INNER_LINE_DEPTH_MM
    assert sum_lengths_mm(lines_mm[~is_on_side]) == pytest.approx(len(INFILL_LAYERS) * other_mm, rel=1e-3)


def test_inner_walls_stay_beside_skin(slice_walls):
    _, plain_path = slice_walls()
    _, path = slice_walls(RIGHT, LEFT, BACK, FRONT)
    _, skin_layers = list_lines(plain_path, "SKIN")
    for layer in np.unique(skin_layers):
        plain_mm, _ = list_lines(plain_path, "WALL-INNER", [layer])
        lines_mm, _ = list_lines(path, "WALL-INNER", [layer])
        assert sum_lengths_mm(lines_mm) == pytest.approx(sum_lengths_mm(plain_mm))


def test_inner_wall_stays_only_where_skin_is_beside_it(slice_walls):
    """Check the side behind a step: the top of the lower half of the block is skin up to x = 0."""
    stairs = BLOCK.union(make_box((0.0, -25.0, 0.0), (30.0, 25.0, 16.0)))
    _, path = slice_walls(BACK, mesh=stairs)
    lines_mm, _ = list_lines(path, "WALL-INNER", [37])
    is_on_side = np.abs(25.0 - lines_mm[:, :, 1] - INNER_LINE_DEPTH_MM).max(axis=1) < 0.02
    skin_end_mm = list_lines(path, "SKIN", [37])[0][:, :, 0].max()
    first_mm, last_mm = np.sort(lines_mm[is_on_side][:, :, 0], axis=1).T
    assert first_mm.min() == pytest.approx(INNER_LINE_DEPTH_MM - 30.0, abs=0.02)
    assert last_mm[first_mm.argmin()] == pytest.approx(skin_end_mm + TRANSITION_MM, abs=0.5)
    assert first_mm.max() == pytest.approx(30.0 - INNER_LINE_DEPTH_MM - TRANSITION_MM, abs=0.02)


def test_ring_between_hidden_sides_is_skipped(slice_walls):
    _, path = slice_walls(RIGHT, LEFT, BACK, FRONT)
    assert len(list_lines(path, "WALL-INNER", INFILL_LAYERS)[0]) == 0


@pytest.mark.parametrize("sides", [(RIGHT,), (RIGHT, BACK), (RIGHT, LEFT, BACK, FRONT)])
def test_infill_reaches_the_outer_wall_of_hidden_sides_only(slice_walls, sides):
    """Compare the least depth of the infill behind each side with that behind an inner wall."""
    _, plain_path = slice_walls()
    _, path = slice_walls(*sides)
    for side in (RIGHT, LEFT, BACK, FRONT):
        depths_mm = [
            side.measure_depths_mm(list_lines(p, "FILL", INFILL_LAYERS)[0].reshape(-1, 2)).min()
            for p in (plain_path, path)
        ]
        shift_mm = SPACING_MM if side in sides else 0.0
        assert depths_mm[1] == pytest.approx(depths_mm[0] - shift_mm, abs=0.002)


def test_infill_keeps_its_distance_from_the_inner_wall_that_stays(slice_walls):
    """Use infill lines along the side, which must step aside where the inner wall begins again."""
    _, path = slice_walls(RIGHT)
    walls_mm, wall_layers = list_lines(path, "WALL-INNER", INFILL_LAYERS)
    infill_mm, infill_layers = list_lines(path, "FILL", INFILL_LAYERS)
    for layer in INFILL_LAYERS:
        walls = shapely.MultiLineString(list(walls_mm[wall_layers == layer]))
        infill = shapely.MultiLineString(list(infill_mm[infill_layers == layer]))
        crossing_lines = infill.intersection(walls.buffer(0.25, cap_style="flat"))
        assert crossing_lines.length < 2.0 * SPACING_MM  # two steps


def test_all_other_lines_are_those_of_the_engine(slice_walls):
    _, plain_path = slice_walls()
    _, path = slice_walls(RIGHT, BACK)
    for feature in ("WALL-OUTER", "SKIN", "SKIRT"):
        lines_mm, _ = list_lines(path, feature)
        assert lines_mm == pytest.approx(list_lines(plain_path, feature)[0])
        filament_mm = [
            p.extruded_mm[p.is_feature(feature) & p.is_head_move].sum() for p in (plain_path, path)
        ]
        assert filament_mm[1] == pytest.approx(filament_mm[0], abs=0.01)


def test_lines_extrude_the_same_amount_for_each_mm(slice_walls):
    _, plain_path = slice_walls()
    _, path = slice_walls(RIGHT, BACK)
    for feature in ("WALL-INNER", "FILL"):
        flow_ratios = []
        for p in (plain_path, path):
            is_line = p.is_feature(feature) & (p.extruded_mm > 0.0) & p.is_head_move & (p.layer > 0)
            lengths_mm = np.hypot(*(p.end - p.start)[:, :2].T)
            flow_ratios.append(p.extruded_mm[is_line].sum() / lengths_mm[is_line].sum())
        assert flow_ratios[1] == pytest.approx(flow_ratios[0], rel=1e-3)


def test_filament_time_and_header_are_those_of_the_new_lines(slice_walls):
    plain_result, _ = slice_walls()
    result, path = slice_walls(RIGHT, LEFT, BACK, FRONT)
    assert result.sliced_s < 0.95 * plain_result.sliced_s
    assert result.filament_mm < 0.95 * plain_result.filament_mm
    header = result.gcode.read_text()[:300]
    assert f";TIME:{int(result.sliced_s)}\n" in header
    assert f";Filament used: {result.filament_mm / 1000.0:.6g}m\n" in header
    times_s = [float(c.text[13:]) for c in path.comments if c.text.startswith("TIME_ELAPSED:")]
    assert times_s == sorted(times_s)
    assert times_s[-1] == pytest.approx(result.sliced_s, abs=1e-5)


def test_end_of_the_file_retracts_as_before(slice_walls):
    _, plain_path = slice_walls()
    _, path = slice_walls(RIGHT)
    retracted_mm = [p.extruded_mm[~p.is_head_move & (p.extruded_mm < 0.0)][-2:] for p in (plain_path, path)]
    assert retracted_mm[1] == pytest.approx(retracted_mm[0], abs=1e-4)


ANGLE = shapely.Polygon([(-30, -25), (30, -25), (30, -10), (-10, -10), (-10, 25), (-30, 25)])
"""Outline of an angle whose arms are 20 and 15 mm wide."""


INNER_SIDES = HiddenSide((1.0, 0.0), -10.0), HiddenSide((0.0, 1.0), -10.0)


@pytest.mark.parametrize(
    "sides",
    [(LEFT, FRONT), (LEFT, BACK), (INNER_SIDES[0], FRONT), (LEFT, RIGHT, BACK, FRONT, *INNER_SIDES)],
    ids=["ends", "tip", "inner", "all"],
)
def test_travel_stays_within_the_outer_walls(slice_walls, sides):
    angle = trimesh.creation.extrude_polygon(ANGLE, 8.0)
    _, path = slice_walls(*sides, mesh=angle)
    travel_mm = list_travel_mm(path, INFILL_LAYERS)
    lines_mm, _ = list_lines(path, "WALL-INNER", INFILL_LAYERS)
    plain_mm, _ = list_lines(slice_walls(mesh=angle)[1], "WALL-INNER", INFILL_LAYERS)
    assert sum_lengths_mm(lines_mm) < 0.85 * sum_lengths_mm(plain_mm)
    assert all(ANGLE.covers(shapely.LineString(line_mm)) for line_mm in travel_mm)


@pytest.mark.parametrize("share", [0.5, 0.7, 0.98])
def test_no_layer_becomes_shorter_than_the_minimum_time(slice_walls, make_settings, share):
    """Check layers that take at least a minimum time, with little more than it at the largest share."""
    _, plain_path = slice_walls()
    plain_s = measure_layer_times_s(plain_path)
    min_s = share * plain_s[INFILL_LAYERS.start : INFILL_LAYERS.stop].min()
    _, path = slice_walls(RIGHT, LEFT, BACK, FRONT, settings=make_settings(cool_min_layer_time=min_s))
    new_s = measure_layer_times_s(path)
    assert new_s[INFILL_LAYERS.start : INFILL_LAYERS.stop].min() >= min_s - 0.01
    kept_mm = sum_lengths_mm(list_lines(path, "WALL-INNER", INFILL_LAYERS)[0])
    assert (kept_mm == 0.0) == (share < 0.9)


def test_turned_block_saves_the_same_filament(slice_walls):
    angle_rad = np.radians(10.0)
    turned_block = BLOCK.copy().apply_transform(
        trimesh.transformations.rotation_matrix(angle_rad, (0.0, 0.0, 1.0))
    )
    side = HiddenSide((float(np.cos(angle_rad)), float(np.sin(angle_rad))), 30.0)
    saved_mm = [
        slice_walls(mesh=mesh)[0].filament_mm - slice_walls(s, mesh=mesh)[0].filament_mm
        for mesh, s in ((BLOCK, RIGHT), (turned_block, side))
    ]
    assert saved_mm[0] > 0.0
    assert saved_mm[1] == pytest.approx(saved_mm[0], rel=0.1)


def cut_groove(depth_mm, position_mm=0.0):
    """Return the block with an upright V groove of a depth at a position on its right side."""
    tool = trimesh.creation.box((2.0**0.5 * depth_mm, 2.0**0.5 * depth_mm, 20.0))
    tool.apply_transform(trimesh.transformations.rotation_matrix(np.radians(45.0), (0.0, 0.0, 1.0)))
    return BLOCK.difference(tool.apply_translation((30.0, position_mm, 4.0)))


@pytest.mark.parametrize(
    ("depth_mm", "grooves", "is_kept"),
    [
        (0.4, (), False),
        (2.0, (), True),
        (2.0, (SideGroove(-2.0, 2.0, 2.0),), False),
        (2.0, (SideGroove(8.0, 12.0, 2.0),), True),
        (2.0, (SideGroove(-2.0, 2.0, 1.0),), True),
    ],
)
def test_inner_wall_stays_around_a_hole_but_not_around_a_mark_or_key(slice_walls, depth_mm, grooves, is_kept):
    _, path = slice_walls(replace(RIGHT, grooves=grooves), mesh=cut_groove(depth_mm))
    lines_mm, layers = list_lines(path, "WALL-INNER", INFILL_LAYERS)
    is_near = (np.abs(lines_mm[:, :, 1]).max(axis=1) < 2.0 + TRANSITION_MM) & (
        lines_mm[:, :, 0].min(axis=1) > 26.0
    )
    assert (set(layers[is_near]) == set(INFILL_LAYERS)) == is_kept
    assert bool(is_near.any()) == is_kept


@pytest.mark.parametrize("seam_mm", [(30.0, 0.0), (-30.0, 0.0)])
def test_inner_wall_is_removed_wherever_the_outer_wall_begins(slice_walls, make_settings, seam_mm):
    """Check a groove as wide as the length of wall that the next layer may leave uncovered."""
    side = replace(RIGHT, grooves=(SideGroove(-2.0, 2.0, 2.0),))
    x_mm, y_mm = CENTRE_MM + seam_mm
    settings = make_settings(z_seam_type="back", z_seam_x=x_mm, z_seam_y=y_mm)
    _, path = slice_walls(side, mesh=cut_groove(2.0), settings=settings)
    lines_mm, _ = list_lines(path, "WALL-INNER", INFILL_LAYERS)
    is_on_side = np.abs(30.0 - lines_mm[:, :, 0] - INNER_LINE_DEPTH_MM).max(axis=1) < 0.02
    assert np.abs(lines_mm[is_on_side][:, :, 1]).min() > 25.0 - INNER_LINE_DEPTH_MM - TRANSITION_MM - 0.02


@pytest.mark.parametrize(("depth_mm", "is_kept"), [(0.4, False), (2.0, True)])
def test_inner_wall_stays_beside_a_deep_notch_of_a_corner(slice_walls, depth_mm, is_kept):
    _, path = slice_walls(RIGHT, LEFT, BACK, FRONT, mesh=cut_groove(depth_mm, position_mm=24.4))
    assert (len(list_lines(path, "WALL-INNER", INFILL_LAYERS)[0]) > 0) == is_kept


@pytest.mark.parametrize(
    "overrides",
    [
        {"wall_line_count": 2},
        {"wall_thickness": 0.7},
        {"infill_sparse_density": 0.0},
        {"cool_min_layer_time": 30.0},
        {"retraction_combing": "off"},
        {"retraction_combing_max_distance": 30.0},
    ],
)
def test_inner_walls_stay_if_the_user_or_the_print_needs_them(slice_walls, make_settings, overrides):
    """Check walls that the user has set, a part without infill, and layers that the slicer slows down."""
    settings = make_settings(**overrides)
    plain_result, _ = slice_walls(settings=settings)
    assert slice_walls(RIGHT, settings=settings)[0].sha256 == plain_result.sha256


@pytest.mark.parametrize("quality", ["paper", "glue-strong"])
def test_other_qualities_keep_inner_walls(slice_walls, make_settings, quality):
    settings = make_settings(quality)
    plain_result, _ = slice_walls(settings=settings)
    assert slice_walls(RIGHT, settings=settings)[0].sha256 == plain_result.sha256


def test_cache_distinguishes_single_walls(slice_walls, make_settings, tmp_path):
    settings = make_settings()
    results = [
        slice_walls(
            RIGHT, settings=replace(settings, has_single_hidden_walls=value), cache=tmp_path / "cache"
        )[0]
        for value in (False, True, True)
    ]
    assert [result.is_cached for result in results] == [False, False, True]
    assert results[0].sha256 != results[1].sha256 == results[2].sha256


def list_layers_with_changed_walls(slice_walls, mesh, side):
    """List the layers in which over 5 mm of inner wall are removed along a side."""
    lengths_mm = []
    for sides in ((), (side,)):
        lines_mm, layers = list_lines(slice_walls(*sides, mesh=mesh)[1], "WALL-INNER")
        lengths_mm.append(np.bincount(layers, np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1), 99))
    return np.flatnonzero(lengths_mm[0] - lengths_mm[1] > 5.0).tolist()


def make_box(low_mm, high_mm):
    return trimesh.creation.box(bounds=(low_mm, high_mm))


def test_inner_wall_stays_where_no_infill_is_beside_it(slice_walls):
    """Check the end of a hollow tab, whose wall of 1.4 mm has room for the two walls of each side alone."""
    tab = make_box((20.0, -12.0, 0.0), (30.0, 12.0, 8.0)).difference(
        make_box((18.0, -10.6, -1.0), (28.6, 10.6, 9.0))
    )
    plate = make_box((-30.0, -25.0, 0.0), (21.0, 25.0, 8.0)).union(tab)
    assert list_layers_with_changed_walls(slice_walls, plate, RIGHT) == []


def test_inner_wall_is_removed_around_a_short_side_without_infill(slice_walls):
    """Check a long side and a short one beside it, which infill reaches in every other layer only."""
    outline = shapely.Polygon([(-30.0, -25.0), (30.0, -25.0), (30.0, 25.0), (19.0, 25.0), (-30.0, -6.0)])
    mesh = trimesh.creation.extrude_polygon(outline, 8.0)
    lines_mm, layers = list_lines(slice_walls(RIGHT, BACK, mesh=mesh)[1], "WALL-INNER", INFILL_LAYERS)
    is_on_right = np.abs(30.0 - lines_mm[:, :, 0] - INNER_LINE_DEPTH_MM).max(axis=1) < 0.02
    lengths_mm = np.bincount(
        layers[is_on_right], np.linalg.norm(np.diff(lines_mm[is_on_right], axis=1), axis=2)[:, 0]
    )
    assert np.flatnonzero(lengths_mm > 20.0).tolist() == []


@pytest.mark.parametrize("step_mm", [0.0, 0.25, 0.5])
def test_inner_wall_stays_below_a_wall_that_lies_on_it(slice_walls, step_mm):
    """Check a side whose upper half is a little further back than the lower one."""
    block = make_box((-30.0, -25.0, 0.0), (30.0, 25.0, 4.0)).union(
        make_box((-30.0, -25.0, 3.0), (30.0 - step_mm, 25.0, 10.0))
    )
    removed_layers = list_layers_with_changed_walls(slice_walls, block, RIGHT)
    lines_mm, layers = list_lines(slice_walls(mesh=block)[1], "WALL-OUTER")
    is_lower = np.abs(30.0 - lines_mm[:, :, 0] - OUTER_LINE_DEPTH_MM).max(axis=1) < 0.02
    last_layer = layers[is_lower].max() if step_mm else 19
    assert {8, 12, last_layer - 1} < set(removed_layers)
    assert (last_layer in removed_layers) == (step_mm == 0.0)
    assert (max(removed_layers) > last_layer) == (step_mm == 0.0)
