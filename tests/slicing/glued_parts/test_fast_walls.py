"""Speed of walls along hidden sides, in slices of the real engine."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from slicing.checks import read_toolpath
from slicing.glued_parts import TRANSITION_MM, HiddenRecess, HiddenSide
from slicing.plate import slice_plate

SIDE = HiddenSide((1.0, 0.0), 30.0)
CENTRE_MM = 111.5, 111.5
FAST_MM_MIN = 3600.0 * 0.44 / 0.35  # the flow of infill, whose lines are wider
OUTER_DEPTH_MM = 0.2  # half a line and the inset of the outer wall
INNER_DEPTH_MM = 0.525  # one and a half lines
BLOCK = trimesh.creation.box((60.0, 50.0, 8.0), trimesh.transformations.translation_matrix((0.0, 0.0, 4.0)))


@pytest.fixture
def make_request(make_request, make_settings):
    """Return a function that makes a PlateRequest which keeps the inner walls of hidden sides."""

    def make(model, settings=None, **fields):
        settings = replace(settings or make_settings(), has_single_hidden_walls=False)
        return make_request(model, settings=settings, **fields)

    return make


def slice_toolpath(make_request, sides=(), mesh=BLOCK, **fields):
    result = slice_plate(make_request(mesh, hidden_sides=tuple(sides), **fields))
    return result, read_toolpath(result.gcode.read_bytes())


def find_lines(path, feature, depth_mm, side=SIDE, above_layer=3):
    """Return the indices (k,) of a feature's lines at a depth behind a side, above the slow first layers."""
    on_line = path.is_feature(feature) & (path.extruded_mm > 0.0) & (path.layer > above_layer)
    for points in (path.start, path.end):
        depths_mm = side.offset_mm - (points[:, :2] - CENTRE_MM) @ side.normal
        on_line &= np.abs(depths_mm - depth_mm) < 0.04
    return np.flatnonzero(on_line)


def list_lengths_mm(path):
    return np.linalg.norm((path.end - path.start)[:, :2], axis=1)


@pytest.mark.parametrize(
    ("feature", "depth_mm", "nominal_mm_min"),
    [("WALL-OUTER", OUTER_DEPTH_MM, 2400), ("WALL-INNER", INNER_DEPTH_MM, 3600)],
)
def test_walls_along_a_hidden_side_are_fast_except_at_their_end(
    make_request, feature, depth_mm, nominal_mm_min
):
    _, path = slice_toolpath(make_request, [SIDE])
    lines = find_lines(path, feature, depth_mm)
    assert len(lines) > 30
    is_fast = np.isclose(path.feed_mm_min[lines], FAST_MM_MIN, atol=0.01)
    ends = lines[~is_fast]
    assert path.feed_mm_min[ends] == pytest.approx(nominal_mm_min)
    assert list_lengths_mm(path)[ends] == pytest.approx(TRANSITION_MM, abs=0.01)
    assert is_fast.sum() == len(ends)


def notch_block(depth_mm):
    """Return the block with two upright V grooves of a given depth in its side."""
    tool = trimesh.creation.box((2.0**0.5 * depth_mm, 2.0**0.5 * depth_mm, 20.0))
    tool.apply_transform(trimesh.transformations.rotation_matrix(np.radians(45.0), (0.0, 0.0, 1.0)))
    return BLOCK.difference(
        [tool.copy().apply_translation((SIDE.offset_mm, y_mm, 4.0)) for y_mm in (-8.0, 8.0)]
    )


@pytest.mark.parametrize(("depth_mm", "fast_notches", "slow_ends"), [(0.4, 2, 1), (1.5, 0, 3)])
def test_line_continues_through_a_mark_but_not_through_a_hole(
    make_request, depth_mm, fast_notches, slow_ends
):
    """Check the lines between corners and notches.

    The engine begins each loop in one of the notches. If this is a mark, lines are fast up to the seam there.
    """
    _, path = slice_toolpath(make_request, [SIDE], mesh=notch_block(depth_mm))
    is_wall = path.is_feature("WALL-OUTER") & (path.extruded_mm > 0.0) & (path.layer > 3)
    depths_mm = SIDE.offset_mm + CENTRE_MM[0] - np.stack((path.start[:, 0], path.end[:, 0]))
    is_side = is_wall & (np.abs(depths_mm - OUTER_DEPTH_MM) < 0.04).all(axis=0)
    is_notch = is_wall & ~is_side & (depths_mm < 5.0).all(axis=0)
    is_notch &= (np.abs(np.stack((path.start[:, 1], path.end[:, 1])) - CENTRE_MM[1]) < 11.0).all(axis=0)
    is_fast = path.feed_mm_min > FAST_MM_MIN - 1.0
    layers = len(np.unique(path.layer[is_side]))
    assert (is_notch & is_fast).sum() == fast_notches * 2 * layers
    assert ((is_notch & ~is_fast).sum() > 0) == (fast_notches < 2)
    slow_mm = list_lengths_mm(path)[is_side & ~is_fast].sum()
    assert slow_mm == pytest.approx(slow_ends * layers * TRANSITION_MM, rel=0.01)


