"""Pins, marks and gutter of a small sliced part, as read from its G-code."""

from __future__ import annotations

import numpy as np
import pytest

from bench.connectors.joint_slices import SlicedPart, slice_part
from decompose.assembly import plan_assembly
from decompose.connectors import Blank, Connectors, drill_parts, plan_connectors
from decompose.geometry import Solid
from decompose.options import ConnectorOptions
from decompose.pieces import Piece, find_joints, list_box_planes
from decompose.results import Part

UP = np.array([0.0, 0.0, 1.0])
SHRINKAGE_MM = 0.2


@pytest.fixture(scope="module")
def sliced_joint(tmp_path_factory: pytest.TempPathFactory) -> tuple[Connectors, SlicedPart]:
    """Slice a block that has one block beside it and one below it, so that a cut face lies on the bed."""
    spans = [((0, 0, 0), (16, 50, 26)), ((16, 0, 0), (30, 50, 26)), ((0, 0, -12), (16, 50, 0))]
    pieces = [
        Piece(Solid.box(*span), list_box_planes(np.array(span, dtype=np.float64)), np.zeros((0, 2, 3)))
        for span in spans
    ]
    joints = find_joints(pieces)
    blanks = [Blank(str(n), piece.solid, UP) for n, piece in enumerate(pieces, 1)]
    connectors = plan_connectors(
        blanks, joints, plan_assembly(pieces, joints), ConnectorOptions(2.85, marks=True), 25.0
    )
    part = Part("p01", pieces[0].solid, np.eye(4), 0.0, "a", layer_0_expansion_mm=-SHRINKAGE_MM)
    return connectors, slice_part(part, drill_parts(blanks, connectors)[0], tmp_path_factory.mktemp("slice"))


def test_all_marks_of_the_part_are_legible_in_its_outer_walls(
    sliced_joint: tuple[Connectors, SlicedPart],
) -> None:
    connectors, sliced_part = sliced_joint
    marks = [mark for mark in connectors.marks if mark.part == 0]
    assert [mark.text for mark in marks] == ["1-2^", "-3^"]
    assert all(sliced_part.is_legible(mark) for mark in marks)
    far_marks = [mark for mark in connectors.marks if mark.part == 2]
    # The part with these marks was not sliced.
    assert far_marks and not any(sliced_part.is_legible(mark) for mark in far_marks)


def test_horizontal_holes_and_holes_open_to_the_bed_have_no_support(
    sliced_joint: tuple[Connectors, SlicedPart],
) -> None:
    connectors, sliced_part = sliced_joint
    directions = {
        round(float(hole.inward_normal @ UP))
        for pin in connectors.pins
        for hole in pin.holes
        if not hole.part
    }
    assert directions == {0, 1}
    # Specks of support remain where strokes of the mark on the bed cross; a hole would need 1.3 mm.
    assert sliced_part.support_filament_mm < 0.1


def test_seams_of_the_outer_wall_are_in_the_gutter_and_not_in_grooves_of_keys(
    sliced_joint: tuple[Connectors, SlicedPart],
) -> None:
    connectors, sliced_part = sliced_joint
    [gutter] = [candidate for candidate in connectors.gutters if candidate.part == 0]
    starts_mm = sliced_part.find_seams(longest_only=True)
    start, end = gutter.line_mm
    gutter_starts_mm = starts_mm[(starts_mm[:, 2] > start[2]) & (starts_mm[:, 2] < end[2])]
    assert len(gutter_starts_mm) > 40
    keys_mm = np.array([pin.position_mm for pin in connectors.pins if pin.joint == gutter.joint])
    # A seam in a groove nearer than this would be counted as one in the gutter.
    assert (np.abs(keys_mm[:, 1] - start[1]) > 5.0).all()
    is_in_gutter = (start[0] - gutter_starts_mm[:, 0] > 0.3) & (
        np.abs(gutter_starts_mm[:, 1] - start[1]) < 0.8
    )
    assert is_in_gutter.mean() > 0.98


def test_first_layer_of_a_glued_face_is_narrower(sliced_joint: tuple[Connectors, SlicedPart]) -> None:
    _, sliced_part = sliced_joint
    first, second = (sliced_part.walls.start[sliced_part.walls.layer == layer] for layer in (0, 10))
    wider_mm = 0.2 * 0.35  # lines of the first layer are wider, so their middles are farther inside
    difference_mm = np.ptp(second, axis=0) - np.ptp(first, axis=0)
    assert difference_mm == pytest.approx(2.0 * SHRINKAGE_MM + wider_mm, abs=0.06)
