"""Needed part of each cell: the volume near the surface, and little more."""

from __future__ import annotations

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from decompose.grid import Grid, GridRules, NeededCells, build_grid, refine_cells
from decompose.print_time import CostModel, PrintTimeSettings

SIDES_MM = np.array([300.0, 260.0, 280.0])


def make_block(rotation: Rotation) -> np.ndarray:
    """Return the triangles (12, 3, 3) of a rotated block."""
    box = trimesh.creation.box(SIDES_MM)
    return np.asarray(rotation.apply(box.vertices)[box.faces])


def make_grid(
    triangles: np.ndarray, cost: CostModel, cells: int, wall_mm: float, keeps_interior: bool = False
) -> Grid:
    return build_grid(triangles, cells, GridRules(wall_mm, keeps_interior, cost.overhang_cos, cost.skin_cos))


def list_corners_mm(cells: NeededCells, mask: np.ndarray) -> np.ndarray:
    """Return the corners (8, k, 3) in mm of the marked cells."""
    index = np.argwhere(mask)
    ends = [[cells.planes[a][index[:, a]], cells.planes[a][index[:, a] + 1]] for a in range(3)]
    return np.stack(
        [np.stack([ends[a][side] for a, side in enumerate(corner)], axis=1) for corner in np.ndindex(2, 2, 2)]
    )


