from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest

from decompose import auto
from decompose.cost import CostModel, PrinterRoom
from decompose.errors import NoFit
from decompose.files import write
from decompose.mesh import Model
from decompose.report import Engine, Options
from decompose.solid import Solid

COARSE = Options(Engine.GUILLOTINE, granularity="vcoarse", prove=False)


def test_dear_handling_takes_fewer_printers(lump: Solid, fleet: list[PrinterRoom], cost: CostModel) -> None:
    model = Model(lump, (), 1.0)
    most = auto.decompose(model, fleet, COARSE, cost, clear_s=0.0, assemble_s=0.0)
    fewest = auto.decompose(model, fleet, COARSE, cost, clear_s=1e5, assemble_s=1e5)
    assert [p.printer for p in fewest.parts] == [fleet[0].name]
    assert len(most.parts) > 1
    assert [p.printers for p in most.curve] == list(range(1, len(fleet) + 1))
    assert all(b.makespan_s <= a.makespan_s for a, b in pairwise(most.curve))


def test_the_curve_is_in_the_report(
    tmp_path: Path, ball: Model, fleet: list[PrinterRoom], cost: CostModel
) -> None:
    write(auto.decompose(ball, fleet, COARSE, cost), tmp_path)
    curve = json.loads((tmp_path / "decomposition.json").read_text())["curve"]
    assert [set(point) for point in curve] == [{"printers", "makespan_s"}] * len(curve)
    assert curve


def test_too_few_printers_are_told_so(ball: Model, fleet: list[PrinterRoom], cost: CostModel) -> None:
    with pytest.raises(NoFit, match="there are 2"):
        auto.decompose(ball, fleet[:2], COARSE, cost)
