"""Files of the tasks that can run on a computer without a shared disk, from their arguments. Pure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from farm.compute import TaskFiles
from farm.planning.decompose_progress import PROGRESS

if TYPE_CHECKING:
    from farm.planning.part_records import SliceTask
    from farm.planning.plan import DecomposeTask, SlicedJob
    from farm.planning.replanning.replan import ReplanTask


def list_decompose_files(task: DecomposeTask) -> TaskFiles:
    """List the files of `decompose_job`: the model, the folder of the plan with its progress."""
    return TaskFiles(reads=(task.model,), folders=(task.folder,), live=(task.folder / PROGRESS,))


def list_relevel_files(sliced: SlicedJob, folder: Path) -> TaskFiles:
    """List the files of `relevel_parts`: the model and the cuts, the folder of the new parts."""
    record = sliced.decomposed.cut_record
    reads = (sliced.task.model,) if record is None else (sliced.task.model, record)
    return TaskFiles(reads=reads, folders=(folder,))


def list_slice_files(task: SliceTask) -> TaskFiles:
    """List the files of `slice_part`: the part, its G-code, and the cache of slices."""
    caches = () if task.cache is None else (task.cache,)
    return TaskFiles(reads=(task.stl,), writes=(task.out,), caches=caches)


def list_cut_files(task: ReplanTask) -> TaskFiles:
    """List the files of `cut_part`: all parts of the job's copy, the folder of the pieces."""
    parts = (task.part, *task.others)
    return TaskFiles(reads=tuple(task.files / part.file for part in parts), folders=(task.folder,))
