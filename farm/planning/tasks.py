"""Planning functions that run in worker processes.

The modules of these functions load numpy, so only the workers import them.

A function can also run on another computer if a `list_*_files` function below lists its files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from farm.compute import DeferredFunction, TaskFiles
from farm.planning.decompose_progress import PROGRESS_FILE_NAME

if TYPE_CHECKING:
    from farm.planning.part_records import SliceTask
    from farm.planning.plan import DecomposeTask, SlicedJob
    from farm.planning.replanning.replan import ReplanTask


def list_decompose_files(task: DecomposeTask) -> TaskFiles:
    """List the files of `decompose_job`: the model, and the plan's folder with the progress file."""
    return TaskFiles(
        input_files=(task.model,),
        output_folders=(task.folder,),
        live_files=(task.folder / PROGRESS_FILE_NAME,),
    )


def list_attempt_files(task: DecomposeTask, record: Path, _number: int, folder: Path) -> TaskFiles:
    """List the files of `make_attempt`: the model, the record of the search, the folder of the attempt."""
    return TaskFiles(
        input_files=(task.model, record), output_folders=(folder,), live_files=(folder / PROGRESS_FILE_NAME,)
    )


def list_continue_files(
    task: DecomposeTask, record: Path, outcomes: Sequence[Path | str], _end_reason: str | None = None
) -> TaskFiles:
    """List the files of `continue_job`: those of `decompose_job`, the record, the outcomes of the round."""
    input_files = (task.model, record, *(file for file in outcomes if isinstance(file, Path)))
    return TaskFiles(
        input_files=input_files, output_folders=(task.folder,), live_files=(task.folder / PROGRESS_FILE_NAME,)
    )


def list_overview_files(drawing_record: Path, out: Path) -> TaskFiles:
    """List the files of `draw_overview`: the record of the parts, and the picture."""
    return TaskFiles(input_files=(drawing_record,), output_files=(out,))


def list_step_range_files(drawing_record: Path, _first: int, _end: int, out: Path) -> TaskFiles:
    """List the files of `draw_step_range`: the record of the parts, and the pictures."""
    return TaskFiles(input_files=(drawing_record,), output_files=(out,))


def list_draw_files(
    task: DecomposeTask,
    drawing_record: Path,
    overview_file: Path | None = None,
    step_files: Sequence[Path] = (),
) -> TaskFiles:
    """List the files of `draw_job_parts`: the record of the parts, earlier pictures and the plan's folder."""
    pictures = step_files if overview_file is None else (overview_file, *step_files)
    return TaskFiles(input_files=(drawing_record, *pictures), output_folders=(task.folder,))


def list_rebalance_files(rounds: Sequence[SlicedJob], folder: Path) -> TaskFiles:
    """List the files of `rebalance_parts`: the model, the cuts, and the folder of the new parts."""
    records = [sliced_job.decomposed_job.cut_record for sliced_job in rounds]
    input_files = (rounds[0].task.model, *(record for record in records if record is not None))
    return TaskFiles(input_files=input_files, output_folders=(folder,))


def list_slice_files(task: SliceTask) -> TaskFiles:
    """List the files of `slice_part`: the part, its G-code, and the cache of slices."""
    caches = () if task.cache is None else (task.cache,)
    return TaskFiles(input_files=(task.stl,), output_files=(task.out,), cache_folders=caches)


def list_cut_files(task: ReplanTask) -> TaskFiles:
    """List the files of `cut_part`: all parts of one copy to print, the reports, and the pieces' folder."""
    names = (*(part.file for part in (task.part, *task.other_parts)), *task.reports)
    return TaskFiles(input_files=tuple(task.files / name for name in names), output_folders=(task.folder,))


if TYPE_CHECKING:
    from farm.planning.inspection.inspect_submission import inspect_submission
    from farm.planning.inspection.own_gcode import plan_gcode
    from farm.planning.parts.decompose_job import decompose_job, warm_up_planning
    from farm.planning.parts.job_drawing import draw_job_parts, draw_overview, draw_step_range
    from farm.planning.parts.paused_decomposition import continue_job, make_attempt
    from farm.planning.parts.rebalance_parts import rebalance_parts
    from farm.planning.parts.slice_part import slice_part
    from farm.planning.replanning.cut_part import cut_part
else:
    inspect_submission = DeferredFunction("farm.planning.inspection.inspect_submission:inspect_submission")
    continue_job = DeferredFunction(
        "farm.planning.parts.paused_decomposition:continue_job", list_continue_files
    )
    decompose_job = DeferredFunction("farm.planning.parts.decompose_job:decompose_job", list_decompose_files)
    draw_job_parts = DeferredFunction("farm.planning.parts.job_drawing:draw_job_parts", list_draw_files)
    draw_overview = DeferredFunction("farm.planning.parts.job_drawing:draw_overview", list_overview_files)
    draw_step_range = DeferredFunction(
        "farm.planning.parts.job_drawing:draw_step_range", list_step_range_files
    )
    rebalance_parts = DeferredFunction(
        "farm.planning.parts.rebalance_parts:rebalance_parts", list_rebalance_files
    )
    warm_up_planning = DeferredFunction("farm.planning.parts.decompose_job:warm_up_planning")
    plan_gcode = DeferredFunction("farm.planning.inspection.own_gcode:plan_gcode")
    make_attempt = DeferredFunction(
        "farm.planning.parts.paused_decomposition:make_attempt", list_attempt_files
    )
    slice_part = DeferredFunction("farm.planning.parts.slice_part:slice_part", list_slice_files)
    cut_part = DeferredFunction("farm.planning.replanning.cut_part:cut_part", list_cut_files)

__all__ = [
    "continue_job",
    "cut_part",
    "decompose_job",
    "draw_job_parts",
    "draw_overview",
    "draw_step_range",
    "inspect_submission",
    "make_attempt",
    "plan_gcode",
    "rebalance_parts",
    "slice_part",
    "warm_up_planning",
]
