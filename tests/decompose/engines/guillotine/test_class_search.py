"""Search for printers with unequal build volumes and speeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from decompose.decompose import decompose_model
from decompose.engines.guillotine import class_search, exact_search
from decompose.engines.guillotine.exact_search import build_tables, cut_for_uniform_printers
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.grid import find_box
from decompose.options import Engine, Options
from decompose.pieces import Fault
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem
from decompose.results import Decomposition

LOW_BOXES_MM = ((100.0, 100.0, 100.0),)
HIGH_BOXES_MM = ((100.0, 100.0, 160.0),)
OPTIONS = Options(Engine.GUILLOTINE, granularity=6, prove=False, fit_first_layer=False)


def compute_ends_s(result: Decomposition, printers: Sequence[TargetPrinter]) -> dict[str, float]:
    """Compute when each part ends on its printer."""
    factors = {printer.name: printer.time_factor for printer in printers}
    return {part.printer: part.price_s * factors[part.printer] for part in result.parts}


def compute_makespan_of_equal_printers_s(
    model: Model, printers: Sequence[TargetPrinter], cost: CostModel
) -> float:
    """Compute the makespan of a search that assumes the common build volume and equal speeds."""
    equal_printers = tuple(replace(printer, time_factor=1.0) for printer in printers)
    problem = Problem(model, equal_printers, cost, OPTIONS)
    poses = problem.find_poses(list(cut_for_uniform_printers(problem).pieces))
    times_s = sorted((pose.price_s for pose in poses if pose is not None), reverse=True)
    assert len(times_s) == len(poses)
    sorted_factors = sorted(printer.time_factor for printer in printers)
    return max(
        time_s * factor for time_s, factor in zip(times_s, sorted_factors[: len(times_s)], strict=True)
    )


@pytest.fixture(scope="module")
def tower() -> Model:
    """Make a model that is too high for two low printers, but not for a low and a high one."""
    return Model(Solid.box((0, 0, 0), (90, 90, 230)), (), 1.0)


def test_part_may_use_the_full_height_of_its_printer(tower: Model, cost: CostModel) -> None:
    printers = [TargetPrinter("low", LOW_BOXES_MM), TargetPrinter("high", HIGH_BOXES_MM)]
    result = decompose_model(tower, printers, OPTIONS, cost)
    heights_mm = {part.printer: np.ptp(part.build_printing_mesh()[0], axis=0)[2] for part in result.parts}
    assert heights_mm["low"] <= 100.0
    assert 100.0 < heights_mm["high"] <= 160.0
    with pytest.raises(NoFit, match="needs 3 parts"):
        decompose_model(tower, [replace(printers[0], name=str(i)) for i in range(2)], OPTIONS, cost)


def test_too_few_printers_are_reported_with_the_required_kind(cost: CostModel) -> None:
    """Check that the error asks for two more of the high printers."""
    model = Model(Solid.box((0, 0, 0), (90, 90, 700)), (), 1.0)
    options = replace(OPTIONS, granularity=8)
    low_printers = [TargetPrinter(f"low-{i}", LOW_BOXES_MM) for i in range(3)]
    high_printers = [TargetPrinter(f"high-{i}", HIGH_BOXES_MM) for i in range(3)]
    message = r"needs 6 parts.*there are 4 printers: free 2 more with room for 100 x 100 x 160 mm"
    with pytest.raises(NoFit, match=message) as error:
        decompose_model(model, [*low_printers, high_printers[0]], options, cost)
    assert error.value.needed_printer_count == 6
    assert len(decompose_model(model, [*low_printers, *high_printers], options, cost).parts) == 6
    with pytest.raises(NoFit, match="there are 5 printers: free 1 more"):
        decompose_model(model, [*low_printers, *high_printers[:2]], options, cost)


def test_fast_printer_gets_more_work(ring_with_bar: Solid, cost: CostModel) -> None:
    printers = [
        *(TargetPrinter(f"fine-{i}", HIGH_BOXES_MM) for i in range(3)),
        TargetPrinter("wide", HIGH_BOXES_MM, 0.45),
    ]
    model = Model(ring_with_bar, (), 1.0)
    result = decompose_model(model, printers, OPTIONS, cost)
    ends_s = compute_ends_s(result, printers)
    assert result.makespan_s == max(ends_s.values())
    assert result.makespan_s < 0.9 * compute_makespan_of_equal_printers_s(model, printers, cost)
    longest_part = max(result.parts, key=lambda part: part.price_s)
    assert longest_part.printer == "wide"
    assert result.lower_bound_s <= result.grid_makespan_s


def test_bound_holds_for_the_quickest_printer_with_the_largest_volume(
    ring_with_bar: Solid, cost: CostModel
) -> None:
    printers = [
        TargetPrinter("a", LOW_BOXES_MM, 1.2),
        TargetPrinter("b", LOW_BOXES_MM),
        TargetPrinter("c", HIGH_BOXES_MM, 0.7),
    ]
    result = decompose_model(Model(ring_with_bar, (), 1.0), printers, replace(OPTIONS, prove=True), cost)
    best_printers = [replace(printers[2], name=name) for name in "abc"]
    best_result = decompose_model(Model(ring_with_bar, (), 1.0), best_printers, OPTIONS, cost)
    assert 0.0 < result.lower_bound_s <= result.grid_makespan_s
    assert result.lower_bound_s <= best_result.grid_makespan_s * (1.0 + 1e-6)


def test_box_with_a_faulty_piece_is_excluded_for_all_classes(
    tower: Model, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    printers = (TargetPrinter("low", LOW_BOXES_MM), TargetPrinter("high", HIGH_BOXES_MM))
    problem = Problem(tower, printers, cost, OPTIONS)
    grid, tables, min_s = build_tables(problem)
    search = class_search._ClassSearch(problem, grid, tables, min_s)
    index = int(np.isfinite(np.sum([table.seconds for table in search.class_tables], axis=0)).argmax())
    box = find_box(index, tables.shape)
    monkeypatch.setattr(exact_search, "find_faults", lambda pieces, min_glue_mm2: [Fault(0, "is rejected")])
    assert search._exclude_faulty_boxes([box])
    assert len(search.class_tables) == 2
    assert [float(table.seconds[index]) for table in search.class_tables] == [np.inf, np.inf]
