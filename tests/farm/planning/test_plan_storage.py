"""Records of a sliced job, from real slices."""

import json
from dataclasses import replace

import pytest

from books.decompose_tasks import join_slices, make_decompose_task, make_slice_tasks
from farm.model import Job, PartPrintOptions
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.job_drawing import draw_job_parts
from farm.planning.parts.slice_part import slice_part
from farm.planning.plan_storage import MAX_WALL_WARNINGS, MAY_FALL_WARNING, list_job_files, store_plan
from slicing.checks import UnprintedWall


def test_plan_has_every_part_and_plate(bar, files, tmp_path):
    task = make_decompose_task(bar, files, tmp_path)
    decomposition = decompose_job(task)
    plate_tasks = make_slice_tasks(task, decomposition)
    slices = [slice_part(item) for item in plate_tasks]
    thin_wall = UnprintedWall(120.0, 1.0, 9.0, 3.0, -4.0)
    decomposition = replace(
        decomposition,
        parts=(
            decomposition.parts[0],
            replace(decomposition.parts[1], print_options=PartPrintOptions(stands=False)),
        ),
    )
    slices[0] = replace(slices[0], unprinted_walls=(thin_wall,) * 9)
    draw_job_parts(task, decomposition.drawing_record)
    plan = store_plan(join_slices(task, decomposition, plate_tasks, slices), files)
    assert [p.warnings for p in plan.plates] == [(str(thin_wall),) * MAX_WALL_WARNINGS, (MAY_FALL_WARNING,)]
    assert [p.printer for p in plan.plates] == [part.printer for part in decomposition.parts]
    assert {p.printer for p in plan.plates} == {"p0", "p1"}
    assert sum(p.geometry.volume_mm3 for p in plan.parts) == pytest.approx(260 * 14 * 12)
    assert plan.expected_s == max(p.expected_s for p in plan.plates)
    assert all(p.expected_s > p.sliced_s > 0 for p in plan.plates)
    assert plan.serial_s > plan.expected_s
    job = Job(
        id=1,
        request_id="r",
        name="bar",
        model_file=bar.file,
        options=task.options,
        submitted_s=0.0,
        picture=plan.picture,
        assembly=plan.assembly,
        decomposition=plan.decomposition,
        instructions=plan.instructions,
    )
    names = list_job_files(job, plan.parts, plan.plates)
    assert set(names) == {
        *("p01.stl", "p02.stl", "plate-01.gcode", "plate-02.gcode"),
        *("assembly.png", "assembly.glb", "decomposition.json", "instructions.html"),
    }
    assert all((files / name).is_file() for name in names.values())
    report = json.loads((files / names["decomposition.json"]).read_text())
    assert {part["file"] for part in report["parts"]} <= set(names)
    assert (files / names["assembly.glb"]).read_bytes()[:4] == b"glTF"
    files_without_assembly = list_job_files(job.model_copy(update={"assembly": None}), (), ())
    assert set(files_without_assembly) == {"assembly.png", "decomposition.json", "instructions.html"}
