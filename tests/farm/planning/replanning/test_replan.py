"""Parts that are sliced for another printer or cut again, with the real decomposition and CuraEngine."""

import asyncio
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from books.make_books import make_plan_event
from clusters.same_process import SameProcess
from decompose.geometry import Solid
from decompose.options import PairShape
from farm.config import Fleet
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, Part, PartPrintOptions, Plate
from farm.paths import StateFolder
from farm.planning.plan_storage import MAX_WALL_WARNINGS, MAY_FALL_WARNING
from farm.planning.replanning import replan
from farm.planning.replanning.cut_part import cut_part, read_used_shapes
from farm.planning.replanning.plate_replanner import PlateReplanner
from farm.planning.replanning.replan import ReplannedPlate, ReplanTask
from farm.state.storage.file_store import store_file

PLUS, UM2 = "ultimaker2_plus", "ultimaker2"
ROTATION = trimesh.transformations.euler_matrix(0.3, np.pi / 2, -1.1)
ROTATION[:3, 3] = (40.0, -7.0, 300.0)


@pytest.fixture
def state(tmp_path):
    folder = StateFolder(tmp_path / "state")
    folder.make()
    return folder


def make_task(state, size_mm=(160.0, 90.0, 70.0), models=(PLUS, PLUS, UM2)):
    """Make a task for a block of a planned job that is rotated in its model."""
    stl = state.work / "p01.stl"
    block = trimesh.creation.box(size_mm)
    block.apply_translation((0.0, 0.0, size_mm[2] / 2))
    block.export(stl)
    names = zip("abc", models, strict=False)
    fleet = Fleet.model_validate(
        {"printers": [{"name": n, "model": model, "port": f"sim://{model}"} for n, model in names]}
    )
    plan_event = make_plan_event(1, 2)
    planned_part: Part = plan_event.parts[0]
    part = planned_part.model_copy(
        update={
            "file": store_file(state.files, stl),
            "geometry": planned_part.geometry.model_copy(update={"to_model": tuple(ROTATION.ravel())}),
            "print_options": PartPrintOptions(brim_width_mm=3.0),
        }
    )
    plate: Plate = plan_event.plates[0]
    folder = state.work / "replan"
    folder.mkdir(exist_ok=True)
    other_part = plan_event.parts[1].model_copy(update={"file": part.file})
    options = JobOptions(engine="guillotine")
    return ReplanTask(plate, part, options, fleet.printers, state.files, folder, other_parts=(other_part,))


def read_in_model_frame(path, to_model):
    mesh = trimesh.load_mesh(path)
    matrix = np.reshape(to_model, (4, 4))
    return Solid.from_arrays(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3], mesh.faces)


def test_part_that_ends_sooner_whole_is_not_cut(state):
    with pytest.raises(FarmError, match="in one piece") as error:
        cut_part(make_task(state, (30.0, 20.0, 5.0)))
    assert error.value.code is ErrorCode.NO_FIT


def run_replan(state, task, is_cut):
    results = []

    async def main():
        replanner = PlateReplanner(state, SameProcess(), lambda *outcome: results.append(outcome))
        replanner.start(task, is_cut)
        while not results:
            await asyncio.sleep(0)

    asyncio.run(main())
    ((plate, result),) = results
    assert plate == task.plate.id
    assert not list(state.work.glob("replan*"))
    return result


