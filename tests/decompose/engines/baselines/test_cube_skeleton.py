"""The engine `cube-skeleton`: a hollow shell cut by the sides of a cube inside."""

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
from decompose.engines.baselines.cube_skeleton import _Merging
from decompose.engines.baselines.hollow import (
    ACCURACY_MM,
    cover_by_boxes,
    find_largest_cube,
    hollow_model,
    list_cubes_around,
    move_planes_to,
    refine_cube,
    remove_diagonals,
)
from decompose.errors import NoFit
from decompose.geometry import Model, Solid, round_triangles
from decompose.grid import CLEAR_MM, Cell, GridRules, build_grid, fill_grid, find_flat_coordinates
from decompose.options import Engine, Interior, Options
from decompose.pieces import Piece, list_box_planes
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from decompose.problem import Problem

ROOM = PrinterRoom("plus", ((206.9, 190.9, 205.0),))
MENDED = Options(Engine.CUBE_SKELETON, fit_first_layer=False, prove=False)

shapes = st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 4))


def printers(count: int) -> list[PrinterRoom]:
    return [replace(ROOM, name=str(i)) for i in range(count)]


def ball(radius_mm: float) -> Model:
    sphere = trimesh.creation.icosphere(2, radius_mm)
    return Model(Solid.from_arrays(sphere.vertices, sphere.faces), (), 1.0)


