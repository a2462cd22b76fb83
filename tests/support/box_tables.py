"""Tables over all boxes of a small grid, with invented costs."""

from __future__ import annotations

import numpy as np

from decompose.grid import Box, BoxTables, box_index

Shape = tuple[int, int, int]


def every_box(shape: Shape) -> list[Box]:
    spans = [[(a, b) for a in range(n) for b in range(a + 1, n + 1)] for n in shape]
    return [(x0, y0, z0, x1, y1, z1) for x0, x1 in spans[0] for y0, y1 in spans[1] for z0, z1 in spans[2]]


def tables(shape: Shape, seed: int) -> tuple[BoxTables, np.ndarray]:
    """Costs that grow with volume but not strictly, some boxes in two pieces, some that fit nothing."""
    rng = np.random.default_rng(seed)
    needed = rng.random(shape) < 0.7
    total = int(np.prod([n * (n + 1) // 2 for n in shape]))
    seconds = np.full(total, np.inf, np.float32)
    trimmed = np.full(total, -1, np.int32)
    pieces = np.ones(total, np.int16)
    cut_mm2 = rng.uniform(0.0, 1e4, total).astype(np.float32)
    for box in every_box(shape):
        at = box_index(box, shape)
        inside = np.argwhere(needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(inside):
            continue
        lo, hi = inside.min(axis=0) + box[:3], inside.max(axis=0) + box[:3] + 1
        trimmed[at] = box_index((*lo, *hi), shape)  # type: ignore[arg-type]
        if trimmed[at] == at:
            cells = np.prod(np.subtract(box[3:], box[:3]))
            seconds[at] = 100.0 * cells * rng.uniform(0.7, 1.3) + 30.0
            pieces[at] = 2 if rng.random() < 0.1 else 1
            if cells > 1 and rng.random() < 0.1:
                seconds[at] = np.inf
    return BoxTables(shape, seconds, trimmed, pieces, cut_mm2), needed
