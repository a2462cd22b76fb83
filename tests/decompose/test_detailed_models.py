"""Very detailed models: searched in a simplified copy, and cut themselves."""

from __future__ import annotations

import contextlib
import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from decompose import decompose as decompose_module
from decompose.best import rotate_about_z
from decompose.decompose import decompose_model, estimate_serial_s, run_engine
from decompose.detailed_models import (
    MARGIN_MM,
    TOLERANCES_MM,
    _clip_around,
    _cut_matching_pieces,
    cut_detailed_pieces,
    simplify_problem,
    simplify_solid,
)
from decompose.engines import ENGINES
from decompose.errors import GeometryError, NoFit, Rule
from decompose.geometry import Model, Solid
from decompose.grid import Grid
from decompose.options import BestOptions, Engine, Options
from decompose.pieces import Fault, Piece, cut_box
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Effort, Partition, Problem, Work
from decompose.rebalance import SlicedCuts, rebalance_planes
from decompose.results import Decomposition

COARSE_OPTIONS = Options(granularity="vcoarse")
MAX_FACES = 22_000  # limit in these tests, below the number of faces of the ring


@pytest.fixture
def ring() -> Model:
    mesh = trimesh.creation.torus(120.0, 50.0, major_sections=160, minor_sections=80)
    return Model(Solid.from_arrays(mesh.vertices, mesh.faces), (), 1.0)


