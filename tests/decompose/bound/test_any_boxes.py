"""Bound on boxes that lie on no grid, compared with random partitions whose cut solids are priced."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.arrays import Floats
from decompose.bound import any_boxes, bound_shared_work_s, sum_least_work_s
from decompose.geometry import Solid
from decompose.pieces import find_cut_faces, list_box_planes
from decompose.print_time import (
    POSE_ROTATIONS,
    CostModel,
    PrintTimeSettings,
    measure_pose,
    price_axis_poses_s,
)
from decompose.printers import TargetPrinter

KNOWN_MAKESPAN_RATIO = 1.001
"""Ratio of the known makespan that is passed in to the one that the bound must not exceed."""
COSTS = (
    CostModel.from_settings(PrintTimeSettings()),
    CostModel.from_settings(
        PrintTimeSettings(overhead_s=60.0, saved_bed_layer_count=2.0, saved_top_layer_count=1.0)
    ),
)


def compute_any_boxes_bound_s(
    triangles: Floats, printers: Sequence[TargetPrinter], cost: CostModel, wall_mm: float, makespan_s: float
) -> float:
    work_s = sum_least_work_s(triangles, printers, cost, wall_mm)
    return bound_shared_work_s(work_s, printers, cost, makespan_s)


@pytest.fixture(autouse=True, scope="module")
def coarse_cells() -> Iterator[None]:
    """Use coarse cells, which save time; the bound holds for cells of any size."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(any_boxes, "CELLS_PER_SIDE", 20)
        yield


def draw_boxes(rng: np.random.Generator, count: int, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """Divide a box at random planes."""
    boxes = [np.array([low, high])]
    while len(boxes) < count:
        box = boxes.pop(int(rng.integers(len(boxes))))
        axis = int(rng.integers(3))
        near_box, far_box = box.copy(), box.copy()
        near_box[1, axis] = far_box[0, axis] = rng.uniform(*(box[:, axis]))
        boxes += [near_box, far_box]
    return boxes


def price_content_s(solid: Solid, box: np.ndarray, cost: CostModel) -> float:
    """Compute the price of a solid's share in a box, in its best axis pose; 0 if the share is empty."""
    content = solid.clip(*box)
    if content.volume_mm3 < 1e-6:
        return 0.0
    vertices, faces = content.arrays()
    if cost.hidden_bed_share == 0.0:
        return float(price_axis_poses_s(vertices, faces, cost).min())
    is_cut = find_cut_faces(vertices, faces, list_box_planes(box))
    return min(
        measure_pose(vertices, faces, is_cut, rotation, cost, False).price_s for rotation in POSE_ROTATIONS
    )


def is_deep(box: np.ndarray, low: np.ndarray, high: np.ndarray, wall_mm: float) -> bool:
    """Check whether all sides of a box lie deeper in a block than its wall is thick."""
    return bool((box[0] >= low + wall_mm).all() and (box[1] <= high - wall_mm).all())


def make_printer(size_mm: float, factor: float = 1.0) -> TargetPrinter:
    return TargetPrinter("", ((size_mm,) * 3,), factor)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 9), st.sampled_from(COSTS))
def test_no_partition_of_a_curved_solid_undercuts_the_bound(
    ring_with_bar: Solid, seed: int, count: int, cost: CostModel
) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = ring_with_bar.arrays()
    vertices = vertices * rng.uniform(0.5, 4.0)
    solid = Solid.from_arrays(vertices, faces)
    boxes = draw_boxes(rng, count, *(solid.bounds_mm + np.array([[-0.01], [0.01]])))
    factors = rng.uniform(0.5, 2.0, len(boxes))
    longest_mm = max(float(np.ptp(box, axis=0).max()) for box in boxes)
    makespan_s = max(
        price_content_s(solid, box, cost) * factor for box, factor in zip(boxes, factors, strict=True)
    )
    printers = [make_printer(longest_mm, float(factor)) for factor in factors]
    for wall_mm in (1.0, math.inf):
        bound_s = compute_any_boxes_bound_s(
            vertices[faces], printers, cost, wall_mm, KNOWN_MAKESPAN_RATIO * makespan_s
        )
        assert 0.0 <= bound_s <= makespan_s


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6), st.floats(200.0, 900.0), st.floats(5.0, 30.0))
def test_no_hollow_partition_of_a_block_undercuts_the_bound(
    seed: int, side_mm: float, wall_mm: float
) -> None:
    """Leave out the innermost of 27 boxes, and print the others on as many printers."""
    rng = np.random.default_rng(seed)
    low, high = np.zeros(3), side_mm * rng.uniform(0.5, 1.0, 3)
    solid = Solid.box(low, high)
    near_mm = wall_mm + rng.uniform(0.0, 0.2, 3) * (high - 2.0 * wall_mm)
    far_mm = high - wall_mm - rng.uniform(0.0, 0.2, 3) * (high - 2.0 * wall_mm)
    planes = np.stack([low, near_mm, far_mm, high])
    boxes = [
        np.array([[planes[i + side, axis] for axis, i in enumerate(cell)] for side in range(2)])
        for cell in np.ndindex(3, 3, 3)
    ]
    boxes = [box for box in boxes if not is_deep(box, low, high, wall_mm)]
    assert len(boxes) == 26
    times_s = [price_content_s(solid, box, COSTS[0]) for box in boxes]
    vertices, faces = solid.arrays()
    longest_mm = max(float(np.ptp(box, axis=0).max()) for box in boxes)
    printers = [make_printer(longest_mm)] * len(boxes)
    bound_s = compute_any_boxes_bound_s(
        vertices[faces], printers, COSTS[0], wall_mm, KNOWN_MAKESPAN_RATIO * max(times_s)
    )
    assert bound_s <= sum(times_s) / len(boxes)


def test_necessary_cuts_and_a_solid_interior_raise_the_bound(cost: CostModel) -> None:
    solid = Solid.box((0, 0, 0), (400, 400, 400))
    vertices, faces = solid.arrays()
    triangles = vertices[faces]
    small_printers, large_printers = [make_printer(205.0)] * 8, [make_printer(500.0)] * 8
    hollow_bound_s = compute_any_boxes_bound_s(triangles, small_printers, cost, 10.0, 1e6)
    solid_bound_s = compute_any_boxes_bound_s(triangles, small_printers, cost, math.inf, 1e6)
    uncut_bound_s = compute_any_boxes_bound_s(triangles, large_printers, cost, math.inf, 1e6)
    assert hollow_bound_s < solid_bound_s and uncut_bound_s < solid_bound_s
    makespan_s = price_content_s(solid, np.array([[0.0] * 3, [200.0] * 3]), cost)
    assert 0.85 * makespan_s < solid_bound_s <= makespan_s  # eight cubes are the best partition into boxes
    assert compute_any_boxes_bound_s(triangles, small_printers, cost, math.inf, 10.0) == 10.0


def test_faster_printers_lower_the_bound_by_their_throughput(cost: CostModel) -> None:
    vertices, faces = Solid.box((0, 0, 0), (300, 300, 300)).arrays()
    equal_bound_s = compute_any_boxes_bound_s(vertices[faces], [make_printer(205.0)] * 8, cost, math.inf, 1e6)
    fast_bound_s = compute_any_boxes_bound_s(
        vertices[faces], [make_printer(205.0, 0.5)] * 8, cost, math.inf, 5e5
    )
    assert fast_bound_s == pytest.approx(0.5 * equal_bound_s)
