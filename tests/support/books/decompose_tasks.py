"""Tasks and sliced jobs for a bar that is longer than a bed, planned without processes."""

from farm.config import Fleet
from farm.model import JobOptions
from farm.planning.part_records import SliceBatch, SlicedPart
from farm.planning.plan import DecomposeTask, SlicedJob
from farm.planning.plate_times import compute_overhead_s
from farm.planning.slice_batch import build_slice_tasks
from slicing.checks import FeatureTimes

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


class FakeSliceResult:
    """Result of slicing a part, with fixed shares of its features."""

    def __init__(self, sliced_s):
        self.sliced_s = sliced_s
        self.features = FeatureTimes(0.5 * sliced_s, 0.2 * sliced_s, 0.1 * sliced_s, 0.0, 0.2 * sliced_s)


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
    return join_slices(task, decomposition, tasks, map(FakeSliceResult, seconds))
