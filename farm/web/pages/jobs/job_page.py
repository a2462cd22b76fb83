"""Page of one job, with its next step, parts, timeline, assembly and files. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

from markupsafe import Markup

from farm import api
from farm.model import HoldCode, Job, JobState, PlanProgress, PlanStep, Plate, TextTime
from farm.text import format_count, format_duration, format_mass
from farm.views.charts import Gantt, lay_out_gantt, list_bars, list_expected_bars
from farm.views.report import list_figures
from farm.views.report.decomposition import Report
from farm.web.notes import Note, User
from farm.web.pages.jobs.actions import can_report_assembly, list_job_actions
from farm.web.pages.jobs.curve import TimeCurve, lay_out_time_curve
from farm.web.pages.jobs.parts import list_part_rows
from farm.web.pages.rendering import FleetInfo, render_page
from farm.web.pages.sentences import Sentence, format_sentence, format_time_element
from farm.wording import format_planning, format_time, group_holds, shorten_names

_FILE_LABELS = {
    "assembly.png": "picture of the parts",
    "assembly.glb": "3D model of the parts",
    "decomposition.json": "report of the decomposition",
    "instructions.html": "instructions for gluing",
}
_MODEL_FILE = "assembly.glb"
_PICTURE_FILE = "assembly.png"
_PLATE_FIGURES = ("plates printed", "wasted")
"""Figures that are meaningless for a job without plates."""


@dataclass(frozen=True, slots=True)
class JobData:
    """Data that the page of a job shows.

    Attributes
    ----------
    job
        The job.
    printers
        All printers of the fleet.
    history
        Prints of the fleet that have ended, for the timeline.
    timeline
        Actual and expected times of the job's plates; None before it is planned and after it has ended.
    report
        Report on the decomposition: joints, assembly and time curve.
    files
        Names of the job's files.
    time_curve_job
        Number of the job whose report has the time curve; None for this job.
    gcode_figures
        Names and values of the figures of a person's own G-code.
    """

    job: api.JobView
    printers: Sequence[api.PrinterView] = ()
    history: Sequence[api.HistoryRow] = ()
    timeline: api.Timeline | None = None
    report: Report = field(default_factory=Report)
    files: Sequence[str] = ()
    time_curve_job: int | None = None
    gcode_figures: Sequence[tuple[str, str]] = ()


def render_job_page(data: JobData, fleet: FleetInfo, user: User, note: Note | None = None) -> str:
    """Render the page.

    Parameters
    ----------
    data
        The job, and what the page shows beside it.
    fleet, user, note
        See `render_page`.
    """
    job, timeline = data.job, data.timeline
    now = datetime.fromisoformat(job.now)
    # a plate that is printed again has several slots, of which the last one counts
    slots = {} if timeline is None else {slot.plate: slot for slot in timeline.slots}
    return render_page(
        "job.html",
        fleet,
        f"/jobs/{job.id}",
        user,
        note,
        job=job,
        summary=summarise_job(job, timeline),
        share=None if job.progress is None else estimate_completed_share(job.progress),
        is_planning=job.state in (JobState.QUEUED, JobState.PLANNING),
        actions=list_job_actions(job, user.role),
        rows=list_part_rows(job, data.printers, slots, user.role),
        reasons=list_wait_reasons(job, timeline),
        changes=list_model_changes(job),
        gantt=lay_out_job_gantt(data, now),
        time_curve=lay_out_job_time_curve(data, now) if job.options.dry_run else None,
        time_curve_job=data.time_curve_job or job.id,
        figures=[*data.gcode_figures, *_list_figures(job)],
        can_report_assembly=can_report_assembly(job, user.role),
        report=data.report,
        model=_MODEL_FILE if _MODEL_FILE in data.files else None,
        picture=_PICTURE_FILE if _PICTURE_FILE in data.files else None,
        downloads=group_downloads(data.files),
        has_instructions="instructions.html" in data.files,
    )


def summarise_job(job: api.JobView, timeline: api.Timeline | None) -> str:
    """Summarise the progress and the next step of a job in one or two sentences."""
    if job.progress is not None and job.state != JobState.PRINTING:
        return f"{format_planning(job.progress).capitalize()}."
    if job.state == JobState.QUEUED:
        hold = "" if job.hold is None else Markup(": {}").format(format_sentence(job.hold))
        return Markup("It waits to be planned{}.").format(hold)
    if job.state == JobState.PLANNING:
        return "It is being planned."
    if job.state == JobState.HELD:
        return f"{_describe_plan(job, timeline)} Nothing prints before it is approved."
    if job.state == JobState.PRINTING:
        progress = f"{job.printed} of {format_count(len(job.plates), 'part')} printed"
        end_text = "" if job.eta is None else _format_end(job.eta, job.now)
        return Markup("{}{}{}.").format("Paused: " if job.paused else "", progress, end_text)
    if job.state == JobState.PRINTED:
        return "Every part is printed: take the parts off and report which are good."
    if job.state == JobState.DONE:
        return "Every part is printed and good."
    if job.state == JobState.CANCELLED:
        return f"It was cancelled: {job.reason or '-'}."
    advice = "" if job.plates else " Correct that, then submit it again."
    return f"It has failed: {job.reason or '-'}.{advice}"


def _describe_plan(job: api.JobView, timeline: api.Timeline | None) -> str:
    printers = len({plate.printer for plate in job.plates})
    figures = [
        f"{format_count(len(job.parts), 'part')} on {format_count(printers, 'printer')}",
        format_duration(job.expected_s if timeline is None else timeline.makespan_s),
    ]
    if job.grams is not None:
        figures.append(format_mass(job.grams))
    if job.price is not None:
        figures.append(f"{job.price:.2f} {job.currency or ''}".strip())
    return f"Planned: {', '.join(figures)}."


def _format_end(end: str, now: str) -> Markup:
    remaining_s = (datetime.fromisoformat(end) - datetime.fromisoformat(now)).total_seconds()
    end_element = format_time_element(end, now)
    return Markup(", ends {}, in {}").format(end_element, format_duration(max(0.0, remaining_s)))


def _list_figures(job: api.JobView) -> Iterator[tuple[str, str]]:
    """Yield the names and values of the known figures of a job, with times as `<time>`."""
    times_at = [at for run in job.runs for at in (run.started, run.ended)] + [job.pruned]
    times = [TextTime(text=format_time(at, job.now), at=at) for at in times_at if at is not None]
    for name, text in list_figures(job):
        if name == "submitted":
            submitter = f" by {job.submitted_by}" if job.submitted_by else ""
            yield name, Markup("{}{}").format(format_time_element(job.submitted, job.now), submitter)
        elif text != "-" and (job.plates or name not in _PLATE_FIGURES):
            yield name, format_sentence(Sentence(text, times))


def estimate_completed_share(progress: PlanProgress) -> float | None:
    """Estimate the completed share of the current planning step, from 0 to 1; return None if unknown."""
    if progress.step is PlanStep.SLICING and progress.of:
        return progress.done / progress.of
    return progress.share if progress.step is PlanStep.DECOMPOSING else None


def list_wait_reasons(job: api.JobView, timeline: api.Timeline | None = None) -> list[Sentence]:
    """List the reasons why a job or its plates wait, each once, without the reason that the summary gives."""
    reasons = []
    if timeline is not None and timeline.left:
        reasons.append(Sentence(f"no printer can print {shorten_names(timeline.left)}"))
    if job.hold is not None and job.state != JobState.QUEUED and job.hold.code is not HoldCode.APPROVAL:
        reasons.append(Sentence(job.hold.text, job.hold.times))
    known_texts = {reason.text for reason in reasons}
    for hold, names in group_holds([job]):
        if hold.text not in known_texts:
            reasons.append(Sentence(f"{shorten_names(names)}: {hold.text}", hold.times))
    return reasons


def list_gcode_figures(job: Job, plates: Iterable[Plate]) -> list[tuple[str, str]]:
    """List size, layers and time of a person's own G-code; the list is empty for a model."""
    if job.own_gcode is None:
        return []
    low_mm, high_mm = job.own_gcode.min_mm, job.own_gcode.max_mm
    size = " × ".join(f"{high - low:.0f}" for low, high in zip(low_mm, high_mm, strict=True))
    figures = [("size", f"{size} mm")]
    plate = next(iter(plates), None)  # own G-code has one plate
    if plate is not None:
        figures += [("layers", str(plate.layers)), ("time of the moves", format_duration(plate.sliced_s))]
    return figures