@pytest.fixture
def gridded_face_counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Lower the limit, and record the number of faces of each model that is searched."""
    monkeypatch.setattr("decompose.detailed_models.MAX_SEARCHED_FACES", MAX_FACES)
    face_counts = []
    build_grid = Problem.build_grid

    def record_model(problem: Problem, model: Model) -> Grid:
        face_counts.append(model.solid.face_count)
        return build_grid(problem, model)

    monkeypatch.setattr(Problem, "build_grid", record_model)
    return face_counts


def check_parts(result: Decomposition, model: Model) -> None:
    """Check that the parts add up to the model itself."""
    volume_mm3 = sum(part.solid.volume_mm3 for part in result.parts)
    assert volume_mm3 == pytest.approx(model.solid.volume_mm3, rel=1e-9)
    assert result.coverage.surface_error < 1e-9


def test_price_of_a_simplified_solid_is_similar(
    monkeypatch: pytest.MonkeyPatch, ring: Model, cost: CostModel
) -> None:
    assert simplify_solid(ring.solid) is ring.solid
    monkeypatch.setattr("decompose.detailed_models.MAX_SEARCHED_FACES", MAX_FACES)
    simple_solid = simplify_solid(ring.solid)
    assert simple_solid.face_count <= MAX_FACES < ring.solid.face_count
    exact_s = estimate_serial_s(*ring.solid.arrays(), cost, fit_first_layer=True)
    simple_s = estimate_serial_s(*simple_solid.arrays(), cost, fit_first_layer=True)
    assert simple_s == pytest.approx(exact_s, rel=0.01)


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0])
@pytest.mark.parametrize("time_factor", [1.0, 1.3])
def test_parts_are_cut_out_of_the_model_itself(
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
    yaw_deg: float,
    time_factor: float,
) -> None:
    printers = [replace(printer, time_factor=time_factor) for printer in fleet[:2]] + fleet[2:]
    model = rotate_about_z(Problem(ring, tuple(printers), cost, COARSE_OPTIONS), yaw_deg).model
    options = replace(COARSE_OPTIONS, engine=Engine.GUILLOTINE)
    result = decompose_model(model, printers, options, cost)
    assert max(gridded_face_counts) <= MAX_FACES < model.solid.face_count
    check_parts(result, model)
    assert len({part.printer for part in result.parts}) == len(result.parts)
    assert "details" in result.compute_s


def test_rotated_attempt_uses_the_copy_in_the_frame_of_the_input(
    gridded_face_counts: list[int], ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    options = replace(COARSE_OPTIONS, engine=Engine.GUILLOTINE, prove=False)
    problem = rotate_about_z(Problem(ring, tuple(fleet), cost, options), 30.0)
    simple_solid = simplify_solid(ring.solid)
    result = run_engine(problem, lambda: (1.0, 1.0), simple_solid)
    assert set(gridded_face_counts) == {simple_solid.face_count}
    check_parts(result, ring)
    assert result.makespan_s == pytest.approx(
        run_engine(problem, lambda: (1.0, 1.0), pickle.loads(pickle.dumps(simple_solid))).makespan_s, rel=0.0
    )


def test_model_whose_pieces_differ_is_searched_itself(
    monkeypatch: pytest.MonkeyPatch,
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
) -> None:
    monkeypatch.setattr("decompose.decompose.cut_detailed_pieces", lambda *arguments: None)
    check_parts(decompose_model(ring, fleet, COARSE_OPTIONS, cost), ring)
    assert gridded_face_counts[-1] == ring.solid.face_count


def test_later_attempt_whose_pieces_differ_fails(
    monkeypatch: pytest.MonkeyPatch,
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
) -> None:
    monkeypatch.setattr("decompose.decompose.cut_detailed_pieces", lambda *arguments: None)
    problem = Problem(ring, tuple(fleet), cost, replace(COARSE_OPTIONS, engine=Engine.GUILLOTINE))
    with pytest.raises(NoFit, match="differ from those of its simplified copy"):
        run_engine(replace(problem, best_known_s=1e9), lambda: (1.0, 1.0), simplify_solid(ring.solid))
    assert max(gridded_face_counts) <= MAX_FACES


def test_model_is_searched_itself_with_the_whole_budget(
    monkeypatch: pytest.MonkeyPatch,
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
) -> None:
    options = replace(COARSE_OPTIONS, prove=False, best=BestOptions(2.0))
    monkeypatch.setattr("decompose.detailed_models.MAX_SEARCHED_FACES", 10**9)
    expected_result = decompose_model(ring, fleet, options, cost)
    monkeypatch.setattr("decompose.detailed_models.MAX_SEARCHED_FACES", MAX_FACES)
    monkeypatch.setattr("decompose.decompose.cut_detailed_pieces", lambda *arguments: None)
    result = decompose_model(ring, fleet, options, cost)
    assert min(gridded_face_counts) <= MAX_FACES
    assert result.makespan_s == expected_result.makespan_s
    assert result.attempts[0].finished == expected_result.attempts[0].finished


def test_model_whose_parts_have_faults_is_searched_itself(
    monkeypatch: pytest.MonkeyPatch,
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
) -> None:
    finish_result = decompose_module.finish_result

    def add_fault(
        problem: Problem, partition: Partition, serial_times_s: tuple[float, float]
    ) -> Decomposition:
        result = finish_result(problem, partition, serial_times_s)
        is_copy = gridded_face_counts[-1] < ring.solid.face_count
        return replace(result, faults=(Fault(0, "is a sliver"),)) if is_copy else result

    monkeypatch.setattr("decompose.decompose.finish_result", add_fault)
    result = decompose_model(ring, fleet, COARSE_OPTIONS, cost)
    assert not result.faults
    assert gridded_face_counts[-1] == ring.solid.face_count


def test_model_whose_parts_break_a_rule_is_searched_itself(
    monkeypatch: pytest.MonkeyPatch,
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
) -> None:
    finish_result = decompose_module.finish_result

    def refuse_first_result(
        problem: Problem, partition: Partition, serial_times_s: tuple[float, float]
    ) -> Decomposition:
        if gridded_face_counts[-1] < ring.solid.face_count:
            raise GeometryError(Rule.SURFACE, None, "a surface is missing")
        return finish_result(problem, partition, serial_times_s)

    monkeypatch.setattr("decompose.decompose.finish_result", refuse_first_result)
    check_parts(decompose_model(ring, fleet, COARSE_OPTIONS, cost), ring)
    assert gridded_face_counts[-1] == ring.solid.face_count


@pytest.mark.usefixtures("gridded_face_counts")
def test_engine_without_boxes_searches_the_model_itself(
    monkeypatch: pytest.MonkeyPatch, ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    searched_face_counts = []
    search = ENGINES[Engine.CUBE_SKELETON]

    def record_search(problem: Problem) -> Partition:
        searched_face_counts.append(problem.model.solid.face_count)
        return search(problem)

    monkeypatch.setitem(ENGINES, Engine.CUBE_SKELETON, record_search)
    with contextlib.suppress(NoFit):
        decompose_model(ring, fleet, replace(COARSE_OPTIONS, engine=Engine.CUBE_SKELETON), cost)
    assert searched_face_counts == [ring.solid.face_count]


def test_parts_of_a_rough_model_keep_its_surface_and_its_wall(
    gridded_face_counts: list[int], fleet: list[TargetPrinter], cost: CostModel
) -> None:
    """Use a rough block with a hollow: its surface lies partly outside the copy."""
    block = trimesh.creation.box((500.0, 400.0, 380.0))
    for _ in range(6):
        block = block.subdivide()
    block.vertices += np.random.default_rng(0).uniform(-0.15, 0.15, block.vertices.shape)
    model = Model(Solid.from_arrays(block.vertices, block.faces), (), 1.0)
    printers = [TargetPrinter(f"p{i}", fleet[0].box_sizes_mm) for i in range(40)]
    options = Options(Engine.GUILLOTINE, 9, prove=False, min_wall_mm=10.0)
    result = decompose_model(model, printers, options, replace(cost, volume_s_per_mm3=1.0))
    assert max(gridded_face_counts) <= MAX_FACES < model.solid.face_count
    assert sum(part.solid.volume_mm3 for part in result.parts) < 0.99 * model.solid.volume_mm3
    assert result.coverage.surface_error < 1e-6
    assert result.options.min_wall_mm == 10.0


def test_pieces_keep_the_printers_of_the_nearest_pieces_of_the_copy(
    fleet: list[TargetPrinter], cost: CostModel
) -> None:
    """Use two towers of almost the same height, of which another one is lower in the copy."""

    def make_towers(heights_mm: tuple[float, float]) -> Model:
        towers = [Solid.box((x, 0, 0), (x + 10, 10, z)) for x, z in zip((0, 50), heights_mm, strict=True)]
        return Model(Solid.union(towers), (), 1.0)

    problem = Problem(make_towers((80.0, 80.02)), tuple(fleet), cost, COARSE_OPTIONS)
    copy = make_towers((80.02, 80.0))
    box_mm = np.array([[-1.0, -1.0, -1.0], [61.0, 11.0, 81.0]])
    pieces = [
        replace(piece, printer=fleet[int(piece.solid.bounds_mm[0, 0] > 25.0)])
        for piece in cut_box(copy.solid, *box_mm)
    ]
    partition = cut_detailed_pieces(
        problem, replace(problem, model=copy), Partition(tuple(pieces), copy, np.eye(3))
    )
    assert partition is not None
    printers = {round(piece.solid.bounds_mm[0, 0]): piece.printer for piece in partition.pieces}
    assert printers == {0: fleet[0], 50: fleet[1]}


@pytest.mark.usefixtures("gridded_face_counts")
def test_pieces_get_the_poses_of_those_of_the_copy(
    monkeypatch: pytest.MonkeyPatch, ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    problem = Problem(ring, tuple(fleet), cost, COARSE_OPTIONS)
    simple_problem = simplify_problem(problem, simplify_solid(ring.solid))
    pieces = cut_box(simple_problem.model.solid, [-200.0, -20.0, -60.0], [200.0, 20.0, 60.0])
    simple_poses = simple_problem.find_poses(pieces)
    monkeypatch.setattr(Problem, "find_pose", lambda *_: pytest.fail("the pose is sought again"))
    partition = cut_detailed_pieces(
        problem, simple_problem, Partition(tuple(pieces), simple_problem.model, np.eye(3))
    )
    assert partition is not None
    poses = problem.find_poses(partition.pieces)
    counts = [(a.solid.face_count, b.solid.face_count) for a, b in zip(partition.pieces, pieces, strict=True)]
    assert all(count > simple_count for count, simple_count in counts)
    for pose, simple_pose in zip(poses, simple_poses, strict=True):
        assert pose is not None
        assert simple_pose is not None
        assert pose.to_model[:3, :3] == pytest.approx(simple_pose.to_model[:3, :3])
        assert pose.price_s != simple_pose.price_s
        assert pose.price_s == pytest.approx(simple_pose.price_s, rel=0.02)


def test_boxes_grow_only_up_to_the_margin_around_the_model(
    ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    assert sum(TOLERANCES_MM) < MARGIN_MM
    problem = Problem(ring, tuple(fleet), cost, COARSE_OPTIONS)
    low_mm, high_mm = ring.solid.bounds_mm
    partition = Partition(tuple(cut_box(ring.solid, low_mm, high_mm)), ring, np.eye(3))
    for _ in range(3):
        grown_partition = cut_detailed_pieces(problem, problem, partition)
        assert grown_partition is not None
        partition = grown_partition
        (piece,) = partition.pieces
        assert piece.boxes_mm[0] == pytest.approx(np.array([low_mm - MARGIN_MM, high_mm + MARGIN_MM]))


@pytest.mark.usefixtures("gridded_face_counts")
def test_boxes_with_other_pieces_are_not_cut(
    ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    problem = Problem(ring, tuple(fleet), cost, COARSE_OPTIONS)
    simple_problem = simplify_problem(problem, simplify_solid(ring.solid))
    assert simple_problem.options.min_wall_mm == problem.options.min_wall_mm + MARGIN_MM
    box_mm = np.array([[-200.0, -20.0, -60.0], [200.0, 20.0, 60.0]])
    pieces = cut_box(simple_problem.model.solid, *box_mm)
    assert len(pieces) == 2

    def cut_detailed(pieces: list[Piece]) -> Partition | None:
        return cut_detailed_pieces(
            problem, simple_problem, Partition(tuple(pieces), simple_problem.model, np.eye(3))
        )

    partition = cut_detailed(pieces)
    assert partition is not None
    assert len(partition.pieces) == 2
    assert cut_detailed(pieces[:1]) is None
    assert cut_detailed([replace(pieces[0], boxes_mm=np.zeros((0, 2, 3)))]) is None


def test_planes_of_a_detailed_model_are_moved(
    gridded_face_counts: list[int], ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    result = decompose_model(ring, fleet, replace(COARSE_OPTIONS, engine=Engine.GUILLOTINE), cost)
    slices_s = [part.price_s for part in result.parts]
    slowest = int(np.argmax(slices_s))
    slices_s[slowest] *= 1.2
    new_result = rebalance_planes(ring, [SlicedCuts(result.without_parts(), slices_s, max(slices_s))], cost)
    assert new_result is not None
    assert max(gridded_face_counts) <= MAX_FACES
    check_parts(new_result, ring)
    assert new_result.parts[slowest].price_s < result.parts[slowest].price_s


def test_boxes_are_cut_out_of_regions_as_out_of_the_whole_model(ring: Model) -> None:
    low_mm, high_mm = ring.solid.bounds_mm
    corners = np.array(list(np.ndindex(3, 3, 3)))
    boxes_mm = low_mm + np.stack([corners, corners + 1], axis=1) * (high_mm - low_mm) / 3.0
    effort = Effort(60.0)
    regions = dict(_clip_around(ring.solid, boxes_mm, effort))
    assert sorted(regions) == list(range(len(boxes_mm)))
    assert effort.done_units[Work.FACE_CUT] < 0.7 * len(boxes_mm) * ring.solid.face_count
    assert max(region.face_count for region in regions.values()) < ring.solid.face_count / 2
    for box, region in regions.items():
        piece, whole_piece = region.clip(*boxes_mm[box]), ring.solid.clip(*boxes_mm[box])
        assert piece.volume_mm3 == pytest.approx(whole_piece.volume_mm3, rel=1e-9, abs=1e-9)
        assert piece.area_mm2 == pytest.approx(whole_piece.area_mm2, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("crumb_mm", "count"), [(0.1, 1), (1.0, 0)])
def test_crumbs_are_left_out_but_no_other_pieces(crumb_mm: float, count: int) -> None:
    block = Solid.box((0.0, 0.0, 0.0), (20.0, 20.0, 20.0))
    crumb = Solid.box((25.0, 5.0, 5.0), np.array([25.0, 5.0, 5.0]) + crumb_mm)
    box_mm = np.array([[-1.0, -1.0, -1.0], [30.0, 21.0, 10.0]])
    pairs = _cut_matching_pieces(Solid.union([block, crumb]), box_mm, cut_box(block, *box_mm))
    assert len(pairs) == count
    assert all(piece.solid.volume_mm3 == pytest.approx(4000.0) for piece, _ in pairs)
