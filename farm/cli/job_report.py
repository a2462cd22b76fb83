"""HTML report on a job, with pictures from files that this user can read."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

from farm import api
from farm.cli.client import Client
from farm.upkeep.part_pictures import draw_part
from farm.views.report import JobContents, list_figures, render_page
from farm.views.report.decomposition import parse_report

_MAX_PRINTS = 100_000
_MAX_STILLS_BYTES = 50_000_000  # maximum size of all stills on a page
FileFinder = Callable[[str], Path | None]
"""Function that returns a readable file for a path in a response of the daemon; None if no file is found."""


@dataclass(frozen=True, slots=True)
class Report:
    """HTML page on a job; `lacks_pictures` is True if the job has parts, but no picture could be read."""

    text: str
    lacks_pictures: bool


def find_local_file(path: str) -> Path | None:
    """Return a path on this host if this user may read its file; otherwise None."""
    return Path(path) if os.access(path, os.R_OK) else None


def render_report(client: Client, number: int, find_file: FileFinder) -> Report:
    """Render the page on a job.

    Parameters
    ----------
    client
        The daemon.
    number
        Number of the job.
    find_file
        Function that finds a readable file for a path in a response of the daemon.
    """
    view = client.fetch_job(number).job
    fleet = client.fetch_status().fleet
    now = datetime.fromisoformat(fleet.now).astimezone(ZoneInfo(fleet.timezone))
    part_by_files = {(part.file, part.picture): part for part in view.parts}  # copies of a part share both
    picture_by_files = {files: _load_picture(part, find_file) for files, part in part_by_files.items()}
    pictures = {
        part.id: png for part in view.parts if (png := picture_by_files[part.file, part.picture]) is not None
    }
    pictures |= _read_stills(view, find_file)
    assembly = find_file(f"{view.folder}/assembly.png") if view.folder else None
    report = find_file(f"{view.folder}/decomposition.json") if view.folder else None
    text = render_page(
        view,
        client.fetch_history(None, None, _MAX_PRINTS).prints,
        now,
        list_figures(view),
        JobContents(
            pictures,
            assembly.read_bytes() if assembly is not None and len(view.parts) > 1 else None,
            None if report is None else parse_report(report.read_bytes()),
        ),
    )
    return Report(text, bool(view.parts) and not pictures and assembly is None)


def _load_picture(part: api.PartView, find_file: FileFinder) -> bytes | None:
    """Draw a part, or read its stored picture; return None if neither file can be read."""
    if part.file is not None:
        model = find_file(part.file)
        return None if model is None else draw_part(model)
    picture = None if part.picture is None else find_file(part.picture)
    return None if picture is None else picture.read_bytes()


def _read_stills(view: api.JobView, find_file: FileFinder) -> dict[str, bytes]:
    """Read the stills of a job's prints by their paths, up to a total size."""
    stills: dict[str, bytes] = {}
    remaining_bytes = _MAX_STILLS_BYTES
    for path in [still.file for attempt in view.prints for still in attempt.stills if still.file is not None]:
        local_file = find_file(path)
        if local_file is not None and (remaining_bytes := remaining_bytes - local_file.stat().st_size) >= 0:
            stills[path] = local_file.read_bytes()
    return stills
