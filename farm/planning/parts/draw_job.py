"""Drawing of a job's parts: picture, 3D view and instructions, beside their slicing. Runs in a worker."""

from __future__ import annotations

import pickle
from pathlib import Path

from decompose.export import draw_parts
from decompose.results import Decomposition
from farm.planning.error_translation import translate_errors
from farm.planning.parts.bed_places import find_beds, place_on
from farm.planning.plan import DecomposeTask
from slicing.settings import find_resources

DRAWING_RECORD = "drawing-record.pickle"


def write_drawing_record(stored: Decomposition, folder: Path) -> Path:
    """Write what `draw_job` needs of parts that are stored. Returns the file."""
    path = folder / DRAWING_RECORD
    path.write_bytes(pickle.dumps(stored, protocol=pickle.HIGHEST_PROTOCOL))
    return path


def draw_job(task: DecomposeTask, drawing_record: Path) -> None:
    """Draw a job's parts into the folder of its task.

    Parameters
    ----------
    drawing_record
        File of `write_drawing_record`, by a worker of this farm.
    """
    stored: Decomposition = pickle.loads(drawing_record.read_bytes())
    with translate_errors():
        beds = find_beds(task.printers, task.options.quality, find_resources())
        draw_parts(stored, task.folder, place_on(beds))
