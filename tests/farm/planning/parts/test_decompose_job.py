"""Decomposition of a submitted model for its printers, without worker processes."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from books.decompose_tasks import make_decompose_task, make_fleet, make_slice_tasks
from books.recording_controller import Commands, RecordedEffects
from decompose.engines.guillotine import exact_search
from decompose.engines.guillotine.plane_shift import part_cutter
from decompose.engines.parallelobox import search as parallelobox_search
from decompose.errors import NoFit
from decompose.files.names import REPORT
from decompose.pieces import cut_box
from decompose.results import connect
from drivers.clock import Clock
from farm.control.controller import Controller
from farm.errors import ErrorCode, FarmError
from farm.model import AgentSnapshot, FilamentState, JobOptions, JobState, Link, PartPrintOptions, TimeFactors
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.parts.decompose_job import DEADLINE_MARGIN_RATIO, decompose_job
from farm.planning.parts.job_drawing import draw_job_parts
from farm.planning.plan import TooFewPrinters
from farm.planning.printer_settings import build_settings_request, list_bed_boxes
from farm.state.storage.store import Store


def test_requested_engine_is_used(bar, files, tmp_path):
    task = make_decompose_task(bar, files, tmp_path)
    parallelobox_task = replace(task, options=JobOptions(engine="parallelobox"), budget_s=7.0)
    decomposition = decompose_job(parallelobox_task)
    assert len(decomposition.parts) == 2
    report = json.loads((parallelobox_task.folder / "decomposition.json").read_text())
    assert report["engine"] == "parallelobox"
    assert report["options"]["budget_s"] == 7.0
    draw_job_parts(parallelobox_task, decomposition.drawing_record)
    page = (parallelobox_task.folder / "instructions.html").read_text()
    assert page.count(" the middle</td>") == 2


@pytest.mark.usefixtures("without_pictures")
def test_too_few_printers_report_the_required_number_unless_in_rounds(bar, files, tmp_path):
    with pytest.raises(TooFewPrinters) as error:
        decompose_job(make_decompose_task(bar, files, tmp_path, printers=1))
    assert error.value.needed_count == 2
    decomposition = decompose_job(make_decompose_task(bar, files, tmp_path, printers=1, round_count=2))
    assert [p.printer for p in decomposition.parts] == ["p0", "p0"]


@pytest.mark.usefixtures("without_pictures")
def test_model_for_one_printer_stays_whole_unless_more_are_requested(files, tmp_path):
    path = tmp_path / "upload.stl"
    trimesh.creation.box((60.0, 36.0, 28.0)).export(path)
    box = inspect_model(path, "box.stl", JobOptions(), files)
    assert [part.printer for part in decompose_job(make_decompose_task(box, files, tmp_path)).parts] == ["p0"]
    slow_task = replace(make_decompose_task(box, files, tmp_path), time_factors={"p0": TimeFactors(1.1)})
    assert [part.printer for part in decompose_job(slow_task).parts] == ["p1"]
    report = json.loads((slow_task.folder / REPORT).read_text())
    assert [part["printer"] for part in report["parts"]] == ["p1"]
    two_printer_task = replace(make_decompose_task(box, files, tmp_path), options=JobOptions(printers=2))
    assert len(decompose_job(two_printer_task).parts) == 2


@pytest.mark.usefixtures("without_pictures")
def test_dry_run_of_a_whole_model_shows_what_more_printers_would_save(files, tmp_path):
    path = tmp_path / "upload.stl"
    trimesh.creation.box((60.0, 36.0, 28.0)).export(path)
    box = inspect_model(path, "box.stl", JobOptions(), files)
    task = replace(make_decompose_task(box, files, tmp_path), options=JobOptions(dry_run=True))
    (whole_part,) = decompose_job(task).parts
    curve = json.loads((task.folder / REPORT).read_text())["curve"]
    assert [point["printers"] for point in curve] == [1, 2]
    assert curve[0]["makespan_s"] == pytest.approx(whole_part.price_s, rel=0.3)
    assert curve[1]["makespan_s"] < curve[0]["makespan_s"]


@pytest.mark.usefixtures("without_pictures")
def test_fewest_parts_that_end_in_time_are_cut(files, tmp_path):
    path = tmp_path / "upload.stl"
    trimesh.creation.box((110.0, 36.0, 28.0)).export(path)
    box = inspect_model(path, "box.stl", JobOptions(), files)
    task = make_decompose_task(box, files, tmp_path, printers=3)
    (whole_part,) = decompose_job(replace(task, time_limit_s=1e6)).parts
    whole_s = whole_part.price_s
    counts = [
        len(decompose_job(replace(task, time_limit_s=share * whole_s * DEADLINE_MARGIN_RATIO)).parts)
        for share in (1.0, 0.7, 0.01)
    ]
    assert counts == [1, 2, 3]


@pytest.mark.usefixtures("without_pictures")
def test_first_layer_is_fitted_only_in_quality_glue(bar, files, tmp_path):
    glue_task = make_decompose_task(bar, files, tmp_path)
    paper_task = replace(glue_task, options=JobOptions(quality="paper"))
    for part in decompose_job(glue_task).parts:
        assert 0.0 <= part.print_options.brim_width_mm <= 8.05
        # The bar was cut across, and the cut face is on the bed.
        assert part.print_options.layer_0_expansion_mm == -0.2
    decomposition = decompose_job(paper_task)
    assert {part.print_options for part in decomposition.parts} == {PartPrintOptions()}
    assert {item.print_options for item in make_slice_tasks(paper_task, decomposition)} == {
        PartPrintOptions()
    }


@pytest.mark.usefixtures("without_pictures")
@pytest.mark.parametrize(
    ("mesh", "is_visible"),
    [(trimesh.creation.cone(30.0, 10.0), False), (trimesh.creation.box((60.0, 36.0, 28.0)), True)],
)
def test_visible_flat_tops_reach_the_report_and_the_slicer(mesh, is_visible, files, tmp_path):
    path = tmp_path / "upload.stl"
    mesh.export(path)
    task = make_decompose_task(inspect_model(path, "model.stl", JobOptions(), files), files, tmp_path)
    slice_tasks = make_slice_tasks(task, decompose_job(task))
    assert {item.print_options.flat_tops_visible for item in slice_tasks} == {is_visible}
    report = json.loads((task.folder / REPORT).read_text())
    assert {part["flat_tops_visible"] for part in report["parts"]} == {is_visible}


@pytest.mark.usefixtures("without_pictures")
def test_parts_that_overlap_are_found_and_the_job_is_refused(bar, files, tmp_path, monkeypatch):
    def cut_enlarged_box(solid, lo, hi):
        return cut_box(solid, lo - 0.5, hi + 0.5)

    def cut_enlarged_cells(solid, grid, box):
        return cut_enlarged_box(solid, *grid.find_bounds_mm(box))

    for engine in (exact_search, parallelobox_search):
        monkeypatch.setattr(engine, "cut_cells", cut_enlarged_cells)
    monkeypatch.setattr(part_cutter, "cut_box", cut_enlarged_box)
    with pytest.raises(FarmError) as error:
        decompose_job(make_decompose_task(bar, files, tmp_path))
    assert error.value.code is ErrorCode.GEOMETRY
    assert "overlap" in str(error.value)
    controller = Controller(make_fleet(), Store(tmp_path / "farm.db"), Clock(), list_bed_boxes)
    effects = RecordedEffects()
    controller.start(effects)
    for name in ("p0", "p1"):
        controller.on_snapshot(
            AgentSnapshot(printer=name, link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
        )
    Commands(controller).jobs.submit("r" * 8, "bar.stl", bar, JobOptions())
    controller.on_plan(1, error.value)
    job = controller.books.jobs[1]
    assert (job.state, job.error) == (JobState.FAILED, ErrorCode.GEOMETRY)
    assert job.reason == str(error.value)
    assert effects.instructions == []


def test_speed_of_a_printer_depends_on_its_nozzle(bar, files, tmp_path, monkeypatch):
    used_printers = []

    def record_call(model, printers, options, cost, executor):
        used_printers.extend(printers)
        raise NoFit("seen enough")

    monkeypatch.setattr("farm.planning.parts.decompose_job.decompose_model", record_call)
    nozzles = (0.4, 0.25, 0.8, 0.4)
    printers = [
        section.model_copy(update={"nozzle_mm": nozzle_mm})
        for section, nozzle_mm in zip(make_fleet(4).printers, nozzles, strict=True)
    ]
    task = make_decompose_task(bar, files, tmp_path)
    factors = {"p3": TimeFactors(1.1)}
    task = replace(task, printers=tuple(printers), options=JobOptions(printers=4), time_factors=factors)
    with pytest.raises(FarmError, match="seen enough"):
        decompose_job(task)
    # All printers are used, including those with other nozzles.
    assert [printer.name for printer in used_printers] == [
        "p0",
        "p1",
        "p2",
        "p3",
    ]
    default_factor, narrow_nozzle_factor, wide_nozzle_factor, slow_printer_factor = (
        printer.time_factor for printer in used_printers
    )
    assert (default_factor, slow_printer_factor) == (1.0, 1.1)
    assert wide_nozzle_factor < 0.8 and narrow_nozzle_factor > 1.5


@pytest.mark.usefixtures("without_pictures")
def test_each_part_is_cut_and_sliced_for_its_own_printer(files, tmp_path):
    """Use a model as high as a 2+ and a 2+ Extended together; their common volume would need three parts."""
    path = tmp_path / "upload.stl"
    trimesh.creation.box((80.0, 80.0, 480.0)).export(path)
    tower = inspect_model(path, "tower.stl", JobOptions(), files)
    low_printer = make_fleet(1).printers[0]
    extended_model = "ultimaker2_extended_plus"
    changes = {"name": "high", "model": extended_model, "port": f"sim://{extended_model}", "nozzle_mm": 0.6}
    high_printer = low_printer.model_copy(update=changes)
    options = JobOptions(printers=2, engine="guillotine")
    task = replace(
        make_decompose_task(tower, files, tmp_path), printers=(low_printer, high_printer), options=options
    )
    decomposition = decompose_job(task)
    assert {part.printer for part in decomposition.parts} == {"p0", "high"}
    for item, part in zip(make_slice_tasks(task, decomposition), decomposition.parts, strict=True):
        height_mm = np.ptp(trimesh.load_mesh(item.stl).bounds[:, 2])
        assert height_mm > 205.0 if part.printer == "high" else height_mm <= 205.0
        section = {"p0": low_printer, "high": high_printer}[part.printer]
        assert item.request == build_settings_request(section, "glue")
        assert max(box.height_mm for box in item.usable_volumes) == (
            305.0 if part.printer == "high" else 205.0
        )


@pytest.mark.usefixtures("without_pictures")
def test_omitted_pins_are_reported_with_the_job(bar, files, tmp_path, monkeypatch):
    def fail_to_plan(*args):
        raise RuntimeError("QH6154 initial simplex is flat")

    monkeypatch.setattr(connect, "plan_connectors", fail_to_plan)
    pinned_task = replace(make_decompose_task(bar, files, tmp_path), options=JobOptions(pin_mm=2.85))
    result = decompose_job(pinned_task)
    assert len(result.parts) == 2
    assert result.repairs[-1] == "Warning: no pins and marks: QH6154 initial simplex is flat."
