"""From a submitted model to a plan: the real decomposition and CuraEngine, without processes around them."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh

from decompose.engines.guillotine import exact_search, plane_shift
from decompose.engines.parallelobox import search as parallelobox_search
from decompose.errors import NoFit
from decompose.options import Engine
from decompose.pieces import cut_box
from decompose.results import Attempt, Cutting
from drivers.clock import Clock
from farm.config import Fleet
from farm.control.controller import Controller
from farm.errors import ErrorCode, FarmError
from farm.model import AgentSnapshot, FilamentState, Job, JobOptions, JobState, Link, PartPrintOptions
from farm.planning.booking import MAY_FALL, MOST_WARNINGS, book_plan, list_job_files
from farm.planning.inspection.inspect_model import inspect_model, read_inspected
from farm.planning.part_records import SliceBatch, SlicedPart
from farm.planning.parts.cut_record import read_cut_record, write_cut_record
from farm.planning.parts.decompose_job import decompose_job
from farm.planning.parts.part_rooms import bed_boxes
from farm.planning.parts.printer_choice import LATE_SHARE
from farm.planning.parts.relevel_parts import relevel_parts
from farm.planning.parts.slice_part import slice_part
from farm.planning.parts.slice_tasks import build_slice_tasks
from farm.planning.plan import RELEVEL_LATE_S, DecomposeTask, SlicedJob, TooFewPrinters
from farm.planning.plate_times import prelude_seconds
from farm.planning.printer_settings import printer_settings, settings_request
from farm.state.storage.store import Store
from recording_controller import Commands, RecordedEffects
from slicing.checks import Unprinted
from slicing.settings import FARM_QUALITIES, find_resources, resolve_settings

MODEL = "ultimaker2_plus"


def fleet(count=2):
    printers = [{"name": f"p{i}", "model": MODEL, "port": f"sim://{MODEL}"} for i in range(count)]
    return Fleet.model_validate({"printers": printers})


@pytest.fixture
def files(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    return folder


@pytest.fixture
def bar(tmp_path, files):
    """A bar longer than a bed, as submitted."""
    path = tmp_path / "upload.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    return inspect_model(path, "bar.stl", JobOptions(), files)


def task(bar, files, tmp_path, printers=2, rounds=1):
    return DecomposeTask(
        job=1,
        model=files / bar.file,
        options=JobOptions(),
        printers=fleet(printers).printers,
        rounds=rounds,
        folder=tmp_path / "work",
        budget_s=0.0,  # the first engine alone: what it is cut by does not matter here
    )


class Slice:
    """What is known of a slice here."""

    def __init__(self, sliced_s):
        self.sliced_s = sliced_s


def slice_tasks(work, cut):
    return build_slice_tasks(SliceBatch(cut.parts, work.printers, work.options.quality, work.folder, None))


def join_slices(work, cut, tasks, slices):
    """A sliced job of these slices."""
    sections = {section.name: section for section in work.printers}
    each = zip(cut.parts, tasks, slices, strict=True)
    parts = (SlicedPart(part, sections[part.printer], one, result) for part, one, result in each)
    return SlicedJob(work, cut, tuple(parts))


def sliced(work, cut, late_s):
    """A sliced job whose parts take the mean of their prices, but for the last part, which takes longer."""
    tasks = slice_tasks(work, cut)
    prelude_s = prelude_seconds(work.printers[0], tasks[0].settings)
    seconds = [part.price_s - prelude_s for part in cut.parts]
    mean_s = sum(seconds) / len(seconds)
    seconds = [mean_s] * (len(seconds) - 1) + [mean_s + late_s]
    return join_slices(work, cut, tasks, map(Slice, seconds))


def test_a_part_that_is_sliced_slow_is_cut_smaller(bar, files, tmp_path):
    work = task(bar, files, tmp_path)
    cut = decompose_job(work)
    slow = sliced(work, cut, late_s=RELEVEL_LATE_S * 3)
    assert slow.makespan_s() == slow.parts[1].expected_s() == slow.busy_s()[cut.parts[1].printer]
    assert slow.should_relevel()
    after = relevel_parts(slow, tmp_path / "levelled")
    assert after.parts[1].geometry.volume_mm3 < cut.parts[1].geometry.volume_mm3
    assert sum(part.geometry.volume_mm3 for part in after.parts) == pytest.approx(260 * 14 * 12)
    assert {part.printer for part in after.parts} == {"p0", "p1"}
    assert all(part.stl.is_file() and part.stl.parent == tmp_path / "levelled" for part in after.parts)
    report = json.loads((tmp_path / "levelled" / "decomposition.json").read_text())
    assert [part["volume_mm3"] for part in report["parts"]] == [
        part.geometry.volume_mm3 for part in after.parts
    ]


def test_how_a_job_was_cut_is_read_back_to_the_last_bit(bar, files, tmp_path):
    """Boxes are grouped by their bytes; an infinite figure is no number of JSON."""
    cut = decompose_job(task(bar, files, tmp_path))
    first = read_cut_record(cut.cut_record)
    assert len(first.cutting.boxes_mm) == len(cut.parts) and first.parts == ()
    first = replace(first, lower_bound_s=float("inf"), attempts=(Attempt(Engine.BEST, 7, -0.0, None),))
    second = read_cut_record(write_cut_record(first, tmp_path))
    assert replace(second, cutting=None) == replace(first, cutting=None)
    for field in fields(Cutting):
        was, now = getattr(first.cutting, field.name), getattr(second.cutting, field.name)
        assert was.tobytes() == now.tobytes() if isinstance(was, np.ndarray) else was == now
    assert write_cut_record(replace(first, cutting=None), tmp_path) is None


@pytest.mark.parametrize("content", [b"", b"{}", b'{"engine": "best"}', b"\x80\x04"])
def test_a_broken_cut_record_is_named(content, tmp_path):
    path = tmp_path / "cut-record.json"
    path.write_bytes(content)
    with pytest.raises(FarmError, match=r"cut-record\.json: cannot be read"):
        read_cut_record(path)


def test_what_ends_together_is_not_levelled(bar, files, tmp_path):
    work = task(bar, files, tmp_path)
    cut = decompose_job(work)
    assert not sliced(work, cut, late_s=RELEVEL_LATE_S).should_relevel()  # in the mean half of that later
    assert not replace(sliced(work, cut, 1e4), decomposed=replace(cut, cut_record=None)).should_relevel()
    level = sliced(work, cut, late_s=0.0)
    assert relevel_parts(level, tmp_path / "levelled") is None


def test_a_slow_printer_is_busy_longer(bar, files, tmp_path):
    work = replace(task(bar, files, tmp_path), time_factors={"p0": 1.5})
    cut = decompose_job(work)
    level = sliced(work, cut, late_s=0.0)
    printed_s = level.parts[0].result.sliced_s
    assert level.busy_s()["p0"] == pytest.approx(
        level.busy_s()["p1"] + 0.5 * printed_s
    )  # of the layers alone


def test_where_a_printer_has_several_parts_they_are_not_levelled(bar, files, tmp_path):
    work = task(bar, files, tmp_path)
    cut = decompose_job(work)
    assert sliced(work, cut, late_s=1e4).should_relevel()
    both = replace(cut, parts=tuple(replace(part, printer="p0") for part in cut.parts))
    assert not sliced(work, both, late_s=1e4).should_relevel()


def test_the_engine_asked_for_cuts(bar, files, tmp_path):
    work = task(bar, files, tmp_path)
    grown = replace(work, options=JobOptions(engine="parallelobox"), budget_s=7.0)
    assert len(decompose_job(grown).parts) == 2
    report = json.loads((grown.folder / "decomposition.json").read_text())
    assert report["engine"] == "parallelobox"
    assert report["options"]["budget_s"] == 7.0


def test_a_plan_is_whole(bar, files, tmp_path):
    work = task(bar, files, tmp_path)
    cut = decompose_job(work)
    tasks = slice_tasks(work, cut)
    slices = [slice_part(one) for one in tasks]
    thin = Unprinted(120.0, 1.0, 9.0, 3.0, -4.0)
    cut = replace(
        cut, parts=(cut.parts[0], replace(cut.parts[1], print_options=PartPrintOptions(stands=False)))
    )
    slices[0] = replace(slices[0], unprinted=(thin,) * 9)
    plan = book_plan(join_slices(work, cut, tasks, slices), files)
    assert [p.warnings for p in plan.plates] == [(str(thin),) * MOST_WARNINGS, (MAY_FALL,)]
    assert [p.printer for p in plan.plates] == ["p0", "p1"]
    assert sum(p.geometry.volume_mm3 for p in plan.parts) == pytest.approx(260 * 14 * 12)
    assert plan.expected_s == max(p.expected_s for p in plan.plates)
    assert all(p.expected_s > p.sliced_s > 0 for p in plan.plates)
    assert plan.serial_s > plan.expected_s
    job = Job(
        id=1,
        request_id="r",
        name="bar",
        model_file=bar.file,
        options=work.options,
        submitted_s=0.0,
        picture=plan.picture,
        assembly=plan.assembly,
        decomposition=plan.decomposition,
    )
    names = list_job_files(job, plan.parts, plan.plates)
    assert set(names) == {
        *("p01.stl", "p02.stl", "plate-01.gcode", "plate-02.gcode"),
        *("assembly.png", "assembly.glb", "decomposition.json"),
    }
    assert all((files / stored).is_file() for stored in names.values())
    report = json.loads((files / names["decomposition.json"]).read_text())
    assert {part["file"] for part in report["parts"]} <= set(names)
    assert (files / names["assembly.glb"]).read_bytes()[:4] == b"glTF"
    none = list_job_files(job.model_copy(update={"assembly": None}), (), ())
    assert set(none) == {"assembly.png", "decomposition.json"}


def test_what_was_submitted_is_read_back_to_the_last_bit(tmp_path, files):
    path = tmp_path / "upload.stl"
    trimesh.creation.icosphere(2, 0.1).export(path)
    stored = inspect_model(path, "ball.stl", JobOptions(longest_side_mm=77.0), files)
    model = read_inspected(files / stored.file)
    assert model.scale == stored.scale == pytest.approx(385.0)
    assert np.ptp(model.solid.arrays()[0], axis=0).max() == pytest.approx(77.0, rel=1e-12)
    again = trimesh.creation.icosphere(2, 0.1)
    assert model.solid.volume_mm3 == pytest.approx(again.volume * stored.scale**3, rel=1e-5)


def test_too_few_printers_say_how_many_would_do_and_rounds_do(bar, files, tmp_path):
    with pytest.raises(TooFewPrinters) as error:
        decompose_job(task(bar, files, tmp_path, printers=1))
    assert error.value.needed == 2
    cut = decompose_job(task(bar, files, tmp_path, printers=1, rounds=2))
    assert [p.printer for p in cut.parts] == ["p0", "p0"]


def test_a_model_that_one_printer_can_hold_stays_whole_unless_a_person_gives_more(files, tmp_path):
    path = tmp_path / "upload.stl"
    trimesh.creation.box((60.0, 36.0, 28.0)).export(path)
    box = inspect_model(path, "box.stl", JobOptions(), files)
    assert [part.printer for part in decompose_job(task(box, files, tmp_path)).parts] == ["p0"]
    slow = replace(task(box, files, tmp_path), time_factors={"p0": 1.1})
    assert [part.printer for part in decompose_job(slow).parts] == ["p1"]
    given = replace(task(box, files, tmp_path), options=JobOptions(printers=2))
    assert len(decompose_job(given).parts) == 2


def test_as_few_parts_as_are_done_in_time_are_cut(files, tmp_path):
    path = tmp_path / "upload.stl"
    trimesh.creation.box((110.0, 36.0, 28.0)).export(path)
    box = inspect_model(path, "box.stl", JobOptions(), files)
    work = task(box, files, tmp_path, printers=3)
    (whole,) = decompose_job(replace(work, within_s=1e6)).parts
    takes_s = whole.price_s
    counts = [
        len(decompose_job(replace(work, within_s=share * takes_s * LATE_SHARE)).parts)
        for share in (1.0, 0.7, 0.01)
    ]
    assert counts == [1, 2, 3]


def test_the_first_layer_is_chosen_in_glue_alone(bar, files, tmp_path):
    glue = task(bar, files, tmp_path)
    paper = replace(glue, options=JobOptions(quality="paper"))
    for part in decompose_job(glue).parts:
        assert 0.0 <= part.print_options.brim_width_mm <= 8.05
        assert (
            part.print_options.layer_0_expansion_mm == -0.2
        )  # it was cut across, and that face meets the bed
    cut = decompose_job(paper)
    assert {part.print_options for part in cut.parts} == {PartPrintOptions()}
    assert {one.print_options for one in slice_tasks(paper, cut)} == {PartPrintOptions()}


def test_parts_that_overlap_are_found_and_the_job_is_refused(bar, files, tmp_path, monkeypatch):
    def larger(solid, lo, hi):
        return cut_box(solid, lo - 0.5, hi + 0.5)

    def too_large(solid, grid, box):
        return larger(solid, *grid.bounds_mm(box))

    for engine in (exact_search, parallelobox_search):
        monkeypatch.setattr(engine, "cut_cells", too_large)
    monkeypatch.setattr(plane_shift, "cut_box", larger)
    with pytest.raises(FarmError) as error:
        decompose_job(task(bar, files, tmp_path))
    assert error.value.code is ErrorCode.GEOMETRY
    assert "overlap" in str(error.value)
    controller = Controller(fleet(), Store(tmp_path / "farm.db"), Clock(), bed_boxes)
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


@pytest.mark.parametrize("quality", ["glue", "paper", "fast", "normal", "high"])
def test_parts_get_their_supports_in_every_quality(quality):
    """Their poses are chosen with them; Cura's own qualities have none by themselves."""
    section = fleet(1).printers[0]
    settings = printer_settings(section, quality, find_resources())
    assert settings.support_enabled
    assert settings.support_line_distance_mm > 0.0
    alone = replace(settings_request(section, quality), supported=False)
    assert resolve_settings(alone, find_resources()).support_enabled == (quality in FARM_QUALITIES)


