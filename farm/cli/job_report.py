"""HTML report of a job, with pictures from files that the caller can read."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from farm import api
from farm.cli.client import Client
from farm.cli.display import format_copies, format_runs, format_share, format_time, parse_time
from farm.text import format_duration, format_mass
from farm.upkeep.part_pictures import draw_part
from farm.views.report import render_page

_ALL = 100_000
_STILLS_BYTES = 50_000_000  # of all stills on a page
FindFile = Callable[[str], Path | None]
"""Returns a readable file for a path in the daemon's answer; None if there is none."""


@dataclass(frozen=True, slots=True)
class Report:
    """Page on a job; `without_pictures` if no file of it can be read."""

    text: str
    without_pictures: bool


def find_local(path: str) -> Path | None:
    """Return a file of this host, if this user may read it."""
    return Path(path) if os.access(path, os.R_OK) else None


def render_report(client: Client, number: int, find_file: FindFile) -> Report:
    """Render the page on a job.

    Parameters
    ----------
    client
        The daemon.
    number
        The job.
    find_file
        Finds the files that the daemon names.
    """
    view = client.job(number).job
    now = datetime.fromisoformat(client.status().fleet.now)
    part_by_files = {(part.file, part.picture): part for part in view.parts}  # copies of a part share both
    picture_by_files = {files: _find_picture(part, find_file) for files, part in part_by_files.items()}
    pictures = {
        part.id: png for part in view.parts if (png := picture_by_files[part.file, part.picture]) is not None
    }
    pictures |= _read_stills(view, find_file)
    assembly = find_file(f"{view.folder}/assembly.png") if view.folder else None
    text = render_page(
        view,
        client.history(None, None, _ALL).prints,
        now,
        list_figures(view),
        pictures,
        assembly.read_bytes() if assembly is not None and len(view.parts) > 1 else None,
    )
    return Report(text, bool(view.parts) and not pictures and assembly is None)


def _find_picture(part: api.PartView, find_file: FindFile) -> bytes | None:
    """Draw a part, or read the picture that was kept of it; None if neither can be read."""
    if part.file is not None:
        model = find_file(part.file)
        return None if model is None else draw_part(model)
    picture = None if part.picture is None else find_file(part.picture)
    return None if picture is None else picture.read_bytes()


def _read_stills(view: api.JobView, find_file: FindFile) -> dict[str, bytes]:
    """Read the stills of a job's prints by their paths, the first ones of too many."""
    stills: dict[str, bytes] = {}
    left_bytes = _STILLS_BYTES
    for path in [still.file for one in view.prints for still in one.stills if still.file is not None]:
        found = find_file(path)
        if found is not None and (left_bytes := left_bytes - found.stat().st_size) >= 0:
            stills[path] = found.read_bytes()
    return stills


def list_figures(view: api.JobView) -> list[tuple[str, str]]:
    """List the figures of a job, each with its name."""
    actual = "actual" if view.state in ("printed", "done") else "as known now"
    rows = [
        (
            "submitted",
            f"{parse_time(view.submitted):%a %d %b %Y %H:%M}"
            + (f" by {view.submitted_by}" if view.submitted_by else ""),
        ),
        ("plates printed", f"{view.printed} of {len(view.plates)}; good {view.good}"),
        ("parallel printing time, expected", format_duration(view.estimated_s)),
        (f"parallel printing time, {actual}", format_duration(view.current_s)),
        ("single large printer", format_duration(view.serial_s)),
        ("speed-up", f"{view.speedup:.1f}" if view.speedup else "-"),
        ("utilisation", format_share(view.utilisation) if view.utilisation else "-"),
        (
            "wasted",
            f"{format_duration(view.wasted_s)}, {format_mass(view.wasted_grams)}"
            if view.wasted_s
            else "nothing",
        ),
        ("filament", format_mass(view.grams) if view.grams is not None else "-"),
    ]
    if view.options.note:
        rows.insert(1, ("note", view.options.note))
    if view.options.copies > 1:
        rows.insert(1, ("copies printed", format_copies(view)))
    if len(view.runs) > 1:
        rows.append(
            ("printed in runs", f"{format_runs(view.runs, view.now)}; the time between them is not counted")
        )
    if view.pruned is not None:
        rows.append(("files", f"pruned on {format_time(view.pruned, view.now)}"))
    if view.price is not None:
        rows.append(("price of the filament", f"{view.price:.2f} {view.currency or ''}".strip()))
    return rows
