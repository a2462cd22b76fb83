"""Price of a part: manual calculations, invariants, and comparisons with CuraEngine."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from decompose.geometry import Solid
from decompose.print_time import (
    ADDITIVE_FEATURES,
    FACTORS,
    MAX_INSET_SHARE,
    POSE_ROTATIONS,
    CostModel,
    PrintTimeSettings,
    compute_price_s,
    compute_time_terms,
    measure_pose,
    price_axis_poses_s,
    sum_pose_features,
)
from decompose.print_time.pose_prices import find_pose_axes, price_poses_s
from decompose.print_time.time_settings import FEATURES, RIM_TURN_TIME_SHARE, SLOPE_TURN_TIME_SHARE
from decompose.printers import TargetPrinter

ZERO_COST = CostModel(*[0.0] * 8, brim_mm=0.0, skin_cos=0.7)


def make_cost(**coefficients: float) -> CostModel:
    """Make a cost model with these coefficients; all others are 0."""
    return replace(ZERO_COST, **coefficients)


def make_wedge(run_mm: float) -> Solid:
    """Make a block 5 mm deep, one side of which leans out by `run_mm` over 10 mm of height."""
    vertices = [(x, y, z) for y in (0.0, 5.0) for x, z in ((0, 0), (10, 0), (10 + run_mm, 10), (0, 10))]
    faces = [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)]
    faces += [f for i in range(4) for j in [(i + 1) % 4] for f in [(i, 4 + i, 4 + j), (i, 4 + j, j)]]
    return Solid.from_arrays(vertices, faces)


def test_price_of_a_cube_equals_a_manual_calculation() -> None:
    cost = CostModel(7.0, 0.5, 0.25, 2.0, 50.0, 100.0, 3.0, 11.0, brim_mm=8.0)
    ring_mm2 = 8.0 * (2.0 * 20.0 + math.pi * 8.0)
    body_s = max(0.5 * 1000.0 + 0.25 * 400.0, 11.0 * 10.0)
    expected_s = 7.0 + body_s + 2.0 * 200.0 + 3.0 * ring_mm2
    times_s = price_axis_poses_s(*Solid.box((5, 5, 5), (15, 15, 15)).arrays(), cost)
    assert times_s == pytest.approx([expected_s] * 6)  # its underside lies on the bed, so it needs no support


def test_needle_takes_the_minimum_time_of_its_layers() -> None:
    cost = CostModel.from_settings(PrintTimeSettings(min_layer_s=5.0))
    needle, block = Solid.box((0, 0, 0), (3, 3, 60)), Solid.box((0, 0, 0), (60, 60, 60))
    unlimited_cost = replace(cost, min_s_per_mm=0.0)
    upright_rotation = POSE_ROTATIONS[4:5]
    body_s = cost.volume_s_per_mm3 * 540.0 + cost.lateral_s_per_mm2 * 720.0 * (1.0 - MAX_INSET_SHARE)
    delay_s = price_poses_s(*needle.arrays(), upright_rotation, cost) - price_poses_s(
        *needle.arrays(), upright_rotation, unlimited_cost
    )
    assert delay_s[0] == pytest.approx(5.0 * 60.0 / 0.25 - body_s)
    assert price_axis_poses_s(*block.arrays(), cost) == pytest.approx(
        price_axis_poses_s(*block.arrays(), unlimited_cost)
    )


def test_walls_inside_the_outline_are_shorter() -> None:
    """Use a block of 40 mm, whose two wall loops are squares of 39.6 and 38.8 mm."""
    settings = PrintTimeSettings(layer_height_mm=0.2, line_width_mm=0.4, outer_line_width_mm=0.4)
    walls = compute_time_terms(settings)["walls"][
        [FEATURES.index("lateral_mm2"), FEATURES.index("height_mm")]
    ]
    assert walls @ (4.0 * 40.0 * 10.0, 10.0) == pytest.approx(50.0 * 4.0 * (39.6 / 40.0 + 38.8 / 50.0))


def test_first_layers_of_a_skin_on_the_bed_have_their_own_speed() -> None:
    settings = PrintTimeSettings(
        skin_layer_count=4.0, skin_line_width_mm=0.4, skin_mm_s=20.0, brim_mm_s=30.0, slow_layer_count=2
    )
    bed_layers_s_per_mm, upper_layers_s_per_mm = 1.0 / 30.0 + 1.0 / 25.0 + 2.0 / 20.0, 4.0 / 20.0
    assert settings.skin_s_per_mm2 == pytest.approx((bed_layers_s_per_mm + upper_layers_s_per_mm) / 2.0 / 0.4)


def test_uppermost_layer_of_a_top_has_its_own_lines_and_speed() -> None:
    settings = PrintTimeSettings(
        skin_layer_count=4.0,
        skin_line_width_mm=0.5,
        skin_mm_s=40.0,
        brim_mm_s=40.0,
        roof_layer_count=1,
        roof_line_width_mm=0.4,
        roof_mm_s=25.0,
    )
    assert settings.skin_s_per_mm2 == pytest.approx((4.0 / 20.0 + 3.0 / 20.0 + 1.0 / 10.0) / 2.0)
    hidden_settings = replace(settings, saved_bed_layer_count=2.0, saved_top_layer_count=1.0)
    assert hidden_settings.hidden_bed_share * settings.skin_s_per_mm2 == pytest.approx(2.0 / 20.0)
    # A hidden top saves one layer and the roof.
    assert hidden_settings.hidden_top_share * settings.skin_s_per_mm2 == pytest.approx(
        1.0 / 20.0 + 1.0 / 20.0
    )
    assert settings.hidden_top_share * settings.skin_s_per_mm2 == pytest.approx(1.0 / 20.0)
    assert replace(settings, skin_layer_count=0.0).hidden_top_share == 0.0


def test_ends_of_skin_lines_take_the_same_time_above_a_speed_limit() -> None:
    slopes_s = [
        compute_time_terms(PrintTimeSettings(skin_mm_s=speed_mm_s))["slope ends"].max()
        for speed_mm_s in (15.0, 30.0, 50.0)
    ]
    assert slopes_s[1:] == pytest.approx([2.0 * slopes_s[0]] * 2)


@pytest.mark.parametrize(("steps", "extra_mm"), [(0, 0.0), (1, 2.0 * 0.125), (2, 2.0 * (0.1875 + 0.0625))])
def test_infill_gets_sparser_below_the_tops(steps, extra_mm):
    """Use lines 4 mm apart, whose number is halved by each step of 2 mm in height."""
    settings = PrintTimeSettings(
        infill_line_distance_mm=4.0, infill_step_count=steps, infill_step_mm=2.0, skin_layer_count=0.0
    )
    even_settings = replace(settings, infill_line_distance_mm=4.0 * 2.0**steps, infill_step_count=0)
    infill_terms, even_terms = (
        compute_time_terms(settings)["infill"],
        compute_time_terms(even_settings)["infill"],
    )
    skin = FEATURES.index("skin_mm2")
    assert infill_terms[:skin] == pytest.approx(even_terms[:skin])
    tops_s = extra_mm / (settings.layer_height_mm * settings.infill_mm_s)
    assert 2.0 * (infill_terms - even_terms)[skin] == pytest.approx(tops_s)


def test_walls_cover_the_rim_of_a_skin() -> None:
    cost = make_cost(skin_s_per_mm2=1.0, skin_rim_s_per_mm=4.0)
    large_block, small_block = Solid.box((0, 0, 0), (50, 50, 1)), Solid.box((0, 0, 0), (2, 2, 1))
    upright_rotation = POSE_ROTATIONS[4:5]
    assert price_poses_s(*large_block.arrays(), upright_rotation, cost)[0] == pytest.approx(
        5000.0 - 4.0 * math.sqrt(5000.0)
    )
    assert price_poses_s(*small_block.arrays(), upright_rotation, cost)[0] == 0.0


def test_only_overhangs_above_the_bed_need_support() -> None:
    cost = make_cost(overhang_s_per_mm3=1.0)
    table = Solid.union([Solid.box((0, 0, 0), (10, 10, 30)), Solid.box((0, 0, 30), (40, 10, 35))])
    times_s = price_axis_poses_s(*table.arrays(), cost)
    assert times_s[4] == pytest.approx(30.0 * 10.0 * 30.0)  # upright: 300 mm2, 30 mm above the bed
    assert times_s[5] == pytest.approx(0.0)  # upside down
    assert times_s[2] == times_s[3] == pytest.approx(0.0)  # on its side


def test_slopes_up_to_45_degrees_need_no_support() -> None:
    cost = make_cost(overhang_s_per_mm3=1.0)
    assert price_axis_poses_s(*make_wedge(9.9).arrays(), cost)[4] == 0.0
    assert price_axis_poses_s(*make_wedge(10.1).arrays(), cost)[4] == pytest.approx(
        5.0 * 10.1 * 5.0, rel=0.01
    )


def test_slope_has_skin_if_its_steps_are_wider_than_the_walls() -> None:
    settings = PrintTimeSettings(layer_height_mm=0.2, skin_layer_count=4.0, wall_count=2, line_width_mm=0.35)
    cost = replace(make_cost(slope_s_per_mm2=1.0), skin_cos=settings.skin_cos)
    # At this slope (height over width), a step of 4 layers is exactly as wide as the walls.
    max_slope = 4 * 0.2 / (2 * 0.35 + 0.35 / 2)
    for run_mm, has_skin in ((10.0 / max_slope - 0.1, False), (10.0 / max_slope + 0.1, True)):
        assert (price_axis_poses_s(*make_wedge(run_mm).arrays(), cost)[4] > 0.0) == has_skin


@pytest.mark.parametrize(
    ("change", "term", "ratio"),
    [
        ({"infill_line_distance_mm": 14.0}, "infill", 0.5),
        ({"infill_line_distance_mm": 14.0}, "infill ends", 0.5),
        ({"support_line_distance_mm": 2 * 2.333}, "support to bed", 0.5),
        ({"support_line_distance_mm": 2 * 2.333}, "support", 0.5),
        ({"support_line_distance_mm": 2 * 2.333}, "support sides", 1.0),
        ({"layer_height_mm": 0.125}, "infill", 2.0),
        ({"layer_height_mm": 0.125}, "walls", 2.0),
        ({"layer_height_mm": 0.125}, "support", 2.0),
        ({"layer_height_mm": 0.125}, "brim", 1.0),
        ({"outer_wall_mm_s": 20.0, "inner_wall_mm_s": 25.0}, "walls", 2.0),
        ({"skin_mm_s": 15.0, "brim_mm_s": 15.0}, "skin", 2.0),
        ({"skin_mm_s": 15.0, "slow_layer_count": 0}, "skin", 2.0),
        ({"skin_mm_s": 15.0, "slow_layer_count": 0}, "skin rim", 2.0),
        ({"first_line_ratio": 1.25}, "skin", 1.0 - 0.2 * 0.5 / 3.0),  # one of three layers, at the bed
        ({"is_infill_connected": False}, "infill ends", 2.0),
        ({"skin_layer_count": 6.0}, "skin", 2.0),
        ({"travel_mm_s": 75.0}, "travel", 2.0),
        ({"acceleration_mm_s2": 1500.0}, "slope ends", 2.0),
        ({"is_skin_connected": True}, "slope ends", SLOPE_TURN_TIME_SHARE),
        ({"is_skin_connected": True}, "rim ends", RIM_TURN_TIME_SHARE),
        ({"is_infill_connected": False}, "connections", 0.0),
        ({"infill_line_distance_mm": 0.0}, "infill", 0.0),
        ({"support_line_distance_mm": 0.0}, "support", 0.0),
        ({"support_line_distance_mm": 0.0}, "support sides", 0.0),
    ],
)
def test_changed_setting_scales_its_time_term(change: dict[str, float], term: str, ratio: float) -> None:
    old_terms, new_terms = (
        compute_time_terms(PrintTimeSettings())[term],
        compute_time_terms(replace(PrintTimeSettings(), **change))[term],
    )
    # The skin's share of the infill volume depends on the layer height.
    compared_features = slice(0, 2) if term == "infill" else slice(None)
    assert new_terms[compared_features] == pytest.approx(old_terms[compared_features] * ratio)


def test_brim_time_follows_from_line_width_and_speed() -> None:
    slow_settings = PrintTimeSettings(outer_line_width_mm=0.5, brim_mm_s=10.0)
    assert CostModel.from_settings(
        slow_settings, dict.fromkeys(FACTORS, 1.0)
    ).brim_s_per_mm2 == pytest.approx(0.2)


def test_every_term_has_a_factor() -> None:
    assert set(compute_time_terms(PrintTimeSettings())) == set(FACTORS)
    assert all(len(vector) == len(FEATURES) for vector in compute_time_terms(PrintTimeSettings()).values())


@settings(max_examples=25, deadline=None)
@given(turns_rad=st.tuples(*[st.floats(-math.pi, math.pi)] * 3), cut_mm=st.floats(-30.0, 60.0))
def test_additive_features_add_up_over_a_cut(
    turns_rad: tuple[float, float, float], cut_mm: float, ring_with_bar: Solid, cost: CostModel
) -> None:
    """Compare two halves with the whole plus both cut faces, which are walls or skin by their slope."""
    rotations = Rotation.from_euler("xyz", [turns_rad]).as_matrix()
    halves = ring_with_bar.split(0, cut_mm)
    features, _ = sum_pose_features(*ring_with_bar.arrays(), rotations, cost)
    halves_features = sum(sum_pose_features(*half.arrays(), rotations, cost)[0] for half in halves)
    cut_mm2 = (sum(half.area_mm2 for half in halves) - ring_with_bar.area_mm2) / 2.0
    n = abs(float(rotations[0, 2, 0]))
    vertical_share = math.sqrt(1.0 - n * n)
    added_features = (
        np.array([0.0, vertical_share, n * (n > cost.skin_cos), vertical_share * (n > cost.skin_cos)])
        * 2.0
        * cut_mm2
    )
    assert halves_features[0, :4] == pytest.approx(features[0, :4] + added_features, rel=1e-6, abs=1e-3)


@settings(max_examples=25, deadline=None)
@given(
    turns_rad=st.tuples(*[st.floats(-math.pi, math.pi)] * 6), shift_mm=st.tuples(*[st.floats(-1e3, 1e3)] * 3)
)
def test_rotating_part_and_bed_together_changes_no_price(
    turns_rad: tuple[float, ...], shift_mm: tuple[float, float, float], ring_with_bar: Solid, cost: CostModel
) -> None:
    vertices, faces = ring_with_bar.arrays()
    pose, motion = Rotation.from_euler("xyz", [turns_rad[:3], turns_rad[3:]]).as_matrix()
    features, extents = sum_pose_features(vertices, faces, pose[None], cost)
    moved_features, turned_extents = sum_pose_features(
        vertices @ motion.T + shift_mm, faces, (pose @ motion.T)[None], cost
    )
    # A face exactly at the angle where skin or support begins may be on either side of it.
    assert moved_features == pytest.approx(features, rel=2e-3)
    assert turned_extents == pytest.approx(extents, abs=1e-6)


def test_axis_poses_are_priced_like_other_rotations(ring_with_bar: Solid, cost: CostModel) -> None:
    vertices, faces = ring_with_bar.arrays()
    assert np.linalg.det(POSE_ROTATIONS) == pytest.approx([1.0] * 6)
    for pose, rotation in enumerate(POSE_ROTATIONS):
        assert rotation[2, find_pose_axes(pose)[2]] == (-1.0 if pose % 2 else 1.0)
    turned_prices_s = price_axis_poses_s(vertices @ POSE_ROTATIONS[0].T, faces, cost)
    assert turned_prices_s[4] == pytest.approx(price_axis_poses_s(vertices, faces, cost)[0])


def test_features_are_returned_in_the_order_of_the_poses(ring_with_bar: Solid, cost: CostModel) -> None:
    rotations = Rotation.random(40, random_state=3).as_matrix()
    features, _ = sum_pose_features(*ring_with_bar.arrays(), rotations, cost)
    assert features.shape == (40, len(ADDITIVE_FEATURES))
    for i in (0, 17, 39):
        single_features, _ = sum_pose_features(*ring_with_bar.arrays(), rotations[i : i + 1], cost)
        assert features[i] == pytest.approx(single_features[0])


def test_part_may_be_turned_about_the_vertical_only() -> None:
    printer = TargetPrinter("p", ((200.0, 100.0, 50.0),))
    assert printer.fits(200.0, 100.0, 50.0)
    assert printer.fits(100.0, 200.0, 50.0)
    assert not printer.fits(100.0, 50.0, 200.0)
    assert sorted(find_pose_axes(3)) == [0, 1, 2]
    assert find_pose_axes(3)[2] == 1


def test_compiled_code_reads_prices_by_name() -> None:
    """Check that an added or moved field does not change any price."""
    cost = CostModel.from_settings(PrintTimeSettings())
    additive, extents = (9e4, 2e4, 5e3, 300.0, 1e4), (60.0, 50.0, 40.0)
    values = {"another": 7.0} | dict(reversed(asdict(cost).items()))
    dtype = np.dtype([(name, np.float64) for name in values])
    moved_prices = np.array([tuple(values.values())], dtype=dtype)[0]
    assert compute_price_s(moved_prices, additive, extents) == cost.price_part_s(additive, extents)


def test_inner_walls_of_each_body_are_shorter() -> None:
    """Use four posts, each of which shortens the inner walls equally, up to a share of all walls."""
    cost = CostModel.from_settings(PrintTimeSettings(min_layer_s=0.0))
    lateral_mm2, height_mm = 4.0 * 4.0 * 30.0 * 50.0, 50.0
    assert cost.price_insets_s(lateral_mm2, height_mm, 0.0) == 0.0
    assert cost.price_insets_s(lateral_mm2, height_mm, 3.0 * height_mm) == pytest.approx(
        3.0 * cost.inset_s_per_mm * height_mm
    )
    max_saving_s = 0.1 * cost.lateral_s_per_mm2 * lateral_mm2
    assert cost.price_insets_s(lateral_mm2, height_mm, 1e6) == pytest.approx(
        max_saving_s - cost.inset_s_per_mm * height_mm
    )


@pytest.mark.parametrize("layer_mm", [0.24, 0.26])
def test_price_of_a_part_follows_the_layers_that_are_fitted_to_its_height(layer_mm: float):
    """Compare with settings that have these layers for all parts, for a block with an overhang."""
    block = Solid.union([Solid.box((0, 0, 0), (40, 40, 60)), Solid.box((0, 0, 40), (60, 40, 60))])
    vertices, faces = block.arrays()
    is_cut = np.zeros(len(faces), np.bool_)
    settings = PrintTimeSettings(support_angle_deg=50.0)
    fitted_settings = replace(settings, fit_layer_mm={60.0: layer_mm}.__getitem__)
    plain_s, fitted_s, expected_s = (
        measure_pose(vertices, faces, is_cut, np.eye(3), CostModel.from_settings(s)).price_s
        for s in (settings, fitted_settings, replace(settings, layer_height_mm=layer_mm))
    )
    assert fitted_s == pytest.approx(expected_s, rel=0.002)
    assert (fitted_s - plain_s) * (0.25 - layer_mm) > 0.02 * plain_s * abs(0.25 - layer_mm)