def test_another_nozzle_makes_a_printer_slower_or_quicker(bar, files, tmp_path, monkeypatch):
    seen = []

    def caught(model, rooms, options, cost, executor):
        seen.extend(rooms)
        raise NoFit("seen enough")

    monkeypatch.setattr("farm.planning.parts.printer_choice.decompose_model", caught)
    nozzles = (0.4, 0.25, 0.8, 0.4)
    printers = [
        section.model_copy(update={"nozzle_mm": nozzle_mm})
        for section, nozzle_mm in zip(fleet(4).printers, nozzles, strict=True)
    ]
    work = task(bar, files, tmp_path)
    work = replace(work, printers=tuple(printers), options=JobOptions(printers=4), time_factors={"p3": 1.1})
    with pytest.raises(FarmError, match="seen enough"):
        decompose_job(work)
    assert [room.name for room in seen] == ["p0", "p1", "p2", "p3"]  # nobody asked for the coarse one
    first, fine, wide, worn = (room.time_factor for room in seen)
    assert (first, worn) == (1.0, 1.1)
    assert wide < 0.8 and fine > 1.5


def test_each_part_is_cut_and_sliced_for_the_printer_that_it_goes_to(files, tmp_path):
    """As high as a 2+ and a 2+ Extended together: on what both have room for it is three parts."""
    path = tmp_path / "upload.stl"
    trimesh.creation.box((80.0, 80.0, 480.0)).export(path)
    tower = inspect_model(path, "tower.stl", JobOptions(), files)
    low = fleet(1).printers[0]
    extended = "ultimaker2_extended_plus"
    changes = {"name": "high", "model": extended, "port": f"sim://{extended}", "nozzle_mm": 0.6}
    high = low.model_copy(update=changes)
    options = JobOptions(printers=2, engine="guillotine")
    work = replace(task(tower, files, tmp_path), printers=(low, high), options=options)
    cut = decompose_job(work)
    assert {part.printer for part in cut.parts} == {"p0", "high"}
    for one, part in zip(slice_tasks(work, cut), cut.parts, strict=True):
        height = np.ptp(trimesh.load_mesh(one.stl).bounds[:, 2])
        assert height > 205.0 if part.printer == "high" else height <= 205.0
        section = {"p0": low, "high": high}[part.printer]
        assert one.request == settings_request(section, "glue")
        assert max(box.height_mm for box in one.room) == (305.0 if part.printer == "high" else 205.0)