def test_pieces_fill_their_part_exactly_and_are_each_sliced_for_their_own_printer(state):
    task = make_task(state)
    part_solid = read_in_model_frame(state.files / task.part.file, task.part.geometry.to_model)
    result = run_replan(state, task, is_cut=True)
    assert isinstance(result, ReplannedPlate), result
    solids = [read_in_model_frame(state.files / part.file, part.geometry.to_model) for part in result.parts]
    union = Solid.union(solids)
    volumes = (
        sum(solid.volume_mm3 for solid in solids),  # no volume is missing
        union.volume_mm3,  # no pieces overlap
        part_solid.intersect(union).volume_mm3,  # all pieces are within the part
    )
    assert volumes == pytest.approx((part_solid.volume_mm3,) * 3, rel=1e-5)
    for part, solid in zip(result.parts, solids, strict=True):
        assert np.allclose(solid.bounds_mm, (part.geometry.min_mm, part.geometry.max_mm), atol=1e-3)
    letters = "abc"[: len(result.parts)]
    assert [part.id for part in result.parts] == [f"1/p01{letter}" for letter in letters]
    assert [plate.id for plate in result.plates] == [f"1/01{letter}" for letter in letters]
    assert {part.cut_from for part in result.parts} == {"1/p01"}
    assert len({plate.printer for plate in result.plates}) == len(result.plates)
    families = {"a": PLUS, "b": PLUS, "c": UM2}
    assert all(plate.family == families[plate.printer] for plate in result.plates)
    report = json.loads((state.files / result.decomposition).read_text())
    assert [(item["id"], item["file"]) for item in report["parts"]] == [
        (f"p01{letter}", f"p01{letter}.stl") for letter in letters
    ]
    for item, part in zip(report["parts"], result.parts, strict=True):
        assert np.allclose(np.ravel(item["to_model"]), part.geometry.to_model)
    assert {item["a"] for item in report["joints"]} <= {item["id"] for item in report["parts"]}
    for name in (
        result.picture,
        result.assembly,
        *(part.file for part in result.parts),
        *(plate.gcode for plate in result.plates),
    ):
        assert (state.files / name).is_file()


def test_part_is_sliced_for_another_printer_and_its_plan_is_kept(state):
    task = make_task(state, (40.0, 30.0, 4.0), (UM2,))
    result = run_replan(state, task, is_cut=False)
    assert isinstance(result, ReplannedPlate), result
    ((part,), (plate,)) = result.parts, result.plates
    assert part == task.part.model_copy(update={"plate": "1/01-2"})
    assert (plate.id, plate.family, plate.printer, plate.parts) == ("1/01-2", UM2, "a", ("1/p01",))
    assert (state.files / task.part.file).is_file()
    assert (state.files / plate.gcode).is_file()


def test_printer_that_would_omit_walls_is_not_used(state, monkeypatch):
    task = make_task(state, (40.0, 0.5, 4.0), (UM2,))
    task = replace(task, printers=(task.printers[0].model_copy(update={"nozzle_mm": 0.8}),))
    result = run_replan(state, task, is_cut=False)
    assert isinstance(result, FarmError)
    assert (state.files / task.part.file).is_file()
    assert replan.make_next_plate_id("1/01") == "1/01-2"


@pytest.mark.parametrize(
    ("warnings", "wall_count", "is_accepted"),
    [
        (
            ("a thin wall",) * MAX_WALL_WARNINGS,
            MAX_WALL_WARNINGS + 5,
            True,
        ),  # further walls were not recorded
        (("a thin wall",), 2, False),
        ((MAY_FALL_WARNING,), 1, False),
        ((), 0, True),
    ],
)
def test_printer_is_used_if_it_omits_no_more_walls_than_the_old_one(
    state, monkeypatch, warnings, wall_count, is_accepted
):
    task = make_task(state, (40.0, 30.0, 4.0), (UM2,))
    task = replace(task, plate=task.plate.model_copy(update={"warnings": warnings}))
    monkeypatch.setattr(replan, "store_plate", lambda *_: task.plate)
    slice_result = SimpleNamespace(unprinted_walls=("a thin wall",) * wall_count)
    sliced_part = SimpleNamespace(result=slice_result, printer=task.printers[0])
    if is_accepted:
        assert replan.store_resliced_part(task, sliced_part).plates == (task.plate,)
    else:
        with pytest.raises(FarmError, match="a thin wall"):
            replan.store_resliced_part(task, sliced_part)


def test_pins_of_pieces_avoid_the_pairs_of_the_job(state):
    pins = [
        {"step": step, "at_mm": [x, 0.0, z], "axis": [0.0, 0.0, 1.0], "length_mm": 5.0}
        for step, x, z in [(1, 0.0, 0.0), (1, 30.0, 5.0), (2, 7.0, 0.0)]
    ]
    names = []
    for number, report in enumerate(({"connectors": {"pins": pins}}, {"parts": []})):
        path = state.work / f"report{number}.json"
        path.write_text(json.dumps(report))
        names.append(store_file(state.files, path))
    shapes = read_used_shapes(replace(make_task(state), reports=tuple(names)))
    assert shapes == (PairShape(30.0, (None, None), (5.0, 5.0)),)
