"""Drawing of a job's parts while they are sliced: picture, 3D view and instructions. Runs in a worker."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from decompose.export import draw_assembly, draw_parts, draw_steps, simplify_parts
from decompose.results import Decomposition
from farm.planning.error_translation import translate_errors
from farm.planning.parts.bed_places import find_beds, make_place_finder
from farm.planning.plan import DecomposeTask
from slicing.settings import find_resources

DRAWING_RECORD_FILE_NAME = "drawing-record.pickle"


def write_drawing_record(decomposition: Decomposition, folder: Path) -> Path:
    """Write the data of stored parts that `draw_job_parts` needs; return the file."""
    drawn_result = replace(decomposition, parts=simplify_parts(decomposition.parts))
    path = folder / DRAWING_RECORD_FILE_NAME
    path.write_bytes(pickle.dumps(drawn_result, protocol=pickle.HIGHEST_PROTOCOL))
    return path


def draw_overview(drawing_record: Path, out: Path) -> None:
    """Draw an exploded view of all parts as PNG; see `draw_job_parts`."""
    with translate_errors():
        draw_assembly(_read_record(drawing_record).parts, out)


def draw_step_range(drawing_record: Path, first: int, end: int, out: Path) -> None:
    """Draw a range of the steps of the assembly into a file; see `draw_job_parts`."""
    with translate_errors():
        pictures = draw_steps(_read_record(drawing_record), first, end)
    out.write_bytes(pickle.dumps(pictures, protocol=pickle.HIGHEST_PROTOCOL))


def draw_job_parts(
    task: DecomposeTask,
    drawing_record: Path,
    overview_file: Path | None = None,
    step_files: Sequence[Path] = (),
) -> None:
    """Draw a job's parts into the folder of its task.

    Parameters
    ----------
    drawing_record
        File written by `write_drawing_record` in a worker of this farm.
    overview_file
        File written by `draw_overview`; None to draw it.
    step_files
        Files written by `draw_step_range`, with all steps in order; empty to draw them.
    """
    pictures = [picture for path in step_files for picture in pickle.loads(path.read_bytes())]
    with translate_errors():
        beds = find_beds(task.printers, task.options.quality, find_resources())
        draw_parts(
            _read_record(drawing_record),
            task.folder,
            make_place_finder(beds),
            None if overview_file is None else overview_file.read_bytes(),
            pictures if step_files else None,
        )


def _read_record(path: Path) -> Decomposition:
    decomposition: Decomposition = pickle.loads(path.read_bytes())
    return decomposition
