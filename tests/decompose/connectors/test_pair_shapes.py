"""Shapes of pairs of pins: alike in any position, unlike by their distance or by the angle of a key."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trimesh.transformations import random_rotation_matrix, rotation_matrix

from decompose.arrays import Floats
from decompose.assembly import plan_assembly
from decompose.connectors import Blank, Connectors, Pin, drill_parts
from decompose.connectors.coverage import Site
from decompose.connectors.faces import Workpieces, find_sides
from decompose.connectors.keys import KeyMaker, choose_key_lengths_mm
from decompose.connectors.keys.places import KeyPlace
from decompose.connectors.pair_shapes import PairShapes, find_free_pairs, measure_shape
from decompose.connectors.pins.placer import MIN_DISTANCE_DIFFERENCE_MM
from decompose.geometry import Solid
from decompose.options import FILAMENT_MM, PairShape
from decompose.pieces import Piece, find_joints
from decompose.results.connector_rules import find_wrong_fits

UP = np.array([0.0, 0.0, 1.0])
IDENTITY = np.eye(3)
LENGTHS_MM = (9.0, 5.0)
MAX_DIFFERENCE_MM = 0.5


def measure(
    distance_mm: float, first_rad: float, second_rad: float, rotation: Floats = IDENTITY
) -> PairShape:
    """Measure the shape of two keys on the plane z = 0 that is moved."""
    directions = [np.array([math.cos(angle), math.sin(angle), 0.0]) for angle in (first_rad, second_rad)]
    offsets_mm = np.array([3.0, 4.0, 5.0]), np.array([3.0, 4.0, 5.0]) + distance_mm * rotation[:, 0]
    return measure_shape(
        rotation @ UP, offsets_mm, (rotation @ directions[0], rotation @ directions[1]), LENGTHS_MM
    )


def is_alike(shape: PairShape, other: PairShape) -> bool:
    angles = [None if angle is None else np.array([[angle]]) for angle in shape.angles]
    shapes = PairShapes(np.array([[shape.distance_mm]]), (angles[0], angles[1]), shape.lengths_mm)
    return not find_free_pairs(shapes, [other], MAX_DIFFERENCE_MM).all()


@given(st.floats(0.0, math.pi), st.floats(0.0, math.pi), st.integers(0, 2**32 - 1), st.booleans())
def test_pair_is_like_itself_in_any_position_and_from_the_other_side(
    first_rad: float, second_rad: float, seed: int, is_mirrored: bool
) -> None:
    rotation = random_rotation_matrix(np.random.default_rng(seed).random(3))[:3, :3]
    mirror = np.diag([1.0, -1.0, 1.0]) if is_mirrored else IDENTITY
    shape = measure(20.0, first_rad, second_rad)
    moved_shape = measure(20.0, first_rad, second_rad, rotation @ mirror)
    assert is_alike(shape, moved_shape) and is_alike(moved_shape, shape)


@pytest.mark.parametrize(("end_mm", "expected"), [(0.45, True), (0.55, False)])
@pytest.mark.parametrize("key", [0, 1])
def test_pairs_are_unlike_if_an_end_of_a_turned_key_is_beside_its_groove(
    key: int, end_mm: float, expected: bool
) -> None:
    turn_rad = math.asin(end_mm / (LENGTHS_MM[key] / 2.0))
    angles = [0.3, 0.7]
    shape = measure(20.0, *angles)
    angles[key] += turn_rad
    assert is_alike(shape, measure(20.0, *angles)) == is_alike(measure(20.0, *angles), shape) == expected


@pytest.mark.parametrize(("distance_mm", "expected"), [(20.4, True), (20.6, False)])
@pytest.mark.parametrize("angles", [(None, None), (0.3, None), (0.3, 0.4)])
def test_pairs_are_alike_within_the_difference_of_their_distances(
    angles: tuple[float | None, float | None], distance_mm: float, expected: bool
) -> None:
    shape = PairShape(20.0, angles, LENGTHS_MM)
    assert is_alike(shape, shape._replace(distance_mm=distance_mm)) == expected


def test_pairs_of_other_kinds_are_unlike() -> None:
    shapes = [
        PairShape(20.0, angles, LENGTHS_MM) for angles in [(None, None), (0.3, None), (None, 0.3), (0.3, 0.3)]
    ]
    for shape in shapes:
        assert [is_alike(shape, other) for other in shapes] == [other is shape for other in shapes]


def drill_halves(turn_rad: float, fit_mm: float) -> tuple[list[Pin], list[Solid]]:
    """Lay a long and a short key in the joint of two halves; turn the short key."""
    spans = [((-30, -15, 0), (30, 15, 20)), ((-30, -15, 20), (30, 15, 40))]
    solids = [Solid.box(*span) for span in spans]
    pieces = [
        Piece(solid, np.array([[0.0, 0.0, 1.0, 20.0]]), np.array([solid.bounds_mm])) for solid in solids
    ]
    joints = find_joints(pieces)
    [step] = plan_assembly(pieces, joints).steps
    blanks = [Blank(str(number), solid, UP, fit_mm) for number, solid in enumerate(solids, 1)]
    [sides] = find_sides(blanks, 0, joints[0])
    site = Site(*(sides if sides[0].part in step.moved_parts else sides[::-1]))
    maker = KeyMaker(Workpieces(blanks), 0, step.direction, 2.85)
    directions = np.eye(3)[0], rotation_matrix(turn_rad, UP)[:3, 0]
    keys = [
        maker.make_key(KeyPlace(site, np.array([x_mm, 0.0, 20.0]), direction), length_mm)
        for x_mm, direction, length_mm in zip((-12.0, 12.0), directions, maker.lengths_mm, strict=True)
    ]
    pins = [key for key in keys if key is not None]
    assert len(pins) == 2
    return pins, drill_parts(blanks, Connectors(pins=tuple(pins)))


def build_rods(pins: list[Pin]) -> Solid:
    """Build the bodies of keys."""
    circle = 1.425 * np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0.0, 2 * math.pi, 32)[:-1]])
    rods = []
    for pin in pins:
        across = np.cross(UP, pin.rod_axis)
        ring = pin.position_mm + np.outer(circle[:, 0], across) + np.outer(circle[:, 1], UP)
        ends = [ring + end * pin.length_mm / 2.0 * pin.rod_axis for end in (-1.0, 1.0)]
        rods.append(Solid.hull(np.concatenate(ends)))
    return Solid.union(rods)


@pytest.mark.parametrize("fit_mm", [0.2, 0.4])
def test_body_whose_pair_differs_only_by_the_angle_of_a_key_does_not_close(fit_mm: float) -> None:
    """Put the upper half on keys in the grooves of another pair, raised by the minimum opening of a rule."""
    min_difference_mm = 2.0 * fit_mm + MIN_DISTANCE_DIFFERENCE_MM
    turn_rad = math.asin(min_difference_mm / (choose_key_lengths_mm(FILAMENT_MM)[1] / 2.0))
    pins, solids = drill_halves(0.0, fit_mm)
    turned_pins, turned_solids = drill_halves(turn_rad, fit_mm)
    upper = max(solids, key=lambda solid: solid.bounds_mm[1][2])
    turned_lower = min(turned_solids, key=lambda solid: solid.bounds_mm[0][2])
    rods, turned_rods = build_rods(pins), build_rods(turned_pins)
    assert upper.intersect(rods).volume_mm3 < 0.02
    assert turned_lower.intersect(turned_rods).volume_mm3 < 0.02
    raised = [upper.translate(np.array([0.0, 0.0, gap_mm])) for gap_mm in (0.0, 0.5)]
    assert all(body.intersect(turned_rods).volume_mm3 > 0.1 for body in raised)
    # The rule of results comes to the same conclusion.
    assert find_wrong_fits([*pins, *(replace(pin, step=1) for pin in turned_pins)]) == []
    similar_pins = drill_halves(math.radians(3.0), fit_mm)[0]
    assert find_wrong_fits([*pins, *(replace(pin, step=1) for pin in similar_pins)]) == [
        "bodies of steps 1 and 2 fit each other"
    ]
