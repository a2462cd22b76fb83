"""Tables of a grid, compared with boolean operations on solids."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.geometry import Solid
from decompose.grid import (
    VOLUME,
    BoxTables,
    Cell,
    Grid,
    GridRules,
    build_grid,
    choose_cell_counts,
    count_cuts,
    find_flat_faces,
    index_box,
    price_boxes,
)
from decompose.grid.planes import PLANE_CLEARANCE_MM, FlatFaces, place_planes
from decompose.print_time import CostModel, PrintTimeSettings, price_axis_poses_s
from decompose.printers import TargetPrinter

Triangles = np.ndarray
HUGE_PRINTER = TargetPrinter("huge", ((1e4, 1e4, 1e4),))


@pytest.fixture(scope="module")
def grid(triangles: Triangles) -> Grid:
    return build_grid(triangles, 7, GridRules(0.0, True, 0.7, 0.75))


@pytest.fixture(scope="module")
def default_cost() -> CostModel:
    support_angle_deg = math.degrees(math.asin(0.7))
    cost = CostModel.from_settings(PrintTimeSettings())
    return replace(cost, effective_support_angle_deg=support_angle_deg, skin_cos=0.75)


@pytest.fixture(scope="module")
def tables(grid: Grid, default_cost: CostModel) -> BoxTables:
    return price_boxes(grid, [HUGE_PRINTER], default_cost)


@st.composite
def draw_box(draw: st.DrawFn, shape: tuple[int, int, int]) -> tuple[int, ...]:
    ends = [sorted(draw(st.lists(st.integers(0, n), min_size=2, max_size=2, unique=True))) for n in shape]
    return (*(e[0] for e in ends), *(e[1] for e in ends))


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_sums_over_a_box_equal_those_of_the_cut_solid(
    data: st.DataObject, grid: Grid, tables: BoxTables, default_cost: CostModel, ring_with_bar: Solid
) -> None:
    box = data.draw(draw_box(grid.shape))
    x0, y0, z0, x1, y1, z1 = box
    cells = (slice(x0, x1), slice(y0, y1), slice(z0, z1))
    clipped_solid = ring_with_bar.clip(*grid.find_bounds_mm(box))
    assert grid.sums[cells][..., VOLUME].sum() == pytest.approx(clipped_solid.volume_mm3, rel=1e-9, abs=1e-6)
    index = index_box(box, grid.shape)  # type: ignore[arg-type]
    if clipped_solid.is_empty:
        assert tables.trimmed_box[index] == -1
        return
    bounds_mm = grid.bounds_mm[cells].reshape(-1, 6)
    assert np.allclose(bounds_mm[:, :3].min(axis=0), clipped_solid.bounds_mm[0], atol=1e-9)
    assert np.allclose(bounds_mm[:, 3:].max(axis=0), clipped_solid.bounds_mm[1], atol=1e-9)
    # The table contains the price of the solid in its best pose, which depends on all other terms.
    if tables.trimmed_box[index] == index:
        times_s = price_axis_poses_s(*clipped_solid.arrays(), default_cost)
        assert tables.seconds[index] == pytest.approx(times_s.min(), rel=1e-6)
        assert tables.piece_counts[index] <= len(clipped_solid.list_pieces())


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_separate_rods_in_one_cell_are_counted_separately(
    data: st.DataObject, default_cost: CostModel
) -> None:
    """Use nine rods on a plate, several of which share a cell; without the plate, each rod is a piece."""
    rods = [
        Solid.box((x, y, 5.0), (x + 4.0, y + 4.0, 90.0)) for x in (3.0, 15.0, 27.0) for y in (3.0, 15.0, 27.0)
    ]
    comb = Solid.union([Solid.box((0.0, 0.0, 0.0), (60.0, 60.0, 10.0)), *rods])
    # Pieces are counted across the longest axis.
    rotation = np.roll(np.eye(3), data.draw(st.integers(0, 2)), axis=0)
    comb = comb.rotate(rotation)
    vertices, faces = comb.arrays()
    grid = build_grid(vertices[faces], 3, GridRules(0.0, True, 0.7, 0.75))
    printer = TargetPrinter("", ((data.draw(st.sampled_from((1e4, 70.0))),) * 3,))
    tables = price_boxes(grid, [printer], default_cost)
    box = data.draw(draw_box(grid.shape))
    index = index_box(box, grid.shape)  # type: ignore[arg-type]
    if tables.trimmed_box[index] == index and np.isfinite(tables.seconds[index]):
        assert tables.piece_counts[index] == len(comb.clip(*grid.find_bounds_mm(box)).list_pieces())


@settings(max_examples=20, deadline=None)
@given(axis=st.integers(0, 2), data=st.data())
def test_cut_areas_match_a_real_cut(axis: int, data: st.DataObject, grid: Grid, ring_with_bar: Solid) -> None:
    plane = data.draw(st.integers(1, grid.shape[axis] - 1))
    below, above = ring_with_bar.split(axis, float(grid.planes[axis][plane]))
    cut_mm2 = (below.area_mm2 + above.area_mm2 - ring_with_bar.area_mm2) / 2.0
    assert np.take(grid.cuts[axis], plane, axis=axis).sum() == pytest.approx(cut_mm2, rel=1e-7, abs=1e-5)


def test_cells_are_classified(grid: Grid, ring_with_bar: Solid) -> None:
    for cell in np.ndindex(grid.shape):
        x, y, z = cell
        lo, hi = grid.find_bounds_mm((x, y, z, x + 1, y + 1, z + 1))
        volume_mm3 = ring_with_bar.clip(lo, hi).volume_mm3
        if grid.cells[cell] == Cell.EXTERNAL:
            assert volume_mm3 == 0.0
        elif grid.cells[cell] == Cell.INTERNAL:
            assert volume_mm3 == pytest.approx(float(np.prod(hi - lo)))
    assert set(np.unique(grid.cells)) >= {Cell.EXTERNAL, Cell.BOUNDARY}


@pytest.mark.parametrize("min_wall_mm", [0.0, 10.0, 25.0])
def test_hollow_cells_keep_their_distance_from_the_surface(min_wall_mm: float) -> None:
    corners = Solid.box((0, 0, 0), (200, 160, 120)).arrays()
    grid = build_grid(corners[0][corners[1]], 12, GridRules(min_wall_mm, False, 0.7, 0.75))
    hollow_cells = np.argwhere((grid.cells == Cell.INTERNAL) & ~grid.is_needed)
    assert len(hollow_cells)
    lo = np.array([[grid.planes[a][c[a]] for a in range(3)] for c in hollow_cells])
    hi = np.array([[grid.planes[a][c[a] + 1] for a in range(3)] for c in hollow_cells])
    assert lo.min() >= min_wall_mm
    assert (np.array([200, 160, 120]) - hi).min() >= min_wall_mm


@given(
    flats_mm=st.lists(st.floats(0.0, 100.0), max_size=12, unique=True).map(sorted),
    count=st.integers(1, 20),
)
def test_planes_ascend_and_avoid_flat_faces(flats_mm: list[float], count: int) -> None:
    flat_faces = FlatFaces(np.array(flats_mm), np.full(len(flats_mm), PLANE_CLEARANCE_MM))
    planes = place_planes(0.0, 100.0, count, flat_faces)
    assert (np.diff(planes) > 0.0).all()
    assert planes[0] < 0.0
    assert planes[-1] > 100.0
    if len(flats_mm) == 1 and count > 1:
        assert np.abs(planes[1:-1] - flats_mm[0]).min() >= min(PLANE_CLEARANCE_MM, 0.2 * 100.0 / count) - 1e-9


def test_flat_faces_of_a_box_are_found() -> None:
    vertices, faces = Solid.box((1, 2, 3), (4, 5, 6)).arrays()
    flat_faces = [find_flat_faces(100.0 * vertices[faces], axis) for axis in range(3)]
    assert [f.coordinates_mm.tolist() for f in flat_faces] == [[100, 400], [200, 500], [300, 600]]
    assert all((f.clearances_mm == PLANE_CLEARANCE_MM).all() for f in flat_faces)


def test_plane_passes_a_small_flat_face() -> None:
    """Check a rounded plate whose small tip is flat: only the large faces keep planes at a distance."""
    plate = Solid.union([Solid.box((0, 0, 0), (40, 40, 20)), Solid.box((18, 18, 19), (22, 22, 25))])
    vertices, faces = plate.arrays()
    flat_faces = find_flat_faces(vertices[faces], 2)
    assert dict(zip(*flat_faces, strict=True)) == {0.0: 2.0, 20.0: 2.0, 25.0: 0.1}
    gaps_mm = flat_faces.measure_gaps_mm(np.array([19.0, 24.0, 25.0]))
    assert gaps_mm == pytest.approx([-1.0, 0.9, -0.1])


def test_cell_counts_follow_the_proportions_of_the_model() -> None:
    assert choose_cell_counts(np.array([300.0, 300.0, 300.0]), 15) == (15, 15, 15)
    nx, ny, nz = choose_cell_counts(np.array([355.0, 3.0, 355.0]), 15)
    assert (ny, nx) == (1, nz)
    assert choose_cell_counts(np.array([1.0, 1.0, 1.0]), 15) == (1, 1, 1)


@pytest.mark.parametrize("size_mm", [(450.0, 450.0, 1.0), (2000.0, 20.0, 20.0), (2000.0, 300.0, 2.0)])
def test_long_and_flat_grids_have_few_cuts(size_mm: tuple[float, float, float]) -> None:
    shape = choose_cell_counts(np.array(size_mm), 24)
    assert count_cuts(shape) <= 3e8
    assert max(shape) >= 2000.0 / 100.0  # no cell is longer than half a build volume


@pytest.mark.parametrize("size_mm", [(450.0, 450.0, 1.0), (2000.0, 20.0, 20.0), (450.0, 100.0, 100.0)])
def test_flat_model_has_about_as_many_boxes_as_a_cube(size_mm: tuple[float, float, float]) -> None:
    box_count = np.prod([n * (n + 1) // 2 for n in choose_cell_counts(np.array(size_mm), 15)])
    assert box_count <= 1.5 * (15 * 16 // 2) ** 3


def test_tables_are_the_same_when_threads_share_the_work(
    grid: Grid, tables: BoxTables, default_cost: CostModel
) -> None:
    with ThreadPoolExecutor(1) as executor:
        shared_tables = price_boxes(grid, [HUGE_PRINTER], default_cost, executor)
    for name in ("seconds", "trimmed_box", "piece_counts", "cut_mm2"):
        np.testing.assert_array_equal(getattr(shared_tables, name), getattr(tables, name))
