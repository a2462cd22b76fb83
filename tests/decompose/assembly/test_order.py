"""Order of assembly: boxes by planes, a pinwheel by a slide, loose and locked bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.assembly import Assembly, find_order_faults, plan_assembly
from decompose.geometry import Solid
from decompose.pieces import Piece, cut_box, find_joints, list_box_planes, rotate_planes

Span = tuple[tuple[float, float, float], tuple[float, float, float]]


def make_boxes(*spans: Span) -> list[Piece]:
    """Make boxes as pieces that were cut at all their faces."""
    return [
        Piece(Solid.box(lo, hi), list_box_planes(np.array([lo, hi], dtype=np.float64)), np.array([[lo, hi]]))
        for lo, hi in spans
    ]


def plan_and_check(pieces: Sequence[Piece]) -> Assembly:
    """Plan an assembly, and check by a replay that its steps can be executed."""
    joints = find_joints(pieces)
    assembly = plan_assembly(pieces, joints)
    assert find_order_faults([piece.solid for piece in pieces], joints, assembly) == []
    glued_joints = [joint for step in assembly.steps for joint in step.joints]
    if not assembly.locked_sets:
        assert sorted(glued_joints) == list(range(len(joints)))
    return assembly


def test_assembly_of_two_halves_moves_the_lighter_one():
    [step] = plan_and_check(make_boxes(((0, 0, 0), (60, 40, 20)), ((0, 0, 20), (60, 40, 30)))).steps
    assert (step.moved_parts, step.fixed_parts) == ((1,), (0,))
    assert step.direction == pytest.approx([0, 0, 1])
    assert step.glue_mm2 == pytest.approx(2400.0)
    assert not step.slides and step.rests_on == (0,)


def test_sub_assemblies_are_glued_side_by_side():
    cells = [((x, y, 0.0), (x + 30.0, y + 30.0, 20.0)) for x in (0.0, 30.0) for y in (0.0, 30.0)]
    assembly = plan_and_check(make_boxes(*cells))
    assert [step.level for step in assembly.steps] == [1, 1, 2]
    assert {len(step.joints) for step in assembly.steps[:2]} == {1}


def make_pinwheel() -> list[Piece]:
    """Make four bricks around a central one, without a plane through all of them."""
    return make_boxes(
        ((0, 0, 0), (40, 20, 20)),
        ((40, 0, 0), (60, 40, 20)),
        ((20, 40, 0), (60, 60, 20)),
        ((0, 20, 0), (20, 60, 20)),
        ((20, 20, 0), (40, 40, 20)),
    )


def test_pinwheel_is_closed_by_slides():
    assembly = plan_and_check(make_pinwheel())
    assert len(assembly.steps) == 4 and not assembly.locked_sets
    assert any(step.slides for step in assembly.steps)


def test_pinwheel_slides_along_one_face():
    """Expect one brick to be taken off first, because every other split slides along more faces."""
    pieces = make_pinwheel()
    [sliding_step] = [step for step in plan_and_check(pieces).steps if step.slides]
    joints = find_joints(pieces)
    sliding_faces = [
        face
        for number in sliding_step.joints
        for face in joints[number].faces
        if abs(float(face.normal @ sliding_step.direction)) < 0.5
    ]
    assert [face.area_mm2 for face in sliding_faces] == pytest.approx([400.0])


def test_box_in_a_hollow_is_inserted_before_the_shell_is_closed():
    shell = Solid.box((0, 0, 0), (60, 60, 60)).subtract(Solid.box((10, 10, 10), (50, 50, 50)))
    halves = [
        piece
        for lo, hi in ((-9.0, 30.0), (30.0, 99.0))
        for piece in cut_box(shell, (-9, -9, lo), (99, 99, hi))
    ]
    loose_box = make_boxes(((20, 20, 20), (40, 40, 40)))
    assembly = plan_and_check([*halves, *loose_box])
    first_step, second_step = assembly.steps
    assert first_step.joints == () and 2 in (*first_step.moved_parts, *first_step.fixed_parts)
    assert len(second_step.joints) == 1


def test_bodies_that_stand_apart_need_no_step_between_them():
    pair = ((0.0, 0.0, 0.0), (20.0, 20.0, 20.0)), ((20.0, 0.0, 0.0), (40.0, 20.0, 20.0))
    second_pair = ((100.0, 0.0, 0.0), (120.0, 20.0, 20.0)), ((120.0, 0.0, 0.0), (140.0, 20.0, 20.0))
    assembly = plan_and_check(make_boxes(*pair, *second_pair))
    assert sorted(sorted((*step.moved_parts, *step.fixed_parts)) for step in assembly.steps) == [
        [0, 1],
        [2, 3],
    ]


def test_linked_rings_are_reported_as_locked():
    ring = Solid.box((0, 0, 0), (60, 60, 10)).subtract(Solid.box((15, 15, -1), (45, 45, 11)))
    rotation = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    link = ring.rotate(rotation).translate(np.array([30.0, 30.0, -25.0]))
    rings = [
        Piece(ring, np.zeros((0, 4)), np.zeros((0, 2, 3))),
        Piece(link, np.zeros((0, 4)), np.zeros((0, 2, 3))),
    ]
    assembly = plan_assembly(rings, find_joints(rings))
    assert assembly.locked_sets == ((0, 1),) and not assembly.steps


def test_two_ears_above_a_plane_are_joined_one_by_one():
    head = Solid.box((0, 0, 0), (100, 30, 30))
    eared_head = Solid.union(
        [head, Solid.box((0, 0, 30), (20, 30, 60)), Solid.box((80, 0, 30), (100, 30, 60))]
    )
    pieces = [
        piece
        for lo, hi in ((-9.0, 30.0), (30.0, 99.0))
        for piece in cut_box(eared_head, (-9, -9, lo), (999, 99, hi))
    ]
    assembly = plan_and_check(pieces)
    assert [len(step.moved_parts) for step in assembly.steps] == [1, 1]


def test_body_that_would_fall_over_is_held():
    [step] = plan_and_check(make_boxes(((0, 0, 0), (3, 3, 25)), ((0, 0, 25), (3, 3, 50)))).steps
    assert step.rests_on == ()


def test_thin_plate_in_a_thin_box_is_inserted_before_the_box_is_closed():
    """Use a long path on which the plate would pass through the floor only in the last millimetres."""
    box = Solid.box((0, 0, 0), (60, 60, 120)).subtract(Solid.box((2, 2, 2), (58, 58, 118)))
    halves = [
        piece
        for lo, hi in ((-9.0, 110.0), (110.0, 999.0))
        for piece in cut_box(box, (-9, -9, lo), (99, 99, hi))
    ]
    first_step, second_step = plan_and_check([*halves, *make_boxes(((5, 5, 100), (55, 55, 102)))]).steps
    assert first_step.joints == () and 2 in (*first_step.moved_parts, *first_step.fixed_parts)
    assert len(second_step.joints) == 1


def test_replay_reports_a_step_in_the_wrong_direction():
    pieces = make_pinwheel()
    assembly, joints, solids = plan_and_check(pieces), find_joints(pieces), [piece.solid for piece in pieces]
    last_step = assembly.steps[-1]
    wrong_step = replace(last_step, direction=-last_step.direction)
    steps = (*assembly.steps[:-1], wrong_step)
    assert any("runs into" in fault for fault in find_order_faults(solids, joints, Assembly(steps)))


@pytest.mark.parametrize("missing_step", range(4))
def test_replay_reports_a_step_that_is_missing(missing_step: int):
    pieces = make_pinwheel()
    steps = list(plan_and_check(pieces).steps)
    del steps[missing_step]
    assert find_order_faults([piece.solid for piece in pieces], find_joints(pieces), Assembly(tuple(steps)))


@st.composite
def draw_partitions(draw: st.DrawFn) -> list[Piece]:
    """Draw a partition into boxes of a block that has 2 to 4 cells along each axis."""
    cells = draw(st.tuples(*[st.integers(2, 4)] * 3))
    results = [(np.zeros(3), np.array(cells, dtype=np.float64) * 10.0)]
    for _ in range(draw(st.integers(1, 9))):
        i = draw(st.integers(0, len(results) - 1))
        axis = draw(st.integers(0, 2))
        lo, hi = results[i]
        planes = np.arange(lo[axis] + 10.0, hi[axis] - 5.0, 10.0)
        if len(planes):
            plane_mm = float(draw(st.sampled_from(list(planes))))
            lower_end, upper_start = hi.copy(), lo.copy()
            lower_end[axis] = upper_start[axis] = plane_mm
            results[i : i + 1] = [(lo, lower_end), (upper_start, hi)]
    return make_boxes(*((tuple(lo), tuple(hi)) for lo, hi in results))


@settings(max_examples=40, deadline=None)
@given(draw_partitions(), st.floats(0.0, 6.0))
def test_every_partition_into_boxes_of_one_frame_can_be_assembled(pieces: list[Piece], angle_rad: float):
    rotation = np.array(
        [[np.cos(angle_rad), -np.sin(angle_rad), 0], [np.sin(angle_rad), np.cos(angle_rad), 0], [0, 0, 1.0]]
    )
    transform = np.eye(4)
    transform[:3, :3] = rotation
    joints = [joint.move(transform) for joint in find_joints(pieces)]
    rotated_boxes = [
        Piece(piece.solid.rotate(rotation), rotate_planes(piece.planes, rotation), piece.boxes_mm)
        for piece in pieces
    ]
    assembly = plan_assembly(rotated_boxes, joints)
    assert not assembly.locked_sets
    assert find_order_faults([piece.solid for piece in rotated_boxes], joints, assembly) == []
    assert len(assembly.steps) == len(pieces) - 1
    # No step has to slide, because planes made the partition.
    assert not any(step.slides for step in assembly.steps)
    levels: dict[frozenset[int], int] = {}
    for step in assembly.steps:
        assert step.level == 1 + max(
            levels.get(frozenset(side), 0) for side in (step.moved_parts, step.fixed_parts)
        )
        levels[frozenset((*step.moved_parts, *step.fixed_parts))] = step.level


def test_replay_reports_steps_in_the_wrong_order():
    pieces = make_boxes(*(((0, 0, z), (30, 30, z + 20)) for z in (0, 20, 40)))
    steps = plan_and_check(pieces).steps
    first_fault, second_fault = find_order_faults(
        [piece.solid for piece in pieces], find_joints(pieces), Assembly(steps[::-1])
    )[:2]
    assert first_fault.startswith("step 1 ") and first_fault.endswith("together, but they are not joined yet")
    assert second_fault == "step 2 moves part 3 but not parts 1, 2, although they are joined"
