"""Grid, prices and search give equal times for mirrored models and exchanged axes."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.engines.guillotine import Partitioner
from decompose.grid import GridRules, build_grid, price_boxes
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter

PRINTER = TargetPrinter("cube", ((60.0, 60.0, 60.0),))
PRINTER_COUNT = 12


def compute_makespan_s(triangles: np.ndarray, cost: CostModel) -> float:
    grid = build_grid(triangles, 6, GridRules(0.0, True, cost.overhang_cos, cost.skin_cos))
    solver = Partitioner(price_boxes(grid, [PRINTER], cost))
    result = solver.find_min_makespan_s(PRINTER_COUNT, 0.0, tolerance_s=0.01)
    assert result is not None
    return result


@pytest.mark.parametrize("axes", [(1, 2, 0), (1, 0, 2)])
@pytest.mark.parametrize("signs", [(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, -1.0)])
def test_times_of_rotated_grids_are_equal(
    axes: tuple[int, int, int],
    signs: tuple[float, float, float],
    triangles: np.ndarray,
    cost: CostModel,
) -> None:
    placed_triangles = (triangles * signs)[:, :, list(axes)]
    is_mirrored = np.prod(signs) * np.linalg.det(np.eye(3)[list(axes)]) < 0.0
    # A mirrored face points inwards unless its corners are reversed.
    placed_triangles = placed_triangles[:, ::-1] if is_mirrored else placed_triangles
    assert compute_makespan_s(np.ascontiguousarray(placed_triangles), cost) == pytest.approx(
        compute_makespan_s(triangles, cost), rel=1e-4
    )
