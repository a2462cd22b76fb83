"""Number of printers chosen from the curve of makespans."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from decompose import auto
from decompose.engines.guillotine import CurvePoint
from decompose.errors import NoFit
from decompose.export import write_decomposition
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter

COARSE_OPTIONS = Options(Engine.GUILLOTINE, granularity="vcoarse", prove=False)


def test_expensive_handling_uses_fewer_printers(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    model = Model(ring_with_bar, (), 1.0)
    result = auto.decompose_for_goal(model, fleet, COARSE_OPTIONS, cost, goal=auto.CountGoal(0.0, 0.0))
    fewest_result = auto.decompose_for_goal(model, fleet, COARSE_OPTIONS, cost, goal=auto.CountGoal(1e5, 1e5))
    assert [p.printer for p in fewest_result.parts] == [fleet[0].name]
    assert len(result.parts) > 1
    assert [p.printer_count for p in result.curve] == list(range(1, len(fleet) + 1))
    assert all(b.makespan_s <= a.makespan_s for a, b in pairwise(result.curve))


def test_curve_considers_the_speed_of_printers(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    model = Model(ring_with_bar, (), 1.0)
    printers = [replace(fleet[0], name=name, time_factor=f) for name, f in (("slow", 2.0), ("slower", 4.0))]
    equal_curve, slow_curve = (
        auto.decompose_for_goal(model, used, COARSE_OPTIONS, cost).curve for used in (fleet[:2], printers)
    )
    speed_ratio, curve_ratio = (
        b.makespan_s / a.makespan_s for a, b in zip(equal_curve, slow_curve, strict=True)
    )
    assert speed_ratio == pytest.approx(2.0)
    assert curve_ratio == pytest.approx(8.0 / 3.0, rel=0.05)  # two printers of these speeds share the work


def test_curve_considers_the_build_volumes_of_printers(cost: CostModel) -> None:
    """Use a model that needs three parts of the low printer's size, but only two if one may be high."""
    low_printer, high_printer = (
        TargetPrinter("low", ((100.0,) * 3,)),
        TargetPrinter("high", ((100.0, 100.0, 160.0),)),
    )
    model = Model(Solid.box((0, 0, 0), (90, 90, 230)), (), 1.0)
    fine_options = replace(COARSE_OPTIONS, granularity=6)
    result = auto.decompose_for_goal(model, [low_printer, high_printer], fine_options, cost)
    assert [point.printer_count for point in result.curve] == [2]
    assert {part.printer for part in result.parts} == {"low", "high"}
    low_printers = [replace(low_printer, name=str(i)) for i in range(3)]
    curves = [
        auto.decompose_for_goal(model, printers, fine_options, cost).curve
        for printers in ([*low_printers, high_printer], [high_printer, *low_printers])
    ]
    assert [[point.printer_count for point in curve] for curve in curves] == [[3, 4], [2, 3, 4]]
    assert curves[1][0].makespan_s == result.curve[0].makespan_s


def test_all_printers_are_used_if_the_curve_is_too_optimistic(
    ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = Model(Solid.union([ring_with_bar, Solid.box((0, 0, 300), (20, 20, 320))]), (), 1.0)
    monkeypatch.setattr(auto, "build_curve", lambda problem: (CurvePoint(1, 100.0),))
    assert len(auto.decompose_for_goal(model, fleet[:3], COARSE_OPTIONS, cost).parts) > 1


def test_curve_is_in_the_report(
    tmp_path: Path, ring_with_bar: Solid, fleet: list[TargetPrinter], cost: CostModel
) -> None:
    model = Model(ring_with_bar, (), 1.0)
    write_decomposition(auto.decompose_for_goal(model, fleet[:3], COARSE_OPTIONS, cost), tmp_path)
    curve = json.loads((tmp_path / "decomposition.json").read_text())["curve"]
    assert [set(point) for point in curve] == [{"printers", "makespan_s"}] * len(curve)
    assert curve


def test_too_few_printers_are_refused(ball: Model, fleet: list[TargetPrinter], cost: CostModel) -> None:
    with pytest.raises(NoFit, match="there are 2"):
        auto.decompose_for_goal(ball, fleet[:2], COARSE_OPTIONS, cost)
