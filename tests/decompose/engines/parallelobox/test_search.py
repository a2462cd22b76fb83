"""Engine `parallelobox` on random tables and on a real grid."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.decompose import decompose_model
from decompose.engines.parallelobox import search
from decompose.engines.parallelobox.alignment import align_model, measure_overhang_mm2
from decompose.engines.parallelobox.attempts import SeedSource, draw_seed_sets, draw_seeds, run_attempts
from decompose.engines.parallelobox.growth import FREE_CELL, fill_voids, grow_blocks
from decompose.engines.parallelobox.growth_tables import (
    SPEED_MM_S,
    GrowthTables,
    make_paper_tables,
    make_time_tables,
)
from decompose.errors import NoFit
from decompose.geometry import Model, Solid, find_mirror, find_rotation_to_axis
from decompose.grid import BoxTables, Cell, Grid, GridRules, build_grid, index_box, price_boxes
from decompose.grid.box_index import find_interval_ends
from decompose.options import Engine, Options, ParalleloboxOptions, Score
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import problem as problem_module

Shape = tuple[int, int, int]


def make_random_tables(shape: Shape, seed: int) -> GrowthTables:
    """Make random tables, in which some boxes are too large or in two pieces, and single cells fit."""
    rng = np.random.default_rng(seed)
    total = int(np.prod([n * (n + 1) // 2 for n in shape]))
    seconds = rng.uniform(1.0, 9.0, total).astype(np.float32)
    seconds[rng.random(total) < 0.2] = np.inf
    pieces = np.where(rng.random(total) < 0.2, 2, 1).astype(np.int16)
    for cell in np.ndindex(shape):
        index = index_box((*cell, *(c + 1 for c in cell)), shape)  # type: ignore[arg-type]
        seconds[index], pieces[index] = 1.0, 1
    is_needed = rng.random(shape) < 0.6
    return GrowthTables(
        is_needed, np.zeros(shape, bool), seconds, pieces, seconds, np.zeros(total, np.float32)
    )


def make_empty_mask(grid: Grid) -> np.ndarray:
    return np.zeros(grid.shape, bool)


def count_cover(blocks: np.ndarray, shape: Shape) -> np.ndarray:
    count = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in blocks:
        count[x0:x1, y0:y1, z0:z1] += 1
    return count


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 4)),
    seed=st.integers(0, 10**6),
    share=st.floats(0.0, 1.0),
    score=st.sampled_from(Score.BOTH.interpretations),
)
def test_blocks_are_disjoint_and_cover_the_cells(shape: Shape, seed: int, share: float, score: Score) -> None:
    tables = make_random_tables(shape, seed)
    cells = np.argwhere(tables.is_needed)
    seeds = cells[: math.ceil(share * len(cells))].tolist()
    blocks, owner = grow_blocks([(x, y, z, x + 1, y + 1, z + 1) for x, y, z in seeds], tables, score)
    assert len(blocks) == len(seeds)
    assert ((count_cover(blocks, shape) == 1) == (owner != FREE_CELL)).all()
    assert count_cover(blocks, shape).max(initial=0) <= 1
    free_count = int((tables.is_needed & (owner == FREE_CELL)).sum())
    filled_blocks = fill_voids(blocks, owner, tables, free_count)
    assert filled_blocks is not None  # a block for each cell would be enough
    assert count_cover(filled_blocks, shape).max(initial=0) <= 1
    assert (count_cover(filled_blocks, shape)[tables.is_needed] == 1).all()
    for block in filled_blocks:
        index = index_box((*block.tolist(),), shape)
        assert np.isfinite(tables.seconds[index])
        assert tables.piece_counts[index] == 1
        assert tables.is_needed[tuple(slice(a, b) for a, b in zip(block[:3], block[3:], strict=True))].any()


def make_simple_tables(shape: Shape, seconds: np.ndarray, price_s: np.ndarray) -> GrowthTables:
    """Make tables with all cells needed and free, all boxes in one piece, and no overhang."""
    pieces = np.ones(len(seconds), np.int16)
    return GrowthTables(np.ones(shape, bool), np.zeros(shape, bool), seconds, pieces, price_s, 0 * price_s)


def test_growth_stops_where_no_block_can_grow() -> None:
    shape = (4, 1, 1)
    total = 10
    equal_seconds = np.ones(total, np.float32)
    tables = make_simple_tables(shape, equal_seconds, equal_seconds)
    blocks, owner = grow_blocks([(0, 0, 0, 1, 1, 1), (3, 0, 0, 4, 1, 1)], tables, Score.LOW)
    assert owner.ravel().tolist() == [0, 0, 1, 1] or owner.ravel().tolist() == [0, 0, 0, 1]
    limited_seconds = equal_seconds.copy()
    limited_seconds[index_box((0, 0, 0, 2, 1, 1), shape)] = np.inf
    tables = make_simple_tables(shape, limited_seconds, equal_seconds)
    blocks, owner = grow_blocks([(0, 0, 0, 1, 1, 1)], tables, Score.LOW)
    assert owner.ravel().tolist() == [0, FREE_CELL, FREE_CELL, FREE_CELL]
    assert fill_voids(blocks, owner.copy(), tables, 0) is None
    assert fill_voids(blocks, owner.copy(), tables, 1) is not None


@pytest.mark.parametrize(("score", "expected_cells"), [(Score.LOW, [0, 1]), (Score.HIGH, [1, 2])])
def test_both_readings_of_the_score_are_used(score: Score, expected_cells: list[int]) -> None:
    """Start from the middle of three cells; growth to the left is cheap, growth to the right is expensive."""
    shape = (3, 1, 1)
    price_s = np.ones(6, np.float32)
    price_s[index_box((0, 0, 0, 2, 1, 1), shape)] = 2.0
    price_s[index_box((1, 0, 0, 3, 1, 1), shape)] = 5.0
    seconds = np.ones(6, np.float32)
    seconds[index_box((0, 0, 0, 3, 1, 1), shape)] = np.inf
    tables = make_simple_tables(shape, seconds, price_s)
    _, owner = grow_blocks([(1, 0, 0, 2, 1, 1)], tables, score)
    assert np.flatnonzero(owner.ravel() == 0).tolist() == expected_cells


@pytest.fixture(scope="module")
def printers(plus_printer: TargetPrinter) -> list[TargetPrinter]:
    return [plus_printer] * 14


@pytest.fixture(scope="module")
def plus_printer() -> TargetPrinter:
    return TargetPrinter("plus", ((206.9, 190.9, 205.0),))


@pytest.fixture(scope="module")
def ball_points(ball: Model) -> np.ndarray:
    return np.unique(ball.solid.arrays()[0], axis=0)


@pytest.fixture(scope="module")
def ball_grid(ball: Model, cost: CostModel) -> Grid:
    vertices, faces = ball.solid.arrays()
    return build_grid(vertices[faces], 8, GridRules(10.0, False, cost.overhang_cos, cost.skin_cos))


@pytest.fixture(scope="module")
def ball_tables(ball_grid: Grid, printers: list[TargetPrinter], cost: CostModel) -> BoxTables:
    return price_boxes(ball_grid, printers, cost)


@pytest.mark.parametrize("count", [1, 7, 40, 10_000])
def test_seeds_are_distinct_boundary_cells(ball_grid: Grid, ball_points: np.ndarray, count: int) -> None:
    result = draw_seeds(
        SeedSource(ball_points, ball_grid, make_empty_mask(ball_grid)), count, np.random.default_rng(3)
    )
    boundary_count = int((ball_grid.cells == Cell.BOUNDARY).sum())
    assert len(set(result)) == len(result) == min(count, boundary_count)
    assert all(ball_grid.cells[x, y, z] == Cell.BOUNDARY for x, y, z, *_ in result)
    assert result == draw_seeds(
        SeedSource(ball_points, ball_grid, make_empty_mask(ball_grid)), count, np.random.default_rng(3)
    )
    # There are fewer vertices than seeds.
    few_seeds = draw_seeds(
        SeedSource(ball_points[:3], ball_grid, make_empty_mask(ball_grid)), count, np.random.default_rng(3)
    )
    assert len(set(few_seeds)) == len(result)


def test_seeds_spread_over_the_surface(ball_grid: Grid, ball_points: np.ndarray) -> None:
    cells = np.array(
        draw_seeds(
            SeedSource(ball_points, ball_grid, make_empty_mask(ball_grid)), 8, np.random.default_rng(0)
        )
    )[:, :3]
    gaps = np.abs(cells[:, None] - cells[None]).sum(axis=2) + 100 * np.eye(8, dtype=int)
    assert gaps.min() >= 2


@pytest.mark.parametrize("score", Score.BOTH.interpretations)
def test_attempts_cover_the_model_and_are_deterministic(
    score: Score, ball_grid: Grid, ball_tables: BoxTables, ball_points: np.ndarray
) -> None:
    tables = make_time_tables(ball_grid, ball_tables)
    seed_sets = draw_seed_sets(SeedSource(ball_points, ball_grid, tables.is_excluded), 14, 2, 5)
    result = run_attempts(seed_sets, tables, 14, score)
    assert result
    for item in result:
        count = count_cover(np.array(item.blocks), ball_grid.shape)
        assert count.max() == 1
        assert (count[ball_grid.is_needed] == 1).all()
        indices = [index_box(block, ball_grid.shape) for block in item.blocks]
        assert (ball_tables.trimmed_box[indices] == indices).all()  # no block ends in an empty layer
        assert item.part_count == ball_tables.piece_counts[indices].sum() <= 14
        assert item.max_price == ball_tables.seconds[indices].max() < np.inf
    assert [a.max_price for a in result] == sorted(a.max_price for a in result)
    with ThreadPoolExecutor(2) as pool:
        threaded_sets = draw_seed_sets(
            SeedSource(ball_points, ball_grid, tables.is_excluded), 14, 2, 5, pool.map
        )
        assert threaded_sets == seed_sets
        assert run_attempts(threaded_sets, tables, 14, score, pool.map) == result
    other_sets = draw_seed_sets(SeedSource(ball_points, ball_grid, tables.is_excluded), 14, 2, 6)
    assert result != run_attempts(other_sets, tables, 14, score)


def test_prices_of_the_paper_match_the_solid_in_each_box(
    ball: Model, ball_grid: Grid, ball_tables: BoxTables
) -> None:
    tables = make_paper_tables(ball_grid, ball_tables)
    rng = np.random.default_rng(1)
    shape = ball_grid.shape
    for number in rng.choice(len(ball_tables.seconds), 25, replace=False):
        sizes = [n * (n + 1) // 2 for n in shape]
        index, iz = divmod(int(number), sizes[2])
        ix, iy = divmod(index, sizes[1])
        spans = [find_interval_ends(i, n) for i, n in zip((ix, iy, iz), shape, strict=True)]
        x, y, z = spans
        box = (x[0], y[0], z[0], x[1], y[1], z[1])
        piece: Solid = ball.solid.clip(*ball_grid.find_bounds_mm(box))
        expected_s = SPEED_MM_S * (piece.volume_mm3 + piece.area_mm2)
        assert tables.printing_prices[number] == pytest.approx(expected_s, rel=1e-4, abs=1.0)
    whole_box = index_box((0, 0, 0, *shape), shape)
    # The surface of a ball that is steeper than the support angle projects to the same disc on all sides.
    overhang_mm2 = math.pi * (150.0 * math.sin(math.radians(45.0))) ** 2
    assert tables.overhang_prices[whole_box] == pytest.approx(overhang_mm2, rel=0.1)


def make_rotation(angle_rad: float, axis: tuple[float, float, float]) -> np.ndarray:
    return np.asarray(trimesh.transformations.rotation_matrix(angle_rad, axis)[:3, :3])


@settings(max_examples=8, deadline=None)
@given(angle_rad=st.floats(-3.0, 3.0), seed=st.integers(0, 100))
def test_mirror_of_a_mirrored_cloud_is_found(angle_rad: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    half_cloud = rng.uniform((5.0, -60.0, -20.0), (100.0, 40.0, 30.0), (150, 3))
    rotation = make_rotation(angle_rad, (1.0, 2.0, 0.5))
    cloud = np.vstack([half_cloud, half_cloud * (-1.0, 1.0, 1.0)]) @ rotation.T + (7.0, 8.0, 9.0)
    mirror = find_mirror(cloud, np.random.default_rng(seed))
    assert mirror is not None
    assert abs(mirror.normal @ rotation[:, 0]) == pytest.approx(1.0, abs=1e-3)
    assert mirror.offset_mm == pytest.approx(float(mirror.normal @ (7.0, 8.0, 9.0)), abs=0.5)
    rotation_matrix, axis = find_rotation_to_axis(mirror.normal)
    assert rotation_matrix @ rotation_matrix.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(rotation_matrix) == pytest.approx(1.0)
    assert abs((rotation_matrix @ mirror.normal)[axis]) == pytest.approx(1.0)
    asymmetric_cloud = np.vstack([cloud, rng.uniform(-100.0, 300.0, (300, 3))])
    assert find_mirror(asymmetric_cloud, np.random.default_rng(seed)) is None


@pytest.fixture(scope="module")
def rotated_model() -> Model:
    """Make a symmetric block with a step, rotated off the axes."""
    step = Solid.union([Solid.box((-150, -40, -50), (150, 40, 10)), Solid.box((-60, -40, 5), (60, 10, 90))])
    vertices, faces = step.arrays()
    return Model(Solid.from_arrays(vertices @ make_rotation(0.4, (0.0, 0.0, 1.0)).T, faces), (), 1.0)


COARSE_OPTIONS = Options(Engine.PARALLELOBOX, granularity="vcoarse", seed=1)


@pytest.mark.parametrize(
    "options",
    [
        COARSE_OPTIONS,
        replace(COARSE_OPTIONS, parallelobox=ParalleloboxOptions(score=Score.HIGH)),
        replace(COARSE_OPTIONS, faithful=True),
    ],
)
def test_engine_returns_checked_parts(
    options: Options, rotated_model: Model, plus_printer: TargetPrinter, cost: CostModel
) -> None:
    printers = [replace(plus_printer, name=str(i)) for i in range(9)]
    assert align_model(rotated_model, 1, cost.overhang_cos).mirror is not None
    result = decompose_model(rotated_model, printers, options, cost)
    assert result.engine is Engine.PARALLELOBOX
    assert 2 <= len(result.parts) <= 9
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(
        rotated_model.solid.volume_mm3, rel=1e-6
    )
    lo, hi = rotated_model.solid.bounds_mm
    assert np.min([p.solid.bounds_mm[0] for p in result.parts], axis=0) == pytest.approx(lo, abs=1e-6)
    assert np.max([p.solid.bounds_mm[1] for p in result.parts], axis=0) == pytest.approx(hi, abs=1e-6)
    for part in result.parts:  # the printing pose still fits
        width_mm, depth_mm, height_mm = np.ptp(part.build_printing_mesh()[0], axis=0) - 1e-6
        assert plus_printer.fits(width_mm, depth_mm, height_mm)
        assert part.build_printing_mesh()[0][:, 2].min() == pytest.approx(0.0, abs=1e-6)
    if options.faithful:  # no part crosses the plane of symmetry, which was x = 0 before the rotation
        direction = make_rotation(0.4, (0.0, 0.0, 1.0))[:, 0]
        sides = [part.solid.arrays()[0] @ direction for part in result.parts]
        assert all(side.min() > -1e-6 or side.max() < 1e-6 for side in sides)
        return
    second_result = decompose_model(rotated_model, printers, options, cost)
    assert [p.solid.volume_mm3 for p in second_result.parts] == [p.solid.volume_mm3 for p in result.parts]
    assert second_result.makespan_s == result.makespan_s


def test_option_faithful_uses_the_settings_of_the_paper(
    rotated_model: Model, plus_printer: TargetPrinter, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check the grid, the tries, the symmetry, the overhang tolerance and the speed of the paper.

    There is no infill, because neither the paper's formulas nor its program have any.
    """
    calls: list[tuple[str, int, float]] = []
    build, draw = problem_module.build_grid, search.draw_seed_sets

    def record_grid(*args: Any) -> Grid:
        calls.append(("grid", args[1], args[2].overhang_cos))
        return build(*args)

    def record_draw(*args: Any) -> list[Any]:
        calls.append(("draws", args[1], args[2]))
        return draw(*args)

    monkeypatch.setattr(problem_module, "build_grid", record_grid)
    monkeypatch.setattr(search, "draw_seed_sets", record_draw)
    printers = [replace(plus_printer, name=str(i)) for i in range(9)]
    options = replace(
        COARSE_OPTIONS,
        faithful=True,
        parallelobox=ParalleloboxOptions(tries=1),
        prove=False,
        fit_first_layer=False,
    )
    result = decompose_model(rotated_model, printers, options, cost)
    assert result.options.granularity == "vfine" and result.options.parallelobox.tries == 3
    assert {size for kind, size, _ in calls if kind == "grid"} == {15}
    assert math.sin(math.radians(1.0)) in {number for kind, _, number in calls if kind == "grid"}
    # Seed sets are drawn for the two halves.
    assert sorted(item[1:] for item in calls if item[0] == "draws") == [
        (4, 3),
        (5, 3),
    ]
    assert SPEED_MM_S == 20.0
    assert result.options.parallelobox.score is Score.HIGH
    assert (
        search.apply_paper_settings(
            replace(options, parallelobox=ParalleloboxOptions(score=Score.LOW))
        ).parallelobox.score
        is Score.LOW
    )