def refine_needed_cells(grid: Grid, cells: NeededCells) -> np.ndarray:
    """Return the needed cells of a grid as a mask of finer cells."""
    return np.kron(grid.is_needed, np.ones(np.array(cells.is_needed.shape) // np.array(grid.shape))).astype(
        bool
    )


@given(
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(Rotation.from_rotvec),
    st.integers(5, 12),
    st.floats(0.0, 40.0),
)
@settings(max_examples=25, deadline=None)
def test_cells_near_the_surface_are_needed(rotation: Rotation, count: int, wall_mm: float) -> None:
    """Compare with the exact depth of corners in a block; corners are enough because a block is convex."""
    cost = CostModel.from_settings(PrintTimeSettings())
    triangles = make_block(rotation)
    grid = make_grid(triangles, cost, count, wall_mm)
    cells = refine_cells(grid, triangles, wall_mm, keeps_interior=False, max_cells=200_000)
    assert not (cells.is_needed & ~refine_needed_cells(grid, cells)).any()

    def compute_depths_mm(mask: np.ndarray) -> np.ndarray:
        """Return the depth (8, k) in the block of the corners of marked cells; it is negative outside."""
        local_mm = rotation.inv().apply(list_corners_mm(cells, mask).reshape(-1, 3))
        return np.asarray((SIDES_MM / 2.0 - np.abs(local_mm)).min(axis=1).reshape(8, -1))

    empty_depths_mm = compute_depths_mm(~cells.is_needed & refine_needed_cells(grid, cells))
    is_inside = empty_depths_mm.max(axis=0, initial=-np.inf) > 1e-9
    assert (empty_depths_mm[:, is_inside] >= wall_mm - 1e-9).all()
    cell_mm = max(float(np.diff(planes).max()) for planes in cells.planes)
    assert (compute_depths_mm(cells.is_needed).min(axis=0) <= np.sqrt(3.0) * (wall_mm + 2.0 * cell_mm)).all()


def test_kept_interior_is_needed(cost: CostModel) -> None:
    triangles = make_block(Rotation.from_rotvec([0.3, 0.2, 0.1]))
    grid = make_grid(triangles, cost, 6, 10.0, keeps_interior=True)
    kept_cells, shell_cells = (
        refine_cells(grid, triangles, 10.0, keeps_interior, 200_000) for keeps_interior in (True, False)
    )
    assert (kept_cells.is_needed >= shell_cells.is_needed).all()
    volume_mm3 = np.prod(np.meshgrid(*map(np.diff, kept_cells.planes), indexing="ij"), axis=0)
    assert volume_mm3[kept_cells.is_needed].sum() >= np.prod(SIDES_MM)
    assert volume_mm3[shell_cells.is_needed].sum() < np.prod(SIDES_MM)


def measure_uncovered_cells(cells: NeededCells, boxes_mm: np.ndarray) -> float:
    """Sum the uncovered shares of the needed cells, cell by cell."""
    covered_shares = np.zeros(cells.is_needed.shape)
    for box_mm in boxes_mm:
        x, y, z = (
            np.clip(np.minimum(box_mm[1, a], p[1:]) - np.maximum(box_mm[0, a], p[:-1]), 0.0, None)
            / np.diff(p)
            for a, p in enumerate(cells.planes)
        )
        covered_shares += x[:, None, None] * y[:, None] * z
    return float(np.where(cells.is_needed, 1.0 - covered_shares, 0.0).sum())


@given(st.integers(0, 10**6), st.booleans())
@settings(max_examples=200, deadline=None)
def test_boxes_are_a_partition_if_every_needed_cell_is_covered(seed: int, shrinks: bool) -> None:
    """Cut a block into boxes at random planes; perhaps shrink them, so that cells may be left open."""
    rng = np.random.default_rng(seed)
    planes = tuple(np.cumsum(rng.uniform(0.5, 3.0, rng.integers(3, 7))) for _ in range(3))
    is_needed = rng.random([len(p) - 1 for p in planes]) < rng.choice([0.1, 0.5, 1.0])
    cells = NeededCells(planes, is_needed)
    boxes_mm = np.array([[[p[0] - 1.0 for p in planes], [p[-1] + 1.0 for p in planes]]])
    for _ in range(rng.integers(0, 6)):
        i, axis = rng.integers(len(boxes_mm)), rng.integers(3)
        low_mm, high_mm = boxes_mm[i, :, axis]
        cut_mm = rng.choice([rng.uniform(low_mm, high_mm), (low_mm + high_mm) / 2.0])
        boxes_mm = np.concatenate([boxes_mm, boxes_mm[i : i + 1]])
        boxes_mm[i, 1, axis] = boxes_mm[-1, 0, axis] = cut_mm
    if shrinks:
        sides, axis = rng.integers(2), rng.integers(3)
        boxes_mm[rng.integers(len(boxes_mm)), sides, axis] += (0.5 - sides) * rng.choice([0.02, 0.4])
    if (boxes_mm[:, 0] < boxes_mm[:, 1]).all():
        assert cells.is_partition(boxes_mm) == (measure_uncovered_cells(cells, boxes_mm) < 1e-6)


@given(st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_bounds_of_needed_cells_in_a_box(seed: int) -> None:
    """Compare with the cells one by one; the planes of the box are on cells and between them."""
    rng = np.random.default_rng(seed)
    planes = tuple(np.cumsum(rng.uniform(1.0, 3.0, 8)) for _ in range(3))
    cells = NeededCells((planes[0], planes[1], planes[2]), rng.random((7, 7, 7)) < rng.choice([0.02, 0.3]))
    ends = [np.sort(rng.choice(np.concatenate([p, rng.uniform(p[0], p[-1], 4)]), 2, False)) for p in planes]
    box_mm = np.array(ends).T
    lows, highs = (
        np.stack([planes[a][index + side] for a, index in enumerate(np.nonzero(cells.is_needed))], axis=1)
        for side in (0, 1)
    )
    lows, highs = np.maximum(lows, box_mm[0]), np.minimum(highs, box_mm[1])
    is_inside = (highs - lows > 1e-6).all(axis=1)
    expected_mm = (
        np.array([lows[is_inside].min(axis=0), highs[is_inside].max(axis=0)]) if is_inside.any() else box_mm
    )
    np.testing.assert_allclose(cells.find_needed_bounds_mm(box_mm), expected_mm)


def test_bounds_include_cells_within_a_margin() -> None:
    planes = np.array([0.0, 10.0, 20.0, 30.0])
    is_needed = np.zeros((3, 3, 3), dtype=bool)
    is_needed[0, 0, 0] = is_needed[2, 1, 1] = True
    cells = NeededCells((planes, planes, planes), is_needed)
    box_mm = np.array([[0.0, 0.0, 0.0], [30.0, 30.0, 8.0]])
    assert cells.find_needed_bounds_mm(box_mm, 1.0).tolist() == [[0.0, 0.0, 0.0], [10.0, 10.0, 8.0]]
    assert cells.find_needed_bounds_mm(box_mm, 3.0).tolist() == [[0.0, 0.0, 0.0], [30.0, 20.0, 8.0]]
    outside_mm = np.array([[0.0, 0.0, 21.0], [9.0, 9.0, 28.0]])
    assert cells.find_needed_bounds_mm(outside_mm, 12.0).tolist() == outside_mm.tolist()
