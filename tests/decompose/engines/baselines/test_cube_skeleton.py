"""The engine `cube-skeleton`: a hollow shell that is cut by the sides of a cube inside it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.decompose import decompose_model
from decompose.engines.baselines import cube_skeleton
from decompose.engines.baselines.cube_skeleton import _PieceMerger
from decompose.engines.baselines.hollow import (
    ACCURACY_MM,
    cover_with_boxes,
    find_largest_cube,
    hollow_model,
    list_cubes_around,
    move_planes_to_cube,
    refine_cube,
    remove_diagonal_cells,
)
from decompose.errors import NoFit
from decompose.geometry import Model, Solid, round_triangles
from decompose.grid import Cell, GridRules, build_grid, fill_grid, find_flat_faces
from decompose.options import Engine, Interior, Options
from decompose.pieces import Piece, list_box_planes
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

PRINTER = TargetPrinter("plus", ((206.9, 190.9, 205.0),))
OPTIONS = Options(Engine.CUBE_SKELETON, fit_first_layer=False, prove=False)

shapes = st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 4))


def make_printers(count: int) -> list[TargetPrinter]:
    return [replace(PRINTER, name=str(i)) for i in range(count)]


def make_ball(radius_mm: float) -> Model:
    sphere = trimesh.creation.icosphere(2, radius_mm)
    return Model(Solid.from_arrays(sphere.vertices, sphere.faces), (), 1.0)


@settings(max_examples=80, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.0, 1.0))
def test_blocks_cover_each_cell_once(shape: tuple[int, int, int], seed: int, share: float) -> None:
    cells = np.random.default_rng(seed).random(shape) < share
    cover_count = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in cover_with_boxes(cells):
        cover_count[x0:x1, y0:y1, z0:z1] += 1
    assert (cover_count == cells).all()


@settings(max_examples=80, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.3, 1.0))
def test_largest_cube_is_found(shape: tuple[int, int, int], seed: int, share: float) -> None:
    cells = np.random.default_rng(seed).random(shape) < share
    result = find_largest_cube(cells)
    sizes = [
        n
        for n in range(1, min(shape) + 1)
        for x, y, z in np.ndindex(*(s - n + 1 for s in shape))
        if cells[x : x + n, y : y + n, z : z + n].all()
    ]
    if result is None:
        assert not sizes
        return
    assert result[3] - result[0] == result[4] - result[1] == result[5] - result[2] == max(sizes)
    for x0, y0, z0, x1, y1, z1 in [result, *list_cubes_around(result, cells)]:
        assert cells[x0:x1, y0:y1, z0:z1].all()
        assert x1 - x0 == y1 - y0 == z1 - z0 <= max(sizes)


@settings(max_examples=80, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.0, 1.0))
def test_cells_of_the_shell_meet_in_faces_only(shape: tuple[int, int, int], seed: int, share: float) -> None:
    old_cells = np.random.default_rng(seed).random(shape) < share
    cells = remove_diagonal_cells(old_cells)
    assert not (cells & ~old_cells).any()
    for a, b in ((0, 1), (0, 2), (1, 2)):
        plane_cells = np.moveaxis(cells, (a, b), (0, 1))
        near, far, left, right = (
            plane_cells[:-1, :-1],
            plane_cells[1:, 1:],
            plane_cells[1:, :-1],
            plane_cells[:-1, 1:],
        )
        assert not ((near & far & ~left & ~right) | (left & right & ~near & ~far)).any()
    box = np.zeros(shape, bool)
    box[: (shape[0] + 1) // 2, : (shape[1] + 1) // 2, : (shape[2] + 1) // 2] = True
    assert remove_diagonal_cells(old_cells | box, box)[box].all()


def test_shell_keeps_the_wall(cost: CostModel) -> None:
    solid = make_ball(100.0).solid
    vertices, faces = solid.arrays()
    grid = build_grid(vertices[faces], 20, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    shell = hollow_model(solid, grid)
    surroundings = Solid.box((-130,) * 3, (130,) * 3).subtract(solid)
    removed_solid = solid.subtract(shell.solid)
    assert removed_solid.volume_mm3 > 0.2 * solid.volume_mm3
    assert surroundings.measure_gap_mm(removed_solid, 12.0) >= 12.0 - 1e-6
    assert shell.solid.volume_mm3 + removed_solid.volume_mm3 == pytest.approx(solid.volume_mm3, rel=1e-9)


@settings(max_examples=10, deadline=None)
@given(
    size_mm=st.tuples(*[st.floats(60.0, 120.0)] * 3),
    wall_mm=st.floats(0.0, 12.0),
    share=st.tuples(*[st.floats(0.2, 0.8)] * 3),
)
def test_cube_in_a_block_grows_until_it_reaches_the_wall(
    size_mm: tuple[float, float, float], wall_mm: float, share: tuple[float, float, float]
) -> None:
    middle = wall_mm + 5.0 + np.array(share) * (np.array(size_mm) - 2.0 * (wall_mm + 5.0))
    first_cube = np.array([middle - 5.0, middle + 5.0])
    min_mm = max(wall_mm, ACCURACY_MM)
    cube = refine_cube(Solid.box((0, 0, 0), size_mm), first_cube, 100.0, wall_mm)
    edges_mm = cube[1] - cube[0]
    assert edges_mm == pytest.approx([edges_mm[0]] * 3)
    assert (
        min(size_mm) - 2.0 * min_mm - 4.0 * ACCURACY_MM <= edges_mm[0] <= min(size_mm) - 2.0 * min_mm + 1e-6
    )
    assert (cube[0] >= min_mm - 1e-6).all() and (cube[1] <= np.array(size_mm) - min_mm + 1e-6).all()
    assert (cube[0] <= first_cube[0]).all() and (cube[1] >= first_cube[1]).all()
    limited_cube = refine_cube(Solid.box((0, 0, 0), size_mm), first_cube, 1.0, wall_mm)
    assert (limited_cube[0] >= first_cube[0] - 2.0).all() and (limited_cube[1] <= first_cube[1] + 2.0).all()


def test_grid_planes_lie_on_the_sides_of_the_refined_cube(cost: CostModel) -> None:
    """Use a ball on a plate whose upper face lies in the plane of the cube's lower side."""
    body = make_ball(100.0).solid
    vertices, faces = body.arrays()
    rough_grid = build_grid(vertices[faces], 20, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    first_cube = find_largest_cube(hollow_model(body, rough_grid).cavity)
    assert first_cube is not None
    side_mm = float(refine_cube(body, np.array(rough_grid.find_bounds_mm(first_cube)), 10.0, 12.0)[0, 2])
    solid = Solid.union([body, Solid.box((-90, -90, side_mm - 20.0), (90, 90, side_mm + 0.5))])
    vertices, faces = solid.arrays()
    grid = build_grid(vertices[faces], 20, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    first_cube = find_largest_cube(hollow_model(solid, grid).cavity)
    assert first_cube is not None
    cube_mm = refine_cube(solid, np.array(grid.find_bounds_mm(first_cube)), 10.0, 12.0)
    planes, cube = move_planes_to_cube(solid, grid, cube_mm)
    assert all((np.diff(positions) > 0.0).all() for positions in planes)
    sides_mm = np.array([[planes[a][cube[a]] for a in range(3)], [planes[a][cube[a + 3]] for a in range(3)]])
    assert (sides_mm[0] >= cube_mm[0]).all() and (sides_mm[1] <= cube_mm[1]).all()
    for axis in range(3):
        assert find_flat_faces(vertices[faces], axis).measure_gaps_mm(sides_mm[:, axis]).min() >= -1e-9
    old_bounds_mm = grid.find_bounds_mm(first_cube)
    assert np.prod(sides_mm[1] - sides_mm[0]) > 1.1 * np.prod(old_bounds_mm[1] - old_bounds_mm[0])
    grid = fill_grid(vertices[faces], planes, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    cube_cells = tuple(slice(cube[a], cube[a + 3]) for a in range(3))
    assert (grid.cells[cube_cells] == Cell.INTERNAL).all()
    assert hollow_model(solid, grid, cube).cavity[cube_cells].all()


@pytest.mark.parametrize(("share", "chosen_index"), [(0.4, 1), (1.3, 0)])
def test_cube_whose_parts_end_first_is_used(
    share: float, chosen_index: int, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Expect the refined cube of a ball if its parts end sooner, otherwise the first cube."""
    cuts, cut_shell = [], cube_skeleton._cut_shell

    def scale_cube(_: Solid, cube_mm: np.ndarray, *__: object) -> np.ndarray:
        middle = cube_mm.mean(axis=0)
        return np.asarray(middle + share * (cube_mm - middle))

    def record_cut(*args: Any) -> tuple[Piece, ...]:
        cuts.append(cut_shell(*args))
        return cuts[-1]

    monkeypatch.setattr(cube_skeleton, "refine_cube", scale_cube)
    monkeypatch.setattr(cube_skeleton, "_cut_shell", record_cut)
    problem = Problem(make_ball(95.0), tuple(make_printers(40)), cost, OPTIONS)
    assert cube_skeleton.cut_by_cube_skeleton(problem).pieces is cuts[chosen_index]
    assert problem.compute_makespan_s(cuts[chosen_index]) < problem.compute_makespan_s(cuts[1 - chosen_index])


def test_cubes_are_compared_by_the_times_of_their_pieces(
    cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compare two equal pieces with a larger and a smaller one, which end sooner if one printer is faster."""

    def make_cubes(*sizes_mm: float) -> tuple[Piece, ...]:
        boxes = [np.array([(0.0,) * 3, (size,) * 3]) for size in sizes_mm]
        return tuple(Piece(Solid.box(*box), list_box_planes(box), box[None]) for box in boxes)

    equal_pieces, unequal_pieces = make_cubes(55.0, 55.0), make_cubes(60.0, 30.0)
    slow_printer, quick_printer = (
        replace(PRINTER, name="slow", time_factor=1.5),
        replace(PRINTER, name="quick", time_factor=0.5),
    )
    for result in ([equal_pieces, unequal_pieces], [unequal_pieces, equal_pieces]):
        cuts = iter(result)
        monkeypatch.setattr(cube_skeleton, "_cut_shell", lambda *_, cuts=cuts: next(cuts))
        problem = Problem(make_ball(95.0), (slow_printer, quick_printer), cost, OPTIONS)
        assert cube_skeleton.cut_by_cube_skeleton(problem).pieces is unequal_pieces


@pytest.mark.parametrize("interior", Interior)
def test_engine_returns_checked_parts(interior: Interior, cost: CostModel) -> None:
    model = make_ball(150.0)
    options = replace(OPTIONS, interior=interior)
    result = decompose_model(model, make_printers(20), options, cost)
    assert 8 <= len(result.parts) <= 20
    for part in result.parts:
        assert PRINTER.fits(*(np.ptp(part.build_printing_mesh()[0], axis=0) - 1e-6))
    printed_mm3 = sum(p.solid.volume_mm3 for p in result.parts)
    assert (0.3 if interior is Interior.LEAVE else 0.5) < printed_mm3 / model.solid.volume_mm3 < 0.9
    if interior is Interior.LEAVE:
        second_result = decompose_model(model, make_printers(20), options, cost)
        assert [p.solid.volume_mm3 for p in second_result.parts] == [p.solid.volume_mm3 for p in result.parts]


def test_fewer_printers_get_merged_pieces(cost: CostModel) -> None:
    small_ball = make_ball(95.0)
    counts = [len(decompose_model(small_ball, make_printers(n), OPTIONS, cost).parts) for n in (30, 5)]
    assert counts[0] >= 20
    assert counts[1] == 5


def test_faithful_form_reproduces_the_published_parts(cost: CostModel) -> None:
    faithful_options = replace(OPTIONS, faithful=True)
    with pytest.raises(NoFit, match="each on its own printer, but there are 2") as error:
        decompose_model(make_ball(95.0), make_printers(2), faithful_options, cost)
    needed_printer_count = error.value.needed_printer_count
    # There are 26 parts, which are merged in pairs at most.
    assert needed_printer_count is not None and needed_printer_count >= 13
    assert (
        len(decompose_model(make_ball(95.0), make_printers(26), faithful_options, cost).parts)
        == needed_printer_count
    )
    with pytest.raises(NoFit, match=r"of the \d+ parts that cube-skeleton makes for 26 printers fits? none"):
        decompose_model(make_ball(330.0), make_printers(26), faithful_options, cost)


def test_model_too_thin_for_a_cube_is_refused(cost: CostModel) -> None:
    sheet = Model(Solid.box((0, 0, 0), (400, 150, 3)), (), 1.0)
    result = decompose_model(sheet, make_printers(4), OPTIONS, cost)
    assert 2 <= len(result.parts) <= 4
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(400 * 150 * 3)
    with pytest.raises(NoFit, match="no room for a cube"):
        decompose_model(sheet, make_printers(4), replace(OPTIONS, faithful=True), cost)


def test_solid_model_keeps_its_cube(cost: CostModel) -> None:
    block = Model(Solid.box((0, 0, 0), (260, 18, 18)), (), 1.0)
    result = decompose_model(block, make_printers(6), OPTIONS, cost)
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(260 * 18 * 18)


def test_pieces_that_would_meet_along_an_edge_stay_apart(cost: CostModel) -> None:
    boxes = np.array(
        [[(0, 0, 0), (10, 10, 10)], [(10, 10, 0), (20, 20, 10)], [(0, 0, 10), (20, 20, 20)]], dtype=float
    )
    pieces = [Piece(Solid.box(*box), list_box_planes(box), box[None]) for box in boxes]
    model = Model(Solid.union([piece.solid for piece in pieces]), (), 1.0)
    merger = _PieceMerger(pieces, Problem(model, tuple(make_printers(1)), cost, OPTIONS))
    merger.merge_to_count(1)
    merged_pieces = merger.list_merged_pieces()
    assert len(merged_pieces) == 2
    assert all(round_triangles(*piece.solid.arrays()) is not None for piece in merged_pieces)
    assert round_triangles(*model.solid.arrays()) is None
