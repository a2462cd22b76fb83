"""Report of a job as one HTML page: figures, Gantt chart of the fleet, failures with reasons, parts.

The page is a single file with embedded pictures, which loads no other file. The templates escape all text.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache

from jinja2 import Environment
from markupsafe import Markup

from farm import api
from farm.model import PrintState
from farm.templates import load_environment
from farm.text import format_duration
from farm.views.charts import lay_out_gantt, list_bars, load_palette, name_outcome
from farm.views.report.decomposition import Report

# Characters in the texts of marks, and the signs that appear on the parts instead.
_SIGNS = str.maketrans({"^": "", ".": "●"})
_JPEG_PREFIX = b"\xff\xd8"


@dataclass(frozen=True, slots=True)
class JobContents:
    """Contents of a job's files; the page leaves out those that are missing.

    Attributes
    ----------
    pictures
        PNG of each part by part id, and stills (PNG or JPEG) by the path of their file.
    assembly_picture
        PNG of all parts in an exploded view; None if there is none.
    decomposition
        Joints, steps and marks; None if unknown.
    """

    pictures: Mapping[str, bytes] = field(default_factory=dict)
    assembly_picture: bytes | None = None
    decomposition: Report | None = None


@dataclass(frozen=True, slots=True)
class _PartEntry:
    """Entry of a part on the page; `picture` is a data URL."""

    part: api.PartView
    plate: api.PlateStatus
    outcome: str
    times: str
    picture: str | None


@cache
def load_templates() -> Environment:
    """Load the templates of this package; later calls return the same object."""
    return load_environment("farm.views.report")


def render_page(
    job: api.JobView,
    history: Sequence[api.HistoryRow],
    now: datetime,
    figures: Sequence[tuple[str, str]],
    contents: JobContents,
) -> str:
    """Render the report of a job as HTML.

    Parameters
    ----------
    job
        The job.
    history
        Ended prints of all jobs, for the chart.
    now
        Farm time in the farm's time zone; the bars of open prints end there.
    figures
        Names and texts of the job's figures.
    contents
        Pictures, and the steps of the assembly.
    """
    pictures, assembly_picture, decomposition = (
        contents.pictures,
        contents.assembly_picture,
        contents.decomposition,
    )
    template = load_templates().get_template("report.html")
    page = template.render(
        title=f"Job {job.id}: {job.name}, {job.state}",
        job=job,
        figures=figures,
        zone=str(now.tzinfo),
        palette=Markup(load_palette()),
        gantt=lay_out_gantt(list_bars(job, history, now)),
        failures=_list_failures(job),
        stills=_list_stills(job, pictures),
        parts=[_describe_part(part, job, pictures.get(part.id)) for part in job.parts_in_gluing_order],
        assembly=None if assembly_picture is None else _make_data_url(assembly_picture),
        decomposition=decomposition or Report(),
        steps=[] if decomposition is None else _lay_out_steps(decomposition),
    )
    return page + "\n"


def _lay_out_steps(report: Report) -> list[tuple[str, ...]]:
    """List the headings, and the cells of each step of the assembly, without columns that are empty."""
    rows = [
        ("step", "glue", "onto", "marks on the faces", "pins, mm", "seam, mm"),
        *_list_steps(report),
    ]
    if len(rows) == 1:
        return []
    columns = [column for column in zip(*rows, strict=True) if any(column[1:])]
    return list(zip(*columns, strict=True))


def _list_steps(report: Report) -> list[tuple[str, ...]]:
    """List the number, moved and fixed body, marks, pins and seam length of each step of the assembly."""
    return [
        (
            str(step.number),
            ", ".join(step.moved),
            ", ".join(step.fixed),
            ", ".join(dict.fromkeys(code.text.translate(_SIGNS) for code in step.codes)),
            ", ".join(pin.size for pin in report.list_pins(step)),
            f"{step.seam_mm:,.0f}",
        )
        for step in report.assembly.steps
    ]


def _list_failures(job: api.JobView) -> list[tuple[str, ...]]:
    """List the part, printer, end, outcome and reason of failed, bad and cancelled prints, sorted by end."""
    failures = [
        (attempt.ended or "", attempt, outcome)
        for attempt in job.prints
        if (outcome := name_outcome(attempt.state, attempt.verdict)) in ("failed", "bad", "cancelled")
    ]
    return [
        (
            attempt.part,
            attempt.printer,
            datetime.fromisoformat(ended_at).strftime("%a %d %b %H:%M") if ended_at else "",
            outcome,
            attempt.reason or attempt.why or attempt.fault or "",
        )
        for ended_at, attempt, outcome in sorted(failures, key=lambda failure: failure[0])
    ]


def _list_stills(job: api.JobView, pictures: Mapping[str, bytes]) -> list[tuple[str, str, str, str]]:
    """List the stills of all prints in order of time: part and printer, moment, time, and picture."""
    stills = [
        (still.taken, attempt, still.moment, pictures[still.file])
        for attempt in job.prints
        for still in attempt.stills
        if still.file is not None and still.file in pictures
    ]
    return [
        (
            f"{attempt.part} on {attempt.printer}",
            moment.replace("_", " "),
            datetime.fromisoformat(taken_at).strftime("%a %d %b %H:%M"),
            _make_data_url(picture),
        )
        for taken_at, attempt, moment, picture in sorted(stills, key=lambda still: still[0])
    ]


def _describe_part(part: api.PartView, job: api.JobView, picture: bytes | None) -> _PartEntry:
    plate = next(plate for plate in job.plates if plate.id == part.plate)
    prints = part.own_prints
    outcome = name_outcome(prints[-1].state, prints[-1].verdict) if prints else "waiting"
    return _PartEntry(
        part=part,
        plate=plate,
        outcome=f"{outcome}, {len(prints)} prints" if len(prints) > 1 else outcome,
        times=_format_times(prints[-1] if prints else None, plate.expected_s),
        picture=_make_data_url(picture) if picture else None,
    )


def _format_times(last_print: api.PrintView | None, expected_s: float) -> str:
    """Format the expected printing time of a part, and the actual one if its last print is done."""
    if (
        last_print is None
        or last_print.state is not PrintState.DONE
        or not (last_print.started and last_print.ended)
    ):
        return f"expected {format_duration(expected_s)}"
    actual = datetime.fromisoformat(last_print.ended) - datetime.fromisoformat(last_print.started)
    return f"{format_duration(actual.total_seconds())}, expected {format_duration(expected_s)}"


def _make_data_url(picture: bytes) -> str:
    kind = "jpeg" if picture.startswith(_JPEG_PREFIX) else "png"
    return f"data:image/{kind};base64,{b64encode(picture).decode()}"
