"""Very detailed models: searched in a simplified copy, and cut themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from decompose import decompose as decompose_module
from decompose.best import rotate_about_z
from decompose.decompose import decompose_model, estimate_serial_s
from decompose.detailed_models import cut_detailed_pieces, simplify_problem, simplify_solid
from decompose.errors import GeometryError, Rule
from decompose.geometry import Model, Solid
from decompose.grid import Grid
from decompose.options import BestOptions, Engine, Options
from decompose.pieces import Piece, cut_box
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Partition, Problem
from decompose.rebalance import rebalance_planes
from decompose.results import Decomposition

COARSE_OPTIONS = Options(granularity="vcoarse")
MAX_FACES = 22_000  # limit in these tests, below the number of faces of the ring


@pytest.fixture
def ring() -> Model:
    mesh = trimesh.creation.torus(120.0, 50.0, major_sections=160, minor_sections=80)
    return Model(Solid.from_arrays(mesh.vertices, mesh.faces), (), 1.0)


@pytest.fixture
def gridded_face_counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Lower the limits, and record the number of faces of each model that is searched."""
    monkeypatch.setattr("decompose.detailed_models.MAX_SIMPLIFIED_FACES", MAX_FACES)
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
    monkeypatch.setattr("decompose.detailed_models.MAX_SIMPLIFIED_FACES", MAX_FACES)
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
    assert "simplification" in result.compute_s


def test_several_attempts_are_made(
    gridded_face_counts: list[int], ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    options = Options(Engine.BEST, prove=False, best=BestOptions(30.0))
    result = decompose_model(ring, fleet, options, cost)
    assert len([attempt for attempt in result.attempts if attempt.makespan_s]) > 1
    assert max(gridded_face_counts) <= MAX_FACES
    check_parts(result, ring)


def test_model_whose_pieces_differ_is_searched_itself(
    monkeypatch: pytest.MonkeyPatch,
    gridded_face_counts: list[int],
    ring: Model,
    fleet: list[TargetPrinter],
    cost: CostModel,
) -> None:
    monkeypatch.setattr("decompose.decompose.cut_detailed_pieces", lambda problem, partition: None)
    check_parts(decompose_model(ring, fleet, COARSE_OPTIONS, cost), ring)
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
def test_boxes_with_other_pieces_are_not_cut(
    ring: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    problem = Problem(ring, tuple(fleet), cost, COARSE_OPTIONS)
    simple_problem = simplify_problem(problem)
    box_mm = np.array([[-200.0, -20.0, -60.0], [200.0, 20.0, 60.0]])
    pieces = cut_box(simple_problem.model.solid, *box_mm)
    assert len(pieces) == 2

    def cut_detailed(pieces: list[Piece]) -> Partition | None:
        return cut_detailed_pieces(problem, Partition(tuple(pieces), simple_problem.model, np.eye(3)))

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
    new_result = rebalance_planes(ring, result.without_parts(), slices_s, cost)
    assert new_result is not None
    assert max(gridded_face_counts) <= MAX_FACES
    check_parts(new_result, ring)
    assert new_result.parts[slowest].price_s < result.parts[slowest].price_s
