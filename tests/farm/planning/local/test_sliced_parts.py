"""`farm decompose --slice`: G-code of each part, and cuts moved only where the slowest slice ends sooner."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import trimesh

from decompose.decompose import decompose_model
from decompose.errors import GeometryError
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter
from farm.errors import FarmError
from farm.planning.local import sliced_parts
from farm.planning.local.decompose_file import decompose_to_folder
from farm.planning.local.sliced_parts import SlicedParts, rebalance_by_slices
from tests.farm.planning.local.test_decompose_file import USUAL_OPTIONS, DecomposeRequest


def make_request(**options) -> DecomposeRequest:
    return DecomposeRequest(**{**USUAL_OPTIONS, "printer_count": 2, "slices_parts": True, **options})


def test_slices_are_written_beside_the_parts_and_deleted_by_the_next_run(tmp_path):
    bar, path = tmp_path / "bar.stl", tmp_path / "out"
    trimesh.creation.box((40.0, 12.0, 4.0)).export(bar)
    report = decompose_to_folder(bar, path, make_request(quality="paper"), tmp_path / "cache")
    record = json.loads((path / "decomposition.json").read_text())
    assert record["parts"] == report["parts"]
    assert report["sliced_makespan_s"] == max(part["sliced_s"] for part in report["parts"])
    for part in report["parts"]:
        assert part["sliced_s"] == pytest.approx(part["estimated_s"], rel=0.25)
        assert part["grams"] > 0.0
        assert b"G1" in (path / part["gcode"]).read_bytes()
    unsliced_report = decompose_to_folder(bar, path, make_request(slices_parts=False))
    assert "sliced_makespan_s" not in unsliced_report
    assert not list(path.glob("*.gcode"))


def test_quality_determines_the_price(tmp_path):
    bar = tmp_path / "bar.stl"
    trimesh.creation.box((40.0, 12.0, 4.0)).export(bar)
    prices = [
        decompose_to_folder(bar, tmp_path / quality, make_request(slices_parts=False, quality=quality))[
            "makespan_s"
        ]
        for quality in ("glue", "paper")
    ]
    assert prices[0] != prices[1]
    with pytest.raises(FarmError, match="best-of-all"):
        decompose_to_folder(bar, tmp_path / "none", make_request(quality="best-of-all"))


class Slicer:
    """Slicer whose slices take the given times in each round."""

    def __init__(self, *rounds_s) -> None:
        self.rounds_s = list(rounds_s)
        self.folders: list[str] = []

    def slice_parts(self, decomposition, folder: Path) -> SlicedParts:
        self.folders.append(folder.name)
        times_s = self.rounds_s[len(self.folders) - 1]
        return SlicedParts(decomposition, tuple(SimpleNamespace(sliced_s=time_s) for time_s in times_s))


@pytest.fixture(scope="module")
def decomposition():
    printers = [TargetPrinter(name, ((200.0, 200.0, 200.0),)) for name in "ab"]
    model = Model(Solid.box((0, 0, 0), (120, 30, 20)), (), 1.0)
    options = Options(Engine.GUILLOTINE, 4, prove=False)
    return decompose_model(model, printers, options, CostModel.from_settings(PrintTimeSettings()))


@pytest.mark.parametrize(
    ("moves", "rounds_s", "best_times_s", "folders"),
    [
        ([1, 2, None], [(90.0, 100.0), (96.0, 95.0), (95.5, 95.2)], (95.5, 95.2), ["0", "1", "2"]),
        ([1, None], [(90.0, 100.0), (101.0, 90.0)], (90.0, 100.0), ["0", "1"]),
        ([1, 2, None], [(90.0, 100.0), (101.0, 90.0), (96.0, 95.0)], (96.0, 95.0), ["0", "1", "2"]),
        ([None], [(90.0, 100.0)], (90.0, 100.0), ["0"]),
        ([GeometryError("wall", None, "thin")], [(90.0, 100.0)], (90.0, 100.0), ["0"]),
        (["faulty"], [(90.0, 100.0)], (90.0, 100.0), ["0"]),
    ],
    ids=["twice", "not sooner", "sooner after another move", "no gain", "broken rule", "bad to glue"],
)
def test_cuts_are_moved_while_the_slowest_slice_may_end_sooner(
    decomposition, tmp_path, monkeypatch, moves, rounds_s, best_times_s, folders
):
    slicer, pending_moves = Slicer(*rounds_s), list(moves)

    def rebalance_planes(model, rounds, cost, executor):
        assert [cuts.times_s for cuts in rounds] == rounds_s[: len(slicer.folders)]
        assert [cuts.makespan_s for cuts in rounds] == [max(cuts.times_s) for cuts in rounds]
        move = pending_moves.pop(0)
        if isinstance(move, Exception):
            raise move
        return move and replace(decomposition, faults=("is a sliver",) if move == "faulty" else ())

    monkeypatch.setattr(sliced_parts, "rebalance_planes", rebalance_planes)
    best_slices = rebalance_by_slices(None, decomposition, slicer, None, None, tmp_path)
    assert best_slices.times_s == best_times_s
    assert slicer.folders == folders