def test_short_line_is_fast_only_before_a_seam_in_a_mark(make_request):
    """Check a mark 7 mm from a corner, in which the engine begins each loop; loops run towards +Y here."""
    tool = trimesh.creation.box((0.57, 0.57, 20.0))
    tool.apply_transform(trimesh.transformations.rotation_matrix(np.radians(45.0), (0.0, 0.0, 1.0)))
    for y_mm, slow_line_mm in ((-18.0, TRANSITION_MM), (18.0, 6.3)):
        notch = tool.copy().apply_translation((SIDE.offset_mm, y_mm, 4.0))
        _, path = slice_toolpath(make_request, [SIDE], mesh=BLOCK.difference([notch]))
        lines = find_lines(path, "WALL-OUTER", OUTER_DEPTH_MM)
        is_fast = path.feed_mm_min[lines] > FAST_MM_MIN - 1.0
        layers = len(np.unique(path.layer[lines]))
        slow_mm = list_lengths_mm(path)[lines[~is_fast]].sum()
        assert slow_mm / layers == pytest.approx(slow_line_mm, rel=0.02)


def test_visible_wall_just_behind_the_side_is_slow(make_request):
    """Check two recesses, as shallow as a mark but longer; the engine begins each loop in one of them."""
    recess = trimesh.creation.box((0.6, 10.0, 20.0)).apply_translation((SIDE.offset_mm, 0.0, 4.0))
    recesses = [recess.copy().apply_translation((0.0, y_mm, 0.0)) for y_mm in (-12.0, 12.0)]
    _, path = slice_toolpath(make_request, [SIDE], mesh=BLOCK.difference(recesses))
    back_lines = find_lines(path, "WALL-OUTER", OUTER_DEPTH_MM + 0.3)
    assert len(back_lines) >= 2 * len(np.unique(path.layer[back_lines]))
    assert set(path.feed_mm_min[back_lines]) == {2400.0}
    assert (path.feed_mm_min[find_lines(path, "WALL-OUTER", OUTER_DEPTH_MM)] > FAST_MM_MIN - 1.0).any()


def test_only_walls_along_the_side_are_fast(make_request):
    _, path = slice_toolpath(make_request, [SIDE])
    for feature, depth_mm in (("WALL-OUTER", OUTER_DEPTH_MM), ("WALL-INNER", INNER_DEPTH_MM)):
        is_fast = path.is_feature(feature) & (path.extruded_mm > 0.0) & (path.feed_mm_min > FAST_MM_MIN - 1.0)
        assert np.isin(np.flatnonzero(is_fast), find_lines(path, feature, depth_mm, above_layer=1)).all()


def test_faster_file_has_the_same_lines_and_filament(make_request):
    """Check that all points of the plain file are in the faster one, which also divides lines."""
    _, plain_path = slice_toolpath(make_request)
    _, path = slice_toolpath(make_request, [SIDE])
    points = {tuple(point) for point in path.end.tolist()}
    assert all(tuple(point) in points for point in plain_path.end.tolist())
    assert len(path.end) > len(plain_path.end)
    assert list_lengths_mm(path).sum() == pytest.approx(list_lengths_mm(plain_path).sum(), rel=1e-6)
    assert path.extruded_mm.sum() == pytest.approx(plain_path.extruded_mm.sum(), abs=1e-6)


