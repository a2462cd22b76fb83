"""Tasks and sliced jobs for a bar that is longer than a bed, planned without processes."""

from pathlib import Path

from farm.config import Fleet
from farm.model import JobOptions
from farm.planning.part_records import SliceBatch, SlicedPart
from farm.planning.plan import DecomposeTask, SlicedJob
from farm.planning.plate_times import compute_overhead_s
from farm.planning.slice_batch import build_slice_tasks
from slicing.checks import FeatureTimes
from slicing.plate import PlateResult

PRINTER_MODEL = "ultimaker2_plus"


def make_fleet(count=2):
    printers = [
        {"name": f"p{i}", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"} for i in range(count)
    ]
    return Fleet.model_validate({"printers": printers})


def make_decompose_task(bar, files, tmp_path, printers=2, round_count=1):
    return DecomposeTask(
        job=1,
        model=files / bar.file,
        options=JobOptions(),
        printers=make_fleet(printers).printers,
        round_count=round_count,
        folder=tmp_path / "work",
        budget_s=0.0,  # one engine is enough for this bar
    )


def make_plate_result(sliced_s, gcode=Path("plate.gcode")):
    """Make the result of slicing a part, with fixed shares of its features."""
    shares = (0.5, 0.2, 0.1, 0.0, 0.2)
    return PlateResult(
        gcode, "0" * 64, sliced_s, filament_mm=600.0, filament_mm3=3800.0, grams=5.0, layers=20,
        height_mm=28.0, min_mm=(-10.0, -10.0, 0.0), max_mm=(10.0, 10.0, 28.0), is_cached=False,
        features=FeatureTimes(*(share * sliced_s for share in shares)),
    )  # fmt: skip


def make_slice_tasks(task, decomposition):
    return build_slice_tasks(
        SliceBatch(decomposition.parts, task.printers, task.options.quality, task.folder, None)
    )


def join_slices(task, decomposition, tasks, slices):
    """Return the sliced job that has these results of slicing."""
    sections = {section.name: section for section in task.printers}
    triples = zip(decomposition.parts, tasks, slices, strict=True)
    parts = (SlicedPart(part, sections[part.printer], item, result) for part, item, result in triples)
    return SlicedJob(task, decomposition, tuple(parts))


def slice_with_slow_part(task, decomposition, extra_s):
    """Return a sliced job in which each part takes the mean price, and the last one `extra_s` longer."""
    tasks = make_slice_tasks(task, decomposition)
    overhead_s = compute_overhead_s(task.printers[0], tasks[0].settings)
    seconds = [part.price_s - overhead_s for part in decomposition.parts]
    mean_s = sum(seconds) / len(seconds)
    seconds = [mean_s] * (len(seconds) - 1) + [mean_s + extra_s]
    return join_slices(task, decomposition, tasks, map(make_plate_result, seconds))
