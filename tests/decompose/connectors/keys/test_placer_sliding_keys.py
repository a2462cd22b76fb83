"""Keys on faces that slide over each other while a joint closes, checked by all rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from decompose.assembly import Assembly, AssemblyStep, find_order_faults
from decompose.connectors import Blank, Connectors, Pin, Tool, drill_parts, find_pairs, plan_connectors
from decompose.connectors.tools import make_groove
from decompose.errors import Rule
from decompose.export.connector_rows import name_pin_kind
from decompose.geometry import Solid
from decompose.options import ConnectorOptions
from decompose.pieces import Piece, find_joints, list_box_planes
from decompose.results.connector_rules import DrilledParts

PHASES = (Phase.explicit, Phase.reuse, Phase.generate)  # shrinking takes minutes
FLOOR_MM, WALL_MM = 20.0, 40.0  # top of the lower part's floor, and front of its wall
WALL_PART = 1  # number of the part
UP_AXIS = np.array([0.0, 0.0, 1.0])
POSES = [np.array(up) for up in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))]


def make_drilled_parts(height_mm: float, up: np.ndarray = POSES[0], *, cap_mm: float = 0.0) -> DrilledParts:
    """Plan the connectors of a floor with a wall, and of a block that comes from above.

    The block closes on the floor and slides along the wall. `cap_mm` is the thickness of a fourth part, which
    is glued on the block and closes on the wall.
    """
    boxes = [
        ((0.0, 0.0, 0.0), (50.0, 60.0, FLOOR_MM)),
        ((0.0, WALL_MM, FLOOR_MM), (50.0, 60.0, height_mm)),
        ((0.0, 0.0, FLOOR_MM), (50.0, WALL_MM, height_mm)),
        ((0.0, 0.0, height_mm), (50.0, 60.0, height_mm + cap_mm)),
    ][: 4 if cap_mm else 3]
    pieces = [Piece(Solid.box(*box), list_box_planes(np.array(box)), np.array([box])) for box in boxes]
    joints = find_joints(pieces)
    bodies = [((1,), (0,)), *([((3,), (2,))] if cap_mm else []), ((2, 3) if cap_mm else (2,), (0, 1))]
    steps = []
    for moved_parts, fixed_parts in bodies:
        step_joints = tuple(
            n
            for n, joint in enumerate(joints)
            if {
                (joint.a in moved_parts, joint.b in fixed_parts),
                (joint.b in moved_parts, joint.a in fixed_parts),
            }
            & {(True, True)}
        )
        slides = len(step_joints) > 1
        steps.append(
            AssemblyStep(
                moved_parts,
                fixed_parts,
                UP_AXIS,
                step_joints,
                sum(joints[n].area_mm2 for n in step_joints),
                slides,
                (),
                1,
            )
        )
    blanks = [Blank(str(n), piece.solid, up) for n, piece in enumerate(pieces, 1)]
    options = ConnectorOptions(2.85, 0.4)
    assembly = Assembly(tuple(steps))
    assert find_order_faults([piece.solid for piece in pieces], joints, assembly) == []
    connectors = plan_connectors(blanks, joints, assembly, options, 25.0)
    return DrilledParts(blanks, drill_parts(blanks, connectors), joints, assembly.steps, connectors)


def list_sliding_pins(parts: DrilledParts) -> list[Pin]:
    return [pin for pin in parts.connectors.pins if pin.slides]


@pytest.fixture(scope="module")
def tall_parts() -> DrilledParts:
    return make_drilled_parts(150.0)


def test_glue_on_a_wall_far_from_the_floor_gets_keys_that_slide_in(tall_parts: DrilledParts) -> None:
    step = tall_parts.steps[-1]
    keys = list_sliding_pins(tall_parts)
    assert step.slides and keys and list(tall_parts.find_faults()) == []
    for key in keys:
        assert name_pin_kind(key) == "sliding key"
        assert abs(float(key.position_mm[1]) - WALL_MM) < 1e-6 and key.position_mm[2] > FLOOR_MM
        exits = [hole.exit_direction for hole in key.holes]
        assert sum(direction is not None for direction in exits) == 1


def test_wall_near_the_floor_needs_no_keys_that_slide() -> None:
    assert list_sliding_pins(make_drilled_parts(60.0)) == []


def test_keys_enter_the_wall_from_above_where_a_thin_cap_covers_it() -> None:
    """Use a cap that is too thin for keys, so that the glue below it is far from all other keys."""
    parts = make_drilled_parts(150.0, cap_mm=2.0)
    exits = [
        (hole.part, float(hole.exit_direction @ UP_AXIS))
        for key in list_sliding_pins(parts)
        for hole in key.holes
        if hole.exit_direction is not None
    ]
    assert list(parts.find_faults()) == []
    assert set(exits) == {(WALL_PART, 1.0)}


@settings(deadline=None, max_examples=10, phases=PHASES)
@given(st.floats(90.0, 190.0), st.sampled_from(POSES), st.sampled_from([0.0, 2.0, 20.0]))
def test_keys_that_slide_break_no_rule(height_mm: float, up: np.ndarray, cap_mm: float) -> None:
    assert list(make_drilled_parts(height_mm, up, cap_mm=cap_mm).find_faults()) == []


def change_key(parts: DrilledParts, **changes: object) -> DrilledParts:
    key = list_sliding_pins(parts)[0]
    pins = tuple(replace(pin, **changes) if pin is key else pin for pin in parts.connectors.pins)
    connectors = Connectors(pins=pins)
    return replace(parts, connectors=connectors, drilled_solids=drill_parts(parts.blanks, connectors))


def find_broken_rules(parts: DrilledParts) -> set[Rule]:
    return {fault.rule for fault in parts.find_faults()}


def close_groove(hole: Tool, key: Pin, *, exit_direction: np.ndarray | None) -> Tool:
    """Make the groove of a key with both ends closed."""
    assert key.key_direction is not None
    ends = key.position_mm + np.outer([-2.0, 2.0], key.key_direction)
    return replace(
        make_groove(hole.part, ends, hole.inward_normal, key.depth_mm), exit_direction=exit_direction
    )


def test_key_that_cannot_enter_its_groove_is_refused(tall_parts: DrilledParts) -> None:
    key = list_sliding_pins(tall_parts)[0]
    moved_hole, fixed_hole = key.holes
    assert moved_hole.exit_direction is not None
    for other_groove in (
        close_groove(moved_hole, key, exit_direction=moved_hole.exit_direction),
        close_groove(moved_hole, key, exit_direction=None),
        replace(moved_hole, exit_direction=-moved_hole.exit_direction),
    ):
        assert Rule.PIN_DIRECTIONS in find_broken_rules(
            change_key(tall_parts, holes=(other_groove, fixed_hole))
        )
    assert Rule.PINS_UNAMBIGUOUS in find_broken_rules(
        change_key(tall_parts, key_direction=np.array([0.0, 0.6, 0.8]))
    )


def test_groove_that_leaves_through_the_surface_is_refused(tall_parts: DrilledParts) -> None:
    """Use a groove that runs up the block to its visible top."""
    key = list_sliding_pins(tall_parts)[0]
    moved_hole, fixed_hole = key.holes
    assert moved_hole.exit_direction is not None
    top_mm = tall_parts.blanks[moved_hole.part].solid.bounds_mm[1][2]
    ends = np.array([key.position_mm, [*key.position_mm[:2], top_mm + 0.1]])
    open_groove = replace(
        make_groove(moved_hole.part, ends, moved_hole.inward_normal, key.depth_mm),
        exit_direction=-moved_hole.exit_direction,
    )
    assert Rule.PIN_WALLS in find_broken_rules(change_key(tall_parts, holes=(open_groove, fixed_hole)))


def test_keys_that_slide_belong_to_no_pair(tall_parts: DrilledParts) -> None:
    key, other_key = (*list_sliding_pins(tall_parts), *list_sliding_pins(tall_parts))[:2]
    long_key = next(pin for pin in tall_parts.connectors.pins if not pin.slides)
    assert find_pairs([key, replace(other_key, length_mm=9.0)]) == {}
    assert find_pairs([long_key, replace(key, step=long_key.step)]) == {}
