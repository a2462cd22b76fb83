"""Redundant pins: left out because enough glue is near the others."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.connectors import Blank, Pin, Tool
from decompose.connectors.faces import Workpieces
from decompose.connectors.pins.redundant import find_redundant_pins
from decompose.geometry import Solid

UP_AXIS, NORMAL = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
WORKPIECES = Workpieces([Blank(name, Solid.box((0, 0, 0), (1, 1, 1)), UP_AXIS) for name in "12"])


def make_key(step, x_mm, length_mm, is_level=False):
    normal = UP_AXIS if is_level else NORMAL
    grooves = [Tool(part, np.zeros((4, 3)), sign * normal, 0.0) for part, sign in ((0, 1.0), (1, -1.0))]
    return Pin(
        step=step,
        joint=step,
        position_mm=np.array([x_mm, 0.0, 0.0]),
        axis=normal,
        diameter_mm=2.85,
        depth_mm=2.3,
        length_mm=length_mm,
        is_slotted=False,
        holes=(grooves[0], grooves[1]),
        key_direction=np.array([1.0, 0.0, 0.0]),
    )


def make_glue(*spans_mm):
    x_mm = np.concatenate([np.arange(low, high, 2.0) for low, high in spans_mm])
    return np.column_stack([x_mm, np.zeros((len(x_mm), 2))])


PAIR = [make_key(0, 0.0, 9.0), make_key(0, 50.0, 5.0)]


def test_key_that_reaches_little_glue_is_redundant():
    redundant_key = make_key(0, 100.0, 5.0)
    glue_mm = [make_glue((-60.0, 114.0))]
    assert find_redundant_pins(WORKPIECES, glue_mm, [*PAIR, redundant_key]) == [redundant_key]
    assert find_redundant_pins(WORKPIECES, [make_glue((-60.0, 150.0))], [*PAIR, redundant_key]) == []


def test_keys_of_a_pair_are_never_redundant():
    assert find_redundant_pins(WORKPIECES, [make_glue((0.0, 20.0))], PAIR) == []
    # Two keys of equal length are no pair.
    assert find_redundant_pins(WORKPIECES, [make_glue((0.0, 20.0))], [PAIR[0], PAIR[0]]) == []


def test_keys_on_level_faces_are_left_out_first():
    """Check two keys that reach the same amount of glue, only one of which can be left out."""
    keys = [make_key(0, -50.0, 5.0), make_key(0, 100.0, 5.0, is_level=True)]
    glue_mm = [make_glue((-66.0, 118.0), (-20.0, 66.0))]
    assert find_redundant_pins(WORKPIECES, glue_mm, [*PAIR, *keys]) == [keys[1]]


@pytest.mark.parametrize(("high_mm", "is_redundant"), [(140.0, False), (118.0, True)])
def test_each_step_keeps_most_of_its_glue_near_pins(high_mm, is_redundant):
    """Check a small step beside a large one, whose glue is all near its pair."""
    pins = [make_key(1, 0.0, 9.0), make_key(1, 50.0, 5.0), *PAIR, make_key(0, 100.0, 5.0)]
    glue_mm = [make_glue((50.0, high_mm)), make_glue(*[(-60.0, 110.0)] * 20)]
    assert (find_redundant_pins(WORKPIECES, glue_mm, pins) == [pins[-1]]) == is_redundant