def test_saved_time_is_in_the_comments_and_the_header(make_request):
    plain_result, _ = slice_toolpath(make_request)
    result, path = slice_toolpath(make_request, [SIDE])
    lengths_mm = list_lengths_mm(path)
    expected_s = 0.0
    for feature, depth_mm, nominal_mm_s in (
        ("WALL-OUTER", OUTER_DEPTH_MM, 40.0),
        ("WALL-INNER", INNER_DEPTH_MM, 60.0),
    ):
        lines = find_lines(path, feature, depth_mm)
        fast_lines = lines[path.feed_mm_min[lines] > FAST_MM_MIN - 1.0]
        expected_s += float(lengths_mm[fast_lines].sum()) * (1.0 / nominal_mm_s - 60.0 / FAST_MM_MIN)
    assert plain_result.sliced_s - result.sliced_s == pytest.approx(expected_s, rel=0.15)
    times_s = [float(c.text[13:]) for c in path.comments if c.text.startswith("TIME_ELAPSED:")]
    assert times_s == sorted(times_s)
    assert times_s[-1] == pytest.approx(result.sliced_s, abs=1e-5)
    assert f";TIME:{int(result.sliced_s)}\n" in result.gcode.read_text()[:200]
    assert sum(list_times_s(result.features)) == pytest.approx(result.sliced_s, rel=1e-6)


def list_times_s(features):
    return [getattr(features, name) for name in features.__slots__]


def test_side_without_a_wall_in_its_plane_changes_nothing(make_request):
    plain_result, _ = slice_toolpath(make_request)
    result, _ = slice_toolpath(make_request, [HiddenSide((1.0, 0.0), 29.0), HiddenSide((-1.0, 0.0), 20.0)])
    assert result.sha256 == plain_result.sha256


def test_short_layers_keep_their_speed(make_request):
    """Check a tower whose layers the slicer slows down to the minimum layer time."""
    tower = trimesh.creation.box(
        (8.0, 8.0, 12.0), trimesh.transformations.translation_matrix((0.0, 0.0, 6.0))
    )
    side = HiddenSide((1.0, 0.0), 4.0)
    plain_result = slice_plate(make_request(tower))
    assert slice_plate(make_request(tower, hidden_sides=(side,))).sha256 == plain_result.sha256


@pytest.mark.parametrize("spare_share", [0.01, 0.03, 0.5])
def test_speed_rises_until_a_layer_takes_the_minimum_time(make_request, make_settings, spare_share):
    _, plain_path = slice_toolpath(make_request)
    layers_s = np.diff([end_s for _, end_s in plain_path.list_layer_ends()])
    min_s = round((1.0 - spare_share) * float(layers_s[6:-6].min()), 3)
    settings = make_settings(cool_min_layer_time=min_s)
    plain_result, _ = slice_toolpath(make_request, settings=settings)
    result, path = slice_toolpath(make_request, [SIDE], settings=settings)
    feeds_mm_min = path.feed_mm_min[find_lines(path, "WALL-OUTER", OUTER_DEPTH_MM, above_layer=6)]
    fastest_mm_min = float(feeds_mm_min.max())
    assert fastest_mm_min == pytest.approx(FAST_MM_MIN) if spare_share > 0.4 else fastest_mm_min < FAST_MM_MIN
    assert fastest_mm_min > 2450.0
    assert result.sliced_s < plain_result.sliced_s
    new_layers_s = np.diff([end_s for _, end_s in path.list_layer_ends()])
    assert float(new_layers_s[6:-6].min()) >= min_s


@pytest.mark.parametrize(("fan_share", "changes"), [(100.0, True), (20.0, False)])
def test_layer_with_a_faster_fan_keeps_its_speed(make_request, make_settings, fan_share, changes):
    """Check a fan that runs faster in layers of less than ten minutes, unless it has only one speed."""
    settings = make_settings(cool_fan_speed_min=fan_share, cool_min_layer_time_fan_speed_max=600.0)
    plain_result, _ = slice_toolpath(make_request, settings=settings)
    result, _ = slice_toolpath(make_request, [SIDE], settings=settings)
    assert (result.sha256 != plain_result.sha256) == changes


def test_speed_is_limited_by_the_ratio_and_by_infill(make_request, make_settings):
    settings = make_settings(speed_wall_0=20.0)
    _, path = slice_toolpath(make_request, [SIDE], settings=settings)
    lines = find_lines(path, "WALL-OUTER", OUTER_DEPTH_MM)
    assert set(path.feed_mm_min[lines]) == {1200.0, 2400.0}
    plain_settings = replace(settings, hidden_wall_ratio=1.0)
    _, path = slice_toolpath(make_request, [SIDE], settings=plain_settings)
    assert set(path.feed_mm_min[find_lines(path, "WALL-OUTER", OUTER_DEPTH_MM)]) == {1200.0}