@settings(max_examples=80, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.0, 1.0))
def test_blocks_cover_the_cells_once(shape: tuple[int, int, int], seed: int, share: float) -> None:
    cells = np.random.default_rng(seed).random(shape) < share
    count = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in cover_by_boxes(cells):
        count[x0:x1, y0:y1, z0:z1] += 1
    assert (count == cells).all()


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
    before = np.random.default_rng(seed).random(shape) < share
    cells = remove_diagonals(before)
    assert not (cells & ~before).any()
    for a, b in ((0, 1), (0, 2), (1, 2)):
        view = np.moveaxis(cells, (a, b), (0, 1))
        near, far, left, right = view[:-1, :-1], view[1:, 1:], view[1:, :-1], view[:-1, 1:]
        assert not ((near & far & ~left & ~right) | (left & right & ~near & ~far)).any()
    box = np.zeros(shape, bool)
    box[: (shape[0] + 1) // 2, : (shape[1] + 1) // 2, : (shape[2] + 1) // 2] = True
    assert remove_diagonals(before | box, box)[box].all()


def test_shell_keeps_the_wall(cost: CostModel) -> None:
    solid = ball(100.0).solid
    vertices, faces = solid.arrays()
    grid = build_grid(vertices[faces], 20, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    shell = hollow_model(solid, grid)
    outside = Solid.box((-130,) * 3, (130,) * 3).subtract(solid)
    taken = solid.subtract(shell.solid)
    assert taken.volume_mm3 > 0.2 * solid.volume_mm3
    assert outside.gap_mm(taken, 12.0) >= 12.0 - 1e-6
    assert shell.solid.volume_mm3 + taken.volume_mm3 == pytest.approx(solid.volume_mm3, rel=1e-9)


@settings(max_examples=10, deadline=None)
@given(
    size=st.tuples(*[st.floats(60.0, 120.0)] * 3),
    wall_mm=st.floats(0.0, 12.0),
    share=st.tuples(*[st.floats(0.2, 0.8)] * 3),
)
def test_cube_in_a_block_grows_until_it_reaches_the_wall(
    size: tuple[float, float, float], wall_mm: float, share: tuple[float, float, float]
) -> None:
    middle = wall_mm + 5.0 + np.array(share) * (np.array(size) - 2.0 * (wall_mm + 5.0))
    started = np.array([middle - 5.0, middle + 5.0])
    min_mm = max(wall_mm, ACCURACY_MM)
    cube = refine_cube(Solid.box((0, 0, 0), size), started, 100.0, wall_mm)
    edges = cube[1] - cube[0]
    assert edges == pytest.approx([edges[0]] * 3)
    assert min(size) - 2.0 * min_mm - 4.0 * ACCURACY_MM <= edges[0] <= min(size) - 2.0 * min_mm + 1e-6
    assert (cube[0] >= min_mm - 1e-6).all() and (cube[1] <= np.array(size) - min_mm + 1e-6).all()
    assert (cube[0] <= started[0]).all() and (cube[1] >= started[1]).all()
    near = refine_cube(Solid.box((0, 0, 0), size), started, 1.0, wall_mm)
    assert (near[0] >= started[0] - 2.0).all() and (near[1] <= started[1] + 2.0).all()


def test_grid_planes_lie_on_the_sides_of_the_refined_cube(cost: CostModel) -> None:
    """A ball on a plate whose upper face lies in the plane of the lower side of the cube."""
    body = ball(100.0).solid
    vertices, faces = body.arrays()
    rough = build_grid(vertices[faces], 20, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    started = find_largest_cube(hollow_model(body, rough).cavity)
    assert started is not None
    side_mm = float(refine_cube(body, np.array(rough.bounds_mm(started)), 10.0, 12.0)[0, 2])
    solid = Solid.union([body, Solid.box((-90, -90, side_mm - 20.0), (90, 90, side_mm + 0.5))])
    vertices, faces = solid.arrays()
    grid = build_grid(vertices[faces], 20, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    started = find_largest_cube(hollow_model(solid, grid).cavity)
    assert started is not None
    cube_mm = refine_cube(solid, np.array(grid.bounds_mm(started)), 10.0, 12.0)
    planes, cube = move_planes_to(solid, grid, cube_mm)
    assert all((np.diff(positions) > 0.0).all() for positions in planes)
    moved = np.array([[planes[a][cube[a]] for a in range(3)], [planes[a][cube[a + 3]] for a in range(3)]])
    assert (moved[0] >= cube_mm[0]).all() and (moved[1] <= cube_mm[1]).all()
    for axis in range(3):
        flats = find_flat_coordinates(vertices[faces], axis)
        assert np.abs(moved[:, axis, None] - flats).min(initial=np.inf) >= CLEAR_MM - 1e-9
    before = grid.bounds_mm(started)
    assert np.prod(moved[1] - moved[0]) > 1.1 * np.prod(before[1] - before[0])
    grid = fill_grid(vertices[faces], planes, GridRules(12.0, False, cost.overhang_cos, cost.skin_cos))
    inside = tuple(slice(cube[a], cube[a + 3]) for a in range(3))
    assert (grid.cells[inside] == Cell.INTERNAL).all()
    assert hollow_model(solid, grid, cube).cavity[inside].all()


@pytest.mark.parametrize(("share", "taken"), [(0.4, 1), (1.3, 0)])
def test_cube_whose_parts_end_first_is_used(
    share: float, taken: int, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ball takes the refined cube if it is smaller, and refuses one that is larger."""
    cuts, cut = [], cube_skeleton._cut_shell

    def scale_cube(_: Solid, cube_mm: np.ndarray, *__: object) -> np.ndarray:
        middle = cube_mm.mean(axis=0)
        return np.asarray(middle + share * (cube_mm - middle))

    def record_cut(*args: Any) -> tuple[Piece, ...]:
        cuts.append(cut(*args))
        return cuts[-1]

    monkeypatch.setattr(cube_skeleton, "refine_cube", scale_cube)
    monkeypatch.setattr(cube_skeleton, "_cut_shell", record_cut)
    problem = Problem(ball(95.0), tuple(printers(40)), cost, MENDED)
    assert cube_skeleton.cut_by_cube_skeleton(problem).pieces is cuts[taken]
    assert problem.makespan_s(cuts[taken]) < problem.makespan_s(cuts[1 - taken])


def test_cubes_are_compared_by_the_times_of_their_pieces(
    cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two equal pieces end later than a larger and a smaller one if one printer is faster."""

    def cubes(*sizes_mm: float) -> tuple[Piece, ...]:
        boxes = [np.array([(0.0,) * 3, (size,) * 3]) for size in sizes_mm]
        return tuple(Piece(Solid.box(*box), list_box_planes(box), box[None]) for box in boxes)

    equal, unequal = cubes(55.0, 55.0), cubes(60.0, 30.0)
    slow, quick = replace(ROOM, name="slow", time_factor=1.5), replace(ROOM, name="quick", time_factor=0.5)
    for result in ([equal, unequal], [unequal, equal]):
        cuts = iter(result)
        monkeypatch.setattr(cube_skeleton, "_cut_shell", lambda *_, cuts=cuts: next(cuts))
        problem = Problem(ball(95.0), (slow, quick), cost, MENDED)
        assert cube_skeleton.cut_by_cube_skeleton(problem).pieces is unequal


@pytest.mark.parametrize("interior", Interior)
def test_engine_returns_checked_parts(interior: Interior, cost: CostModel) -> None:
    model = ball(150.0)
    options = replace(MENDED, interior=interior)
    result = decompose_model(model, printers(20), options, cost)
    assert 8 <= len(result.parts) <= 20
    for part in result.parts:
        assert ROOM.fits(*(np.ptp(part.printing_mesh()[0], axis=0) - 1e-6))
    printed = sum(p.solid.volume_mm3 for p in result.parts)
    assert (0.3 if interior is Interior.LEAVE else 0.5) < printed / model.solid.volume_mm3 < 0.9
    if interior is Interior.LEAVE:
        repeated = decompose_model(model, printers(20), options, cost)
        assert [p.solid.volume_mm3 for p in repeated.parts] == [p.solid.volume_mm3 for p in result.parts]


def test_fewer_printers_get_merged_pieces(cost: CostModel) -> None:
    small = ball(95.0)
    counts = [len(decompose_model(small, printers(n), MENDED, cost).parts) for n in (30, 5)]
    assert counts[0] >= 20
    assert counts[1] == 5


def test_faithful_form_reproduces_the_published_parts(cost: CostModel) -> None:
    faithful = replace(MENDED, faithful=True)
    with pytest.raises(NoFit, match="each on a printer of its own, and there are 2") as raised:
        decompose_model(ball(95.0), printers(2), faithful, cost)
    needed = raised.value.printers_needed
    assert needed is not None and needed >= 13  # pairs, once, of 26
    assert len(decompose_model(ball(95.0), printers(26), faithful, cost).parts) == needed
    with pytest.raises(NoFit, match=r"of the \d+ parts that cube-skeleton makes for 26 printers fit none"):
        decompose_model(ball(330.0), printers(26), faithful, cost)


def test_model_too_thin_for_a_cube_is_refused(cost: CostModel) -> None:
    sheet = Model(Solid.box((0, 0, 0), (400, 150, 3)), (), 1.0)
    result = decompose_model(sheet, printers(4), MENDED, cost)
    assert 2 <= len(result.parts) <= 4
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(400 * 150 * 3)
    with pytest.raises(NoFit, match="no room for a cube"):
        decompose_model(sheet, printers(4), replace(MENDED, faithful=True), cost)


def test_solid_model_keeps_its_cube(cost: CostModel) -> None:
    block = Model(Solid.box((0, 0, 0), (260, 18, 18)), (), 1.0)
    result = decompose_model(block, printers(6), MENDED, cost)
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(260 * 18 * 18)


def test_pieces_that_would_meet_along_an_edge_stay_apart(cost: CostModel) -> None:
    boxes = np.array(
        [[(0, 0, 0), (10, 10, 10)], [(10, 10, 0), (20, 20, 10)], [(0, 0, 10), (20, 20, 20)]], dtype=float
    )
    pieces = [Piece(Solid.box(*box), list_box_planes(box), box[None]) for box in boxes]
    model = Model(Solid.union([piece.solid for piece in pieces]), (), 1.0)
    merging = _Merging(pieces, Problem(model, tuple(printers(1)), cost, MENDED))
    merging.merge_down_to(1)
    merged = merging.list_merged_pieces()
    assert len(merged) == 2
    assert all(round_triangles(*piece.solid.arrays()) is not None for piece in merged)
    assert round_triangles(*model.solid.arrays()) is None
