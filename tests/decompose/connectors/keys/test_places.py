"""Keys in grooves of walls that are too thin for holes, checked by all rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from decompose.assembly import plan_assembly
from decompose.connectors import Blank, Connectors, drill_parts, find_pairs, plan_connectors
from decompose.connectors.coverage import Site
from decompose.connectors.faces import Workpieces, find_sides
from decompose.connectors.keys.places import KeyMaker
from decompose.connectors.tools import make_groove
from decompose.errors import Rule
from decompose.export.pin_sheet import make_pin_sheet
from decompose.geometry import Solid
from decompose.options import ConnectorOptions
from decompose.pieces import Piece, find_joints
from decompose.results.connector_rules import DrilledParts, find_wrong_fits

PHASES = (Phase.explicit, Phase.reuse, Phase.generate)  # shrinking takes minutes
CUT = np.array([[0.0, 0.0, 1.0, 30.0]])
POSES = [np.array(up) for up in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]


def make_wall(width_mm: float, slope: float, bottom_mm: float, top_mm: float) -> Piece:
    """Make a wall along x that leans in y."""
    corners = [
        (x, y + slope * (z - 30.0), z)
        for x in (0.0, 60.0)
        for y in (0.0, width_mm)
        for z in (bottom_mm, top_mm)
    ]
    solid = Solid.hull(np.array(corners))
    return Piece(solid, CUT, np.array([solid.bounds_mm]))


def drill_wall(width_mm: float, slope: float, up_axis: np.ndarray = POSES[0]) -> DrilledParts:
    """Plan the connectors of a leaning wall with a horizontal cut, and drill its two parts."""
    pieces = [make_wall(width_mm, slope, 0.0, 30.0), make_wall(width_mm, slope, 30.0, 60.0)]
    joints = find_joints(pieces)
    assembly = plan_assembly(pieces, joints)
    blanks = [Blank(str(n), piece.solid, up_axis) for n, piece in enumerate(pieces, 1)]
    connectors = plan_connectors(blanks, joints, assembly, ConnectorOptions(2.85, 0.4), 25.0)
    return DrilledParts(blanks, drill_parts(blanks, connectors), joints, assembly.steps, connectors)


def test_places_of_keys_follow_a_tool_that_replaces_another_one() -> None:
    pieces = [make_wall(30.0, 0.0, 0.0, 30.0), make_wall(30.0, 0.0, 30.0, 60.0)]
    blanks = [Blank(str(n), piece.solid, POSES[0]) for n, piece in enumerate(pieces, 1)]
    [sides] = find_sides(blanks, 0, find_joints(pieces)[0])
    site = Site(*sides)
    left, right = (
        make_groove(sides[0].part, np.array([(x, 5.0, 30.0), (x, 25.0, 30.0)]), sides[0].inward_normal)
        for x in (15.0, 45.0)
    )

    def measure_middles_mm(maker: KeyMaker) -> list[float]:
        return [float(place.middle_mm[0]) for place in maker.find_places([site], 6.0)]

    maker = KeyMaker(Workpieces(blanks), 0, POSES[0], 2.85)
    maker.workpieces.add_tools([left])
    first_middles_mm = measure_middles_mm(maker)
    maker.workpieces.remove_tools([left])
    maker.workpieces.add_tools([right])
    fresh_maker = KeyMaker(Workpieces(blanks), 0, POSES[0], 2.85)
    fresh_maker.workpieces.add_tools([right])
    assert measure_middles_mm(maker) == measure_middles_mm(fresh_maker) != first_middles_mm


@pytest.mark.parametrize(("width_mm", "key_mm"), [(5.5, 1.75), (7.0, 2.85)])
def test_leaning_wall_has_a_long_and_a_short_key_far_apart(width_mm: float, key_mm: float) -> None:
    parts = drill_wall(width_mm, 0.4)
    long_key, short_key = parts.connectors.pins
    assert long_key.key_direction is not None and short_key.key_direction is not None
    assert (long_key.diameter_mm, short_key.diameter_mm) == (key_mm, key_mm)
    assert abs(float(long_key.position_mm[0] - short_key.position_mm[0])) > 35.0
    assert find_pairs(parts.connectors.pins) == {0: (long_key, short_key)}
    assert find_wrong_fits([long_key, short_key]) == [] and list(parts.find_faults()) == []


@settings(deadline=None, max_examples=15, phases=PHASES)
@given(st.floats(3.0, 9.0), st.floats(-0.9, 0.9), st.sampled_from(POSES))
def test_connectors_of_leaning_walls_break_no_rule(
    width_mm: float, slope: float, up_axis: np.ndarray
) -> None:
    assert list(drill_wall(width_mm, slope, up_axis).find_faults()) == []


def change_first_key(parts: DrilledParts, **changes: object) -> DrilledParts:
    first_pin, *other_pins = parts.connectors.pins
    connectors = Connectors(pins=(replace(first_pin, **changes), *other_pins))
    return replace(parts, connectors=connectors, drilled_solids=drill_parts(parts.blanks, connectors))


def test_key_that_is_too_long_or_across_its_groove_is_refused() -> None:
    parts = drill_wall(5.5, 0.4)
    for changes in ({"length_mm": 14.0}, {"key_direction": np.array([0.0, 1.0, 0.0])}):
        assert Rule.PINS_UNAMBIGUOUS in {
            fault.rule for fault in change_first_key(parts, **changes).find_faults()
        }


def test_groove_near_the_outside_is_refused() -> None:
    parts = drill_wall(5.5, 0.4)
    first_pin = parts.connectors.pins[0]
    grooves = tuple(
        replace(hole, points_mm=hole.points_mm + np.array([0.0, 0.6, 0.0])) for hole in first_pin.holes
    )
    assert Rule.PIN_WALLS in {fault.rule for fault in change_first_key(parts, holes=grooves).find_faults()}


def test_keys_of_equal_length_allow_a_half_turn() -> None:
    long_key, short_key = drill_wall(5.5, 0.4).connectors.pins
    equal_key = replace(long_key, length_mm=short_key.length_mm + 1.0)
    assert find_wrong_fits([equal_key, short_key]) == [
        "a body of step 1 fits if it is rotated by 180 degrees"
    ]


def test_cut_list_names_pieces_of_each_diameter() -> None:
    thin_keys, thick_keys = drill_wall(5.5, 0.4).connectors.pins, drill_wall(7.0, 0.4).connectors.pins
    sheet = make_pin_sheet([*thin_keys, *thick_keys])
    assert sheet is not None
    assert [row[:2] for row in sheet.rows] == [("2.85", "8"), ("2.85", "4"), ("1.75", "7"), ("1.75", "4")]
    assert [(diameter, count) for diameter, count, _ in sheet.stocks] == [("2.85", 2), ("1.75", 2)]


def test_thick_and_thin_key_of_equal_length_are_not_a_pair() -> None:
    """Use a thin key that fits both grooves, so that the keys do not show the orientation of a body."""
    thick_key, thin_key = drill_wall(7.0, 0.4).connectors.pins[1], drill_wall(5.5, 0.4).connectors.pins[1]
    assert (thick_key.length_mm, thin_key.length_mm) == (
        4.0,
        4.0,
    ) and thick_key.diameter_mm > thin_key.diameter_mm
    assert find_pairs([thick_key, thin_key]) == {} and find_wrong_fits([thick_key, thin_key]) == []
