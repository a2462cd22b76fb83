"""Decomposition of whole models, from the options to the written parts."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from decompose.decompose import decompose_model
from decompose.errors import DecomposeError, NoFit
from decompose.export import write_decomposition
from decompose.geometry import Model, Solid
from decompose.options import BestOptions, Engine, Interior, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem.granularity import choose_granularity
from decompose.results import Decomposition

COARSE_OPTIONS = Options(granularity="vcoarse")


def list_boxes(result: Decomposition) -> list[list[float]]:
    return [np.round(p.solid.bounds_mm, 6).ravel().tolist() for p in result.parts]


def test_ball_is_cut_for_eight_printers(ball: Model, fleet: list[TargetPrinter], cost: CostModel) -> None:
    result = decompose_model(ball, fleet, COARSE_OPTIONS, cost)
    assert [p.id for p in result.parts] == [f"p{i:02d}" for i in range(1, len(result.parts) + 1)]
    assert len({p.printer for p in result.parts}) == len(result.parts) <= 8
    assert result.makespan_s == max(p.price_s for p in result.parts)
    assert result.makespan_s < result.serial_s / 4.0
    assert result.lower_bound_s <= result.grid_makespan_s <= 1.1 * result.lower_bound_s
    assert result.gap == pytest.approx(result.grid_makespan_s / result.lower_bound_s - 1.0)
    assert result.serial_s <= result.serial_as_is_s
    assert result.coverage.surface_error < 1e-6
    second_result = decompose_model(ball, fleet, COARSE_OPTIONS, cost)
    assert list_boxes(second_result) == list_boxes(result)
    assert all(
        (a.to_model == b.to_model).all() for a, b in zip(second_result.parts, result.parts, strict=True)
    )


def test_more_printers_never_take_longer(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    model = Model(ring_with_bar, (), 1.0)
    options = replace(COARSE_OPTIONS, best=BestOptions(0.0), prove=False)
    makespans_s = [decompose_model(model, fleet[:n], options, cost).makespan_s for n in range(1, 6)]
    assert all(b <= a + 1.0 for a, b in pairwise(makespans_s))


def test_one_printer_prints_a_small_model_whole(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    result = decompose_model(Model(ring_with_bar, (), 1.0), fleet[:1], COARSE_OPTIONS, cost)
    (part,) = result.parts
    assert part.solid.volume_mm3 == pytest.approx(ring_with_bar.volume_mm3)
    assert part.price_s == pytest.approx(result.serial_s)


def test_interior_is_omitted_if_that_saves_time(fleet: list[TargetPrinter], cost: CostModel) -> None:
    block = Model(Solid.box((0, 0, 0), (500, 400, 380)), (), 1.0)
    printers = [TargetPrinter(f"p{i}", fleet[0].box_sizes_mm) for i in range(40)]
    volume_cost = replace(cost, volume_s_per_mm3=1.0)
    hollow_result = decompose_model(block, printers, Options(Engine.GUILLOTINE, 9, prove=False), volume_cost)
    solid_result = decompose_model(
        block, printers, Options(Engine.GUILLOTINE, 9, Interior.KEEP, prove=False), volume_cost
    )
    volume_mm3 = sum(p.solid.volume_mm3 for p in hollow_result.parts)
    assert volume_mm3 < 0.95 * block.solid.volume_mm3
    assert sum(p.solid.volume_mm3 for p in solid_result.parts) == pytest.approx(block.solid.volume_mm3)
    assert hollow_result.makespan_s < solid_result.makespan_s


def test_too_few_printers_are_reported_with_the_required_number(
    ball: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    with pytest.raises(NoFit, match=r"needs \d+ parts.*there are 2.*--longest-side") as error:
        decompose_model(ball, fleet[:2], COARSE_OPTIONS, cost)
    needed_printer_count = error.value.needed_printer_count
    assert needed_printer_count is not None
    assert needed_printer_count > 2
    decompose_model(
        ball, [replace(fleet[0], name=f"p{i}") for i in range(needed_printer_count)], COARSE_OPTIONS, cost
    )
    with pytest.raises(NoFit):
        decompose_model(
            ball,
            [replace(fleet[0], name=f"p{i}") for i in range(needed_printer_count - 1)],
            COARSE_OPTIONS,
            cost,
        )
    with pytest.raises(NoFit, match="name at least one"):
        decompose_model(ball, [], COARSE_OPTIONS, cost)
    with pytest.raises(NoFit, match="no-bed has no room"):
        decompose_model(ball, [*fleet, TargetPrinter("no-bed", ())], COARSE_OPTIONS, cost)
    with pytest.raises(NoFit, match="mm along each axis would be enough"):
        decompose_model(
            ball, [TargetPrinter(f"toy-{i}", ((5.0, 5.0, 5.0),)) for i in range(40)], COARSE_OPTIONS, cost
        )


def test_printer_may_print_in_several_rounds(
    ball: Model, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    result = decompose_model(ball, fleet[:3] * 3, COARSE_OPTIONS, cost)
    counts = [[p.printer for p in result.parts].count(r.name) for r in fleet[:3]]
    assert sum(counts) == len(result.parts) > 3
    assert max(counts) <= 3


def test_separate_pieces_are_separate_parts(fleet: list[TargetPrinter], cost: CostModel) -> None:
    two_body_model = Model(
        Solid.union([Solid.box((0, 0, 0), (30, 30, 30)), Solid.box((60, 5, 0), (90, 35, 30))]), (), 1.0
    )
    assert len(decompose_model(two_body_model, fleet[:2], COARSE_OPTIONS, cost).parts) == 2
    with pytest.raises(NoFit, match="needs 2 parts"):
        decompose_model(two_body_model, fleet[:1], COARSE_OPTIONS, cost)


def test_pieces_in_one_cell_are_separate_parts(fleet: list[TargetPrinter], cost: CostModel) -> None:
    """Use two plates 1 mm apart that share every cell; the search counts them as two pieces."""
    plates = Solid.union([Solid.box((0, 0, 0), (60, 60, 5)), Solid.box((0, 0, 6), (60, 60, 11))])
    result = decompose_model(Model(plates, (), 1.0), fleet, Options(granularity=2), cost)
    assert 2 <= len(result.parts) <= 8
    with pytest.raises(NoFit):
        decompose_model(Model(plates, (), 1.0), fleet[:1], Options(granularity=2), cost)


def test_flat_faces_in_the_middle_are_not_cut(fleet: list[TargetPrinter], cost: CostModel) -> None:
    """Use a model with steps at every tenth of the length, where an even grid would have its planes."""
    steps = Solid.union([Solid.box((0, 0, 20 * i), (200 - 20 * i, 80, 20 * i + 20)) for i in range(5)])
    result = decompose_model(Model(steps, (), 1.0), fleet, Options(granularity="regular"), cost)
    assert result.coverage.surface_error < 1e-6
    assert min(np.ptp(p.solid.bounds_mm, axis=0).min() for p in result.parts) > 1.0


@pytest.mark.parametrize("granularity", ["huge", 0, -3, "1.5", 1000])
def test_invalid_granularity_is_refused(granularity: str | int) -> None:
    with pytest.raises(DecomposeError, match="granularity"):
        choose_granularity(granularity, 4)


def test_granularity_is_set_by_name_number_or_size() -> None:
    assert choose_granularity("vfine", 4) == 15
    assert choose_granularity("12", 4) == choose_granularity(12, 4) == 12
    assert choose_granularity("auto", 4) == 15
    assert choose_granularity("auto", 50) > 20


def test_invalid_wall_is_refused(ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel) -> None:
    with pytest.raises(DecomposeError, match="--min-wall"):
        decompose_model(Model(ring_with_bar, (), 1.0), fleet, Options(min_wall_mm=float("nan")), cost)


def test_written_parts_add_up_to_the_model(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel, tmp_path: Path
) -> None:
    result = write_decomposition(
        decompose_model(Model(ring_with_bar, (), 1.0), fleet[:4], COARSE_OPTIONS, cost), tmp_path / "out"
    )
    report = json.loads((tmp_path / "out" / "decomposition.json").read_text())
    assert report["schema"] == 1
    assert report["engine"] == "guillotine"
    # No other engine is tried after a valid result.
    assert [item["engine"] for item in report["attempts"]] == ["guillotine"]
    assert {
        "serial_s",
        "serial_as_is_s",
        "makespan_s",
        "sum_s",
        "grid_makespan_s",
        "lower_bound_s",
        "gap",
        "compute_s",
    } <= set(report)
    assert report["coverage"].keys() == {"surface_error", "overlap_mm3"}
    assert len(report["parts"]) == len(result.parts)
    total_mm3 = 0.0
    for part in report["parts"]:
        mesh = trimesh.load(tmp_path / "out" / part["file"], force="mesh")
        assert mesh.is_watertight
        assert mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-4)
        assert mesh.bounds[:, :2].sum(axis=0) == pytest.approx([0.0, 0.0], abs=1e-4)
        matrix = np.array(part["to_model"])
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
        model_mesh = mesh.apply_transform(matrix)
        assert model_mesh.bounds == pytest.approx(np.array([part["min_mm"], part["max_mm"]]), abs=1e-4)
        solid = Solid.from_arrays(mesh.vertices, mesh.faces)
        assert solid.volume_mm3 == pytest.approx(part["volume_mm3"], rel=1e-5)
        total_mm3 += part["volume_mm3"]
    assert total_mm3 <= ring_with_bar.volume_mm3 * (1.0 + 1e-9)
    assert (tmp_path / "out" / "assembly.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("min_wall_mm", [1e4, 1e200])
def test_wall_thicker_than_the_model_keeps_the_whole_model(
    min_wall_mm: float, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    cube = Model(Solid.box((0, 0, 0), (100, 100, 100)), (), 1.0)
    result = decompose_model(cube, fleet, Options(granularity=6, min_wall_mm=min_wall_mm), cost)
    assert sum(p.solid.volume_mm3 for p in result.parts) == pytest.approx(1e6)