@pytest.mark.parametrize("opens_upwards", [False, True], ids=["bed", "top"])
def test_rings_around_a_hidden_recess_are_fast(make_request, opens_upwards):
    """Check a groove for a key beside a hole of the same shape, which is visible; the outline stays slow."""
    face_z_mm, bottom_z_mm = (8.0, 5.8) if opens_upwards else (0.0, 2.2)
    groove = trimesh.creation.box((4.0, 10.0, 2.0 * 2.2)).apply_translation((-12.0, 0.0, face_z_mm))
    mesh = BLOCK.difference([groove, groove.copy().apply_translation((24.0, 0.0, 0.0))])
    recess = HiddenRecess(-14.0, -5.0, -10.0, 5.0, face_z_mm, bottom_z_mm)
    _, path = slice_toolpath(make_request, mesh=mesh, hidden_recesses=(recess,))
    is_wall = (path.is_feature("WALL-OUTER") | path.is_feature("WALL-INNER")) & (path.extruded_mm > 0.0)
    is_fast = is_wall & (path.feed_mm_min > FAST_MM_MIN - 1.0)
    points_mm = np.concatenate([path.start[is_fast, :2], path.end[is_fast, :2]]) - CENTRE_MM
    assert is_fast.any()
    low_mm, high_mm = points_mm.min(axis=0), points_mm.max(axis=0)
    assert np.abs(low_mm - (-14.0 - INNER_DEPTH_MM, -5.0 - INNER_DEPTH_MM)).max() < 0.1
    assert np.abs(high_mm - (-10.0 + INNER_DEPTH_MM, 5.0 + INNER_DEPTH_MM)).max() < 0.1
    layer_mm = make_request(mesh).settings.layer_height_mm
    z_mm = path.end[is_fast, 2]
    assert z_mm.min() > min(face_z_mm, bottom_z_mm)
    assert z_mm.max() < max(face_z_mm, bottom_z_mm) + layer_mm


def test_cache_distinguishes_hidden_sides(make_request, tmp_path):
    plain_result, _ = slice_toolpath(make_request, cache=tmp_path / "cache")
    fast_result, _ = slice_toolpath(make_request, [SIDE], cache=tmp_path / "cache")
    repeated_result, _ = slice_toolpath(make_request, [SIDE], cache=tmp_path / "cache")
    assert [r.is_cached for r in (plain_result, fast_result, repeated_result)] == [False, False, True]
    assert plain_result.sha256 != fast_result.sha256 == repeated_result.sha256


def test_rotated_side_saves_the_same_time(make_request):
    """Rotate block and side by 30 degrees, which changes the saved time only by the engine's rounding."""
    angle_rad = np.radians(30.0)
    rotated_block = BLOCK.copy().apply_transform(
        trimesh.transformations.rotation_matrix(angle_rad, (0.0, 0.0, 1.0))
    )
    side = HiddenSide((float(np.cos(angle_rad)), float(np.sin(angle_rad))), 30.0)
    saved_s = [
        slice_plate(make_request(mesh)).sliced_s - slice_plate(make_request(mesh, hidden_sides=(s,))).sliced_s
        for mesh, s in ((BLOCK, SIDE), (rotated_block, side))
    ]
    assert saved_s[0] > 0.0
    assert saved_s[1] == pytest.approx(saved_s[0], rel=0.05)


def test_other_moves_keep_their_feedrate(make_request):
    """Compare each move that both files have, because G-code keeps the feedrate of the previous line."""
    _, plain_path = slice_toolpath(make_request)
    _, path = slice_toolpath(make_request, [SIDE])
    feeds_mm_min = {
        (*start, *end): feed
        for start, end, feed in zip(
            plain_path.start.tolist(), plain_path.end.tolist(), plain_path.feed_mm_min.tolist(), strict=True
        )
    }
    changed_features = [
        feature
        for start, end, feed, feature in zip(
            path.start.tolist(), path.end.tolist(), path.feed_mm_min.tolist(), path.feature, strict=True
        )
        if feeds_mm_min.get((*start, *end), feed) != feed
    ]
    assert not changed_features
