"""Distance from the surface to the cells that are omitted from the print."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from decompose.geometry import Solid
from decompose.grid import Cell, GridRules, build_grid
from decompose.print_time import CostModel


def make_ball() -> Solid:
    sphere = trimesh.creation.icosphere(4, 150.0)
    return Solid.from_arrays(sphere.vertices, sphere.faces)


def make_tube() -> Solid:
    """Make a thick tube that is rotated off the axes."""
    ring = trimesh.creation.annulus(r_min=40.0, r_max=170.0, height=300.0)
    ring.apply_transform(trimesh.transformations.rotation_matrix(0.5, [1.0, 0.3, 0.1]))
    return Solid.from_arrays(ring.vertices, ring.faces)


def make_block() -> Solid:
    return Solid.box((0, 0, 0), (300, 260, 220))


def make_rotated_block() -> Solid:
    box = trimesh.creation.box((300.0, 260.0, 280.0))
    box.apply_transform(trimesh.transformations.rotation_matrix(0.7, [0.2, 1.0, 0.4]))
    return Solid.from_arrays(box.vertices, box.faces)


@pytest.mark.parametrize("min_wall_mm", [3.0, 25.0])
@pytest.mark.parametrize("make_solid", [make_ball, make_tube, make_block, make_rotated_block])
def test_hollow_leaves_the_minimum_wall(
    make_solid: Callable[[], Solid], min_wall_mm: float, cost: CostModel
) -> None:
    solid = make_solid()
    vertices, faces = solid.arrays()
    grid = build_grid(vertices[faces], 14, GridRules(min_wall_mm, False, cost.overhang_cos, cost.skin_cos))
    hollow_cells = np.argwhere((grid.cells == Cell.INTERNAL) & ~grid.is_needed)
    assert len(hollow_cells) > 0
    hollow = Solid.union([Solid.box(*grid.find_bounds_mm((*cell, *(cell + 1)))) for cell in hollow_cells])
    lo, hi = solid.bounds_mm
    surroundings = Solid.box(lo - 60.0, hi + 60.0).subtract(solid)
    cell_mm = max(float(np.diff(planes).max()) for planes in grid.planes)
    gap_mm = surroundings.measure_gap_mm(hollow, min_wall_mm + 3.0 * cell_mm)
    assert min_wall_mm - 1e-6 <= gap_mm <= min_wall_mm + np.sqrt(3.0) * cell_mm


def test_grid_supports_no_wall_and_a_kept_interior(cost: CostModel) -> None:
    vertices, faces = make_block().arrays()
    boundary_grid = build_grid(vertices[faces], 10, GridRules(0.0, False, cost.overhang_cos, cost.skin_cos))
    solid_grid = build_grid(vertices[faces], 10, GridRules(25.0, True, cost.overhang_cos, cost.skin_cos))
    assert (boundary_grid.is_needed == (boundary_grid.cells == Cell.BOUNDARY)).all()
    assert solid_grid.is_needed.all()