@settings(max_examples=1, deadline=None)
@given(seed=st.integers(0, 10**6), printers=st.integers(9, 14))
def test_result_is_never_worse_than_the_faithful_one(
    rotated_model: Model, plus_printer: TargetPrinter, cost: CostModel, seed: int, printers: int
) -> None:
    """Compare both on a rotated model with a plane of symmetry that is large enough for a finer grid."""
    fleet = [replace(plus_printer, name=str(i)) for i in range(printers)]
    options = Options(Engine.PARALLELOBOX, seed=seed, fit_first_layer=False, prove=False)
    faithful_result = decompose_model(rotated_model, fleet, replace(options, faithful=True), cost)
    default_result = decompose_model(rotated_model, fleet, options, cost)
    assert default_result.makespan_s <= faithful_result.makespan_s or (
        faithful_result.faults and not default_result.faults
    )


def test_model_is_rotated_to_reduce_its_overhangs(cost: CostModel) -> None:
    """Use a rotated block without symmetry, which has no overhang once it is upright."""
    solid = Solid.union([Solid.box((0, 0, 0), (90, 60, 40)), Solid.box((0, 0, 0), (30, 20, 80))])
    solid = Solid.union([solid, Solid.box((0, 0, 0), (50, 60, 55))])
    vertices, faces = solid.arrays()
    rotated_vertices = vertices @ make_rotation(0.7, (1.0, 0.3, 0.2)).T
    assert measure_overhang_mm2(vertices[faces], cost.overhang_cos) == pytest.approx(0.0)
    assert measure_overhang_mm2(rotated_vertices[faces], cost.overhang_cos) > 1000.0
    aligned_model = align_model(
        Model(Solid.from_arrays(rotated_vertices, faces), (), 1.0), 1, cost.overhang_cos
    )
    straight_vertices, straight_faces = aligned_model.model.solid.arrays()
    assert measure_overhang_mm2(straight_vertices[straight_faces], cost.overhang_cos) == pytest.approx(
        0.0, abs=1.0
    )
    assert aligned_model.rotation @ aligned_model.rotation.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(aligned_model.rotation) == pytest.approx(1.0)
    second_result = align_model(Model(solid, (), 1.0), 1, cost.overhang_cos)
    assert (second_result.rotation == np.eye(3)).all()  # an upright block is not rotated


def test_too_few_printers_are_reported(ball: Model, plus_printer: TargetPrinter, cost: CostModel) -> None:
    with pytest.raises(NoFit, match=r"no attempt of parallelobox covers .* --engine guillotine"):
        decompose_model(ball, [plus_printer, replace(plus_printer, name="b")], COARSE_OPTIONS, cost)
