"""The weights of cells against every box that they are to keep to."""

from __future__ import annotations

from box_tables import Shape, every_box, tables
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.boxes import box_index
from decompose.covering import covering_weights

shapes = st.tuples(st.integers(1, 5), st.integers(1, 4), st.integers(1, 4))


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), limit_s=st.floats(100.0, 1500.0))
def test_no_box_within_the_time_is_overrun(shape: Shape, seed: int, limit_s: float) -> None:
    boxes, needed = tables(shape, seed)
    needed[0, 0, 0] = True
    boxes.trimmed[box_index((0, 0, 0, 1, 1, 1), shape)] = box_index((0, 0, 0, 1, 1, 1), shape)
    weights = covering_weights(boxes, needed, limit_s, 3, needed / needed.sum())
    assert weights.sum() > 0.0
    assert not weights[~needed].any()
    assert (weights >= 0.0).all()
    for box in every_box(shape):
        at = box_index(box, shape)
        if boxes.seconds[at] <= limit_s and boxes.trimmed[at] == at:
            x0, y0, z0, x1, y1, z1 = box
            assert weights[x0:x1, y0:y1, z0:z1].sum() <= boxes.pieces[at] * (1.0 + 1e-9)
