"""Tables of random costs for all boxes of a small grid."""

from __future__ import annotations

import numpy as np

from decompose.grid import Box, BoxTables, index_box

Shape = tuple[int, int, int]


def list_boxes(shape: Shape) -> list[Box]:
    spans = [[(a, b) for a in range(n) for b in range(a + 1, n + 1)] for n in shape]
    return [(x0, y0, z0, x1, y1, z1) for x0, x1 in spans[0] for y0, y1 in spans[1] for z0, z1 in spans[2]]


def make_tables(shape: Shape, seed: int) -> tuple[BoxTables, np.ndarray]:
    """Make costs roughly proportional to volume; some boxes have two pieces, and some fit no printer."""
    rng = np.random.default_rng(seed)
    is_needed = rng.random(shape) < 0.7
    total = int(np.prod([n * (n + 1) // 2 for n in shape]))
    seconds = np.full(total, np.inf, np.float32)
    trimmed_index = np.full(total, -1, np.int32)
    pieces = np.ones(total, np.int16)
    cut_mm2 = rng.uniform(0.0, 1e4, total).astype(np.float32)
    for box in list_boxes(shape):
        index = index_box(box, shape)
        cells_inside = np.argwhere(is_needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(cells_inside):
            continue
        lo, hi = cells_inside.min(axis=0) + box[:3], cells_inside.max(axis=0) + box[:3] + 1
        trimmed_index[index] = index_box((*lo, *hi), shape)  # type: ignore[arg-type]
        if trimmed_index[index] == index:
            cells = np.prod(np.subtract(box[3:], box[:3]))
            seconds[index] = 100.0 * cells * rng.uniform(0.7, 1.3) + 30.0
            pieces[index] = 2 if rng.random() < 0.1 else 1
            if cells > 1 and rng.random() < 0.1:
                seconds[index] = np.inf
    return BoxTables(shape, seconds, trimmed_index, pieces, cut_mm2), is_needed
