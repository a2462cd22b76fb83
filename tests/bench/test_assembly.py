"""Simulated assembly by the instructions alone, in which unrelated parts do not fit together."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.assembly import MatingFace, assemble, find_placements
from decompose.decompose import decompose_model
from decompose.export import write_decomposition
from decompose.geometry import Model, Solid
from decompose.options import ConnectorOptions, Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Decompose a table into three parts with pins and marks; return the folder of the files."""
    legs = [Solid.box((x, y, 0), (x + 20, y + 20, 90)) for x in (0, 100) for y in (0, 100)]
    solid = Solid.union([Solid.box((0, 0, 80), (120, 120, 100)), *legs])
    printers = [TargetPrinter(name, ((50.0, 130.0, 130.0),)) for name in "abc"]
    options = Options(
        Engine.GUILLOTINE, granularity=8, prove=False, connectors=ConnectorOptions(2.85, marks=True)
    )
    cost = CostModel(1.0, *[1e-3] * 7, brim_mm=0.0)
    path = tmp_path_factory.mktemp("table")
    write_decomposition(decompose_model(Model(solid, (), 1.0), printers, options, cost), path)
    return path


def test_codes_and_pins_allow_only_the_correct_assembly(folder: Path) -> None:
    outcome = assemble(folder)
    assert (outcome.steps, outcome.correct) == (2, 2)
    assert (outcome.misread, outcome.ambiguous, outcome.wrong, outcome.wrong_fits) == (0, 0, 0, 0)
    assert outcome.least_gap_mm > 0.5


def test_swapped_parts_are_detected(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    shutil.copyfile(folder / "p01.stl", tmp_path / "p02.stl")
    shutil.copyfile(folder / "p02.stl", tmp_path / "p01.stl")
    outcome = assemble(tmp_path)
    assert outcome.misread > 0 and outcome.correct < outcome.steps


def make_face(depths_mm: list[float], up_z: float) -> MatingFace:
    positions_mm = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    return MatingFace(
        positions_mm, np.array(depths_mm), np.tile([0.0, 0.0, up_z], (2, 1)), {}, np.zeros(2, dtype=np.bool_)
    )


def test_parts_fit_in_one_way_on_unequal_pins_and_in_two_on_equal_pins() -> None:
    unequal_faces = [make_face([7.0, 4.0], up_z) for up_z in (1.0, -1.0)]
    equal_faces = [make_face([7.0, 7.0], up_z) for up_z in (1.0, -1.0)]
    assert len(list(find_placements(*unequal_faces, [13.0, 7.0]))) == 1
    assert len(list(find_placements(*equal_faces, [13.0, 13.0]))) == 2
    wider_face = replace(unequal_faces[1], positions_mm=1.1 * unequal_faces[1].positions_mm)
    # The distances of the pins differ.
    assert list(find_placements(unequal_faces[0], wider_face, [13.0, 7.0])) == []
    assert list(find_placements(unequal_faces[0], wider_face, None)) == []
    # If the lengths of the pins are unknown, parts fit if all holes meet.
    assert len(list(find_placements(*equal_faces, None))) == 2


def test_parts_fit_in_one_way_on_keys_of_two_lengths_and_keys_fit_no_holes() -> None:
    holes = [make_face([4.05, 2.55], up_z) for up_z in (1.0, -1.0)]
    grooves = [replace(face, is_groove=np.ones(2, dtype=np.bool_)) for face in holes]
    assert len(list(find_placements(*grooves, [], [8.0, 5.0]))) == 1
    assert list(find_placements(*holes, [], [8.0, 5.0])) == []
    assert list(find_placements(grooves[0], holes[1], None)) == []
