"""Covering of cells by the fewest boxes, checked by the constraints of the linear programme and its dual."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from books.box_tables import Shape, make_tables
from decompose.bound.covering import cover_cells
from decompose.grid import index_box

shapes = st.tuples(st.integers(1, 5), st.integers(1, 4), st.integers(1, 4))


@settings(max_examples=30, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), limit_s=st.floats(100.0, 1500.0))
def test_shares_cover_all_cells_and_weights_exceed_no_box(shape: Shape, seed: int, limit_s: float) -> None:
    tables, is_needed = make_tables(shape, seed)
    is_needed[0, 0, 0] = True
    tables.trimmed_box[index_box((0, 0, 0, 1, 1, 1), shape)] = index_box((0, 0, 0, 1, 1, 1), shape)
    result = cover_cells(tables, is_needed, limit_s, 3, is_needed / is_needed.sum())
    assert not result.weights[~is_needed].any()
    assert (result.weights >= 0.0).all()
    cover_count = np.zeros(shape)
    pieces = 0.0
    for (x0, y0, z0, x1, y1, z1), share in zip(result.boxes.tolist(), result.shares.tolist(), strict=True):
        index = index_box((x0, y0, z0, x1, y1, z1), shape)
        assert tables.seconds[index] <= limit_s
        assert result.weights[x0:x1, y0:y1, z0:z1].sum() <= tables.piece_counts[index] * (1.0 + 1e-9)
        cover_count[x0:x1, y0:y1, z0:z1] += share
        pieces += share * int(tables.piece_counts[index])
    if result.shares.any():
        assert (cover_count[is_needed] >= 1.0 - 1e-9).all()
        assert result.weights.sum() <= pieces * (1.0 + 1e-9)
    else:
        assert np.count_nonzero(result.weights) == 1
