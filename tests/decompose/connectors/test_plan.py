"""Positions of pins and marks on boxes whose joints are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from random import Random

import numpy as np
import pytest
import shapely
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from decompose.assembly import plan_assembly
from decompose.connectors import (
    Blank,
    Connectors,
    drill_parts,
    find_pairs,
    measure_pair,
    plan_connectors,
)
from decompose.connectors.pair_shapes import PairShapes
from decompose.connectors.pins import choose_depths_mm
from decompose.connectors.pins.placer import MIN_DISTANCE_DIFFERENCE_MM
from decompose.geometry import Solid
from decompose.options import ConnectorOptions, PairShape
from decompose.pieces import Piece, find_joints, list_box_planes
from decompose.results.connector_rules import DrilledParts, find_wrong_fits

ALL_CONNECTORS = ConnectorOptions(2.85, 0.4, marks=True)
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)  # shrinking takes minutes
UPRIGHT_AXIS = np.array([0.0, 0.0, 1.0])
LEANING_AXIS = np.array([0.0, 0.6, -0.8])  # level faces can have holes in this pose, but no grooves
Span = tuple[tuple[float, ...], tuple[float, ...]]


def make_boxes(*spans: Span) -> list[Piece]:
    return [
        Piece(Solid.box(lo, hi), list_box_planes(np.array([lo, hi], dtype=np.float64)), np.array([[lo, hi]]))
        for lo, hi in spans
    ]


def is_alike(shape: PairShape, other: PairShape, max_difference_mm: float) -> bool:
    angles = [None if angle is None else np.array([[angle]]) for angle in shape.angles]
    shapes = PairShapes(np.array([[shape.distance_mm]]), (angles[0], angles[1]), shape.lengths_mm)
    return bool(shapes.find_alike(other, max_difference_mm).any())


def plan_and_drill(
    pieces: Sequence[Piece],
    up_axes: Sequence[np.ndarray] | None = None,
    options: ConnectorOptions = ALL_CONNECTORS,
) -> tuple[Connectors, DrilledParts]:
    """Plan connectors, drill the parts, and check that no rule is broken."""
    joints = find_joints(pieces)
    assembly = plan_assembly(pieces, joints)
    up_axes = up_axes or [UPRIGHT_AXIS] * len(pieces)
    blanks = [
        Blank(str(n), p.solid, up_axis) for n, (p, up_axis) in enumerate(zip(pieces, up_axes, strict=True), 1)
    ]
    connectors = plan_connectors(blanks, joints, assembly, options, 25.0)
    parts = DrilledParts(blanks, drill_parts(blanks, connectors), joints, assembly.steps, connectors)
    assert list(parts.find_faults()) == []
    return connectors, parts


HALVES = make_boxes(((0, 0, 0), (60, 40, 20)), ((0, 0, 20), (60, 40, 50)))


def test_two_halves_get_a_long_and_a_short_key_in_opposite_corners():
    connectors, _ = plan_and_drill(HALVES)
    long_key, short_key = connectors.pins
    assert long_key.key_direction is not None and short_key.key_direction is not None
    assert long_key.length_mm > short_key.length_mm + 2.0
    assert measure_pair(long_key, short_key).distance_mm > 0.7 * np.hypot(60.0, 40.0)
    assert not connectors.unpinned_steps and not connectors.unmarked_joints


def test_halves_that_lean_get_a_deep_and_a_shallow_pin_in_opposite_corners():
    connectors, _ = plan_and_drill(HALVES, [LEANING_AXIS, UPRIGHT_AXIS])
    deep_pin, shallow_pin = connectors.pins
    assert deep_pin.key_direction is None and shallow_pin.key_direction is None
    assert deep_pin.depth_mm > shallow_pin.depth_mm + 2.0
    assert measure_pair(deep_pin, shallow_pin).distance_mm > 0.75 * np.hypot(60.0, 40.0)
    assert [deep_pin.position_mm[2], shallow_pin.position_mm[2]] == pytest.approx([20.0, 20.0])
    assert not connectors.unpinned_steps


def test_marks_are_readable_from_outside_and_their_arrows_agree():
    connectors, _ = plan_and_drill(make_boxes(((0, 0, 0), (30, 60, 60)), ((30, 0, 0), (60, 60, 60))))
    assert [mark.text for mark in connectors.marks] == ["1-2^", "2-1^"]
    for mark, outward in zip(connectors.marks, (1.0, -1.0), strict=True):
        right_direction = np.cross(UPRIGHT_AXIS, [outward, 0.0, 0.0])
        ends = mark.lines_mm @ right_direction
        assert ends[0].max() < ends[-1].min()  # the first digit is left of the arrow
        wings_mm = mark.lines_mm[-2:]
        tip_mm = max(wings_mm[0], key=lambda end: end[2])
        assert all(np.linalg.norm(wing_mm - tip_mm, axis=1).min() < 1e-9 for wing_mm in wings_mm)
        assert wings_mm[..., 2].max() == pytest.approx(tip_mm[2])


def test_only_upright_faces_have_a_gutter_inside_their_rim():
    connectors, _ = plan_and_drill(make_boxes(((0, 0, 0), (30, 60, 60)), ((30, 0, 0), (60, 60, 60))))
    assert [(gutter.part, gutter.joint) for gutter in connectors.gutters] == [(0, 0), (1, 0)]
    for gutter in connectors.gutters:
        start, end = gutter.line_mm
        assert start[:2] == pytest.approx(end[:2]) and start[0] == pytest.approx(30.0)
        assert start[2] > 1.7 and end[2] < 58.3 and end[2] - start[2] > 30.0
    assert plan_and_drill(HALVES)[0].gutters == ()


def test_arrow_of_a_turned_text_still_points_up():
    narrow_boxes = make_boxes(((0, 0, 0), (30, 12, 70)), ((30, 0, 0), (60, 12, 70)))
    connectors, _ = plan_and_drill(narrow_boxes, options=ConnectorOptions(marks=True))
    mark = connectors.marks[0]
    assert np.ptp(mark.lines_mm[..., 2]) > 8.0  # the text runs upwards
    wings_mm = mark.lines_mm[-2:]
    tip_mm = wings_mm[0][wings_mm[0][:, 2].argmax()]
    assert all(np.linalg.norm(wing_mm - tip_mm, axis=1).min() < 1e-9 for wing_mm in wings_mm)
    assert np.ptp(wings_mm[..., 1]) == pytest.approx(2.0 * np.ptp(wings_mm[..., 2]))


def test_missing_pins_and_digits_of_a_thin_joint_are_reported():
    connectors, parts = plan_and_drill(make_boxes(((0, 0, 0), (60, 40, 3)), ((60, 0, 0), (120, 40, 3))))
    assert not connectors.pins and not connectors.tools
    assert [reason for _, reason in connectors.unpinned_steps] == ["too small for a pin"]
    assert [reason for _, reason in connectors.unmarked_joints] == ["too small"]
    assert parts.drilled_solids[0].volume_mm3 == pytest.approx(7200.0)


def test_small_joint_is_marked_by_the_same_dots_on_both_faces():
    connectors, _ = plan_and_drill(make_boxes(((0, 0, 0), (30, 7, 7)), ((30, 0, 0), (60, 7, 7))))
    texts = [mark.text for mark in connectors.marks]
    assert texts == [".", "."]


@pytest.mark.parametrize(("up", "rim_mm"), [(UPRIGHT_AXIS, 0.0), (LEANING_AXIS, 2.0)])
def test_keys_and_pins_avoid_a_hollow_below_a_joint(up: np.ndarray, rim_mm: float):
    lower_half, upper_half = HALVES
    hollow = Solid.box((10, 5, 2), (58, 38, 17.5))
    lower_half = Piece(lower_half.solid.subtract(hollow), lower_half.planes, lower_half.boxes_mm)
    connectors, _ = plan_and_drill([lower_half, upper_half], [up, UPRIGHT_AXIS])
    hollow_area = shapely.box(10.0, 5.0, 58.0, 38.0).buffer(rim_mm - 1e-6)
    assert connectors.pins
    assert not any(hollow_area.contains(shapely.Point(pin.position_mm[:2])) for pin in connectors.pins)


def test_face_that_leans_over_in_its_pose_is_not_marked():
    connectors, _ = plan_and_drill(HALVES, [LEANING_AXIS, UPRIGHT_AXIS])
    assert {mark.part for mark in connectors.marks} == {1}
    assert connectors.unmarked_joints == ((0, "a face overhangs in its part's pose"),)
    assert len(connectors.pins) == 2  # their holes have a roof that follows the pose


@pytest.mark.parametrize("up", [UPRIGHT_AXIS, LEANING_AXIS])
def test_large_joint_has_pins_or_keys_near_all_of_its_glue(up: np.ndarray):
    connectors, _ = plan_and_drill(
        make_boxes(((0, 0, 0), (200, 200, 30)), ((0, 0, 30), (200, 200, 60))), [up, UPRIGHT_AXIS]
    )
    points_mm = np.array([pin.position_mm[:2] for pin in connectors.pins])
    grid = np.array(np.meshgrid(np.arange(2.5, 200, 5), np.arange(2.5, 200, 5))).reshape(2, -1).T
    is_near = np.linalg.norm(grid[:, None] - points_mm, axis=2).min(axis=1) < 60.0
    assert is_near.mean() >= 0.95
    assert connectors.pins[1].is_slotted == (up is LEANING_AXIS)


def test_slide_gets_pins_only_along_its_direction():
    wheel = make_boxes(
        ((0, 0, 0), (80, 40, 40)),
        ((80, 0, 0), (120, 80, 40)),
        ((40, 80, 0), (120, 120, 40)),
        ((0, 40, 0), (40, 120, 40)),
        ((40, 40, 0), (80, 80, 40)),
    )
    connectors, parts = plan_and_drill(wheel)
    for pin in connectors.pins:
        assert abs(pin.axis @ parts.steps[pin.step].direction) == pytest.approx(1.0)
    assert len(connectors.pins) >= 2


def cut_at_random(random: Random, cuts: int) -> list[Piece]:
    """Cut a box into boxes at random planes."""
    spans = [(np.zeros(3), np.array([90.0, 80.0, 70.0]))]
    for _ in range(cuts):
        lo, hi = spans.pop(random.randrange(len(spans)))
        axis = random.randrange(3)
        at_mm = lo[axis] + (hi[axis] - lo[axis]) * random.uniform(0.3, 0.7)
        lower_end, upper_start = hi.copy(), lo.copy()
        lower_end[axis] = upper_start[axis] = at_mm
        spans += [(lo, lower_end), (upper_start, hi)]
    return make_boxes(*((tuple(lo), tuple(hi)) for lo, hi in spans))


def test_pin_that_gives_way_to_another_pair_stays_in_its_plane():
    random = Random(34)
    connectors, parts = plan_and_drill(cut_at_random(random, random.randint(2, 5)))
    for pin in connectors.pins:
        faces = parts.joints[pin.joint].faces
        assert min(abs(float(pin.position_mm @ face.normal) - face.offset_mm) for face in faces) < 1e-6


@settings(deadline=None, max_examples=6, phases=PHASES)
@given(st.randoms(use_true_random=False), st.integers(2, 5))
def test_random_partitions_break_no_rule_and_no_two_pairs_are_alike(random: Random, cuts: int) -> None:
    pieces = cut_at_random(random, cuts)
    connectors, _ = plan_and_drill(pieces)
    shapes = [measure_pair(*pair) for pair in find_pairs(connectors.pins).values()]
    for shape, other in combinations(shapes, 2):
        assert not is_alike(shape, other, 2.0 * ALL_CONNECTORS.pin_fit_mm + MIN_DISTANCE_DIFFERENCE_MM)
    steps = len(pieces) - 1
    assert (
        len({pin.step for pin in connectors.pins} | {step for step, _ in connectors.unpinned_steps}) == steps
    )


def test_level_faces_name_only_the_neighbour_and_each_part_has_its_number_once():
    connectors, _ = plan_and_drill(HALVES)
    assert [mark.text for mark in connectors.marks] == ["-2^", "-1^", "1", "2"]


@pytest.mark.parametrize(
    ("pin_mm", "deep_mm", "shallow_mm"), [(1.75, 5.5, 2.5), (2.85, 6.0, 3.0), (6.0, 9.5, 6.5)]
)
def test_body_turned_around_does_not_close_with_pins_of_any_diameter(
    pin_mm: float, deep_mm: float, shallow_mm: float
):
    assert choose_depths_mm(pin_mm) == (deep_mm, shallow_mm)
    connectors, _ = plan_and_drill(HALVES, [LEANING_AXIS, UPRIGHT_AXIS], ConnectorOptions(pin_mm))
    assert find_wrong_fits(connectors.pins) == [] and len(connectors.pins) == 2


@pytest.mark.parametrize("up", [UPRIGHT_AXIS, LEANING_AXIS])
def test_pair_avoids_a_shape_that_is_taken(up: np.ndarray):
    free_shape = measure_pair(*plan_and_drill(HALVES, [up, UPRIGHT_AXIS])[0].pins)
    near_shape = free_shape._replace(distance_mm=free_shape.distance_mm - 1.6)
    options = replace(ALL_CONNECTORS, used_shapes=(free_shape, near_shape))
    connectors, _ = plan_and_drill(HALVES, [up, UPRIGHT_AXIS], options)
    assert find_wrong_fits(connectors.pins, options.used_shapes) == []
    assert find_wrong_fits(connectors.pins, (measure_pair(*connectors.pins),)) == [
        "a body of step 1 fits a neighbour that is printed already"
    ]


def test_thin_wall_takes_pins_whose_roof_points_along_it():
    """Use a wall thinner than the circle around a hole; a roof makes a hole higher than wide."""
    walls = make_boxes(((0, 0, 0), (60, 6.4, 60)), ((60, 0, 0), (120, 6.4, 60)))
    connectors, _ = plan_and_drill(walls, options=ConnectorOptions(2.85))
    assert len(connectors.pins) == 2 and not connectors.unpinned_steps


def test_each_step_of_a_row_of_equal_small_parts_has_a_pair_of_its_own() -> None:
    """Use faces with space for about nine distances between two pins, for 19 steps."""
    row = make_boxes(*(((24.0 * n, 0, 0), (24.0 * (n + 1), 24, 24)) for n in range(20)))
    connectors, _ = plan_and_drill(row, options=ConnectorOptions(2.85))
    assert len(find_pairs(connectors.pins)) == 19


def test_face_without_space_for_distant_keys_has_two_close_ones() -> None:
    halves = make_boxes(((0, 0, 0), (12, 12, 20)), ((0, 0, 20), (12, 12, 40)))
    connectors, _ = plan_and_drill(halves, options=ConnectorOptions(2.85))
    [pair] = find_pairs(connectors.pins).values()
    assert 7.0 <= measure_pair(*pair).distance_mm < 12.0