def list_model_changes(job: api.JobView) -> list[str]:
    """List the changes that the farm made to the model."""
    scale_notes = [f"Scaled by {job.scale:g}."] if job.scale is not None and job.scale != 1 else []
    return [*job.repairs, *scale_notes]


def lay_out_job_gantt(data: JobData, now: datetime) -> Gantt | None:
    """Lay out a Gantt chart of a job's prints, other jobs' prints at the same time, and planned prints."""
    slots = () if data.timeline is None else data.timeline.slots
    return lay_out_gantt([*list_bars(data.job, data.history, now), *list_expected_bars(slots, now)])


def lay_out_job_time_curve(data: JobData, now: datetime) -> TimeCurve | None:
    """Lay out the time curve of a plan; for each number of printers, printing starts at the same time."""
    timeline = data.timeline
    if timeline is None:
        return None
    start = min((datetime.fromisoformat(slot.starts) for slot in timeline.slots), default=now)
    return lay_out_time_curve(
        data.report.curve, len({plate.printer for plate in data.job.plates}), start, now
    )


def group_downloads(files: Sequence[str]) -> Mapping[str, list[tuple[str, str]]]:
    """Group the files of a job under titles; each file has its name and a label."""
    groups: dict[str, list[tuple[str, str]]] = {"Model": [], "Parts (STL)": [], "G-code": [], "Pictures": []}
    for name in files:
        if name in _FILE_LABELS:
            groups["Model"].append((name, _FILE_LABELS[name]))
        elif name.endswith(".stl"):
            groups["Parts (STL)"].append((name, name))
        elif name.endswith(".gcode"):
            groups["G-code"].append((name, name))
        elif name.endswith((".png", ".jpg", ".jpeg")):
            groups["Pictures"].append((name, name))
        else:
            groups["Model"].append((name, name))
    return {title: rows for title, rows in groups.items() if rows}
