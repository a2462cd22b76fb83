"""Status page: tasks for people, last night, jobs and printers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from rich.text import Text

from farm import api
from farm.cli.display.blocks import Block, fit_blocks
from farm.cli.display.console import ERROR_STYLE, HEADING_STYLE, NOTE_STYLE, URGENT_STYLE
from farm.cli.display.printers_table import compute_urgency_s, lay_out_printers
from farm.cli.display.table import wrap_text
from farm.model import JobState
from farm.text import format_count, format_duration, format_mass
from farm.wording import (
    format_planning,
    format_share,
    format_time,
    join_counted_names,
    parse_time,
    shorten_names,
)

_INDENT = 9  # columns of DO NOW, NIGHT and JOB
_TASK_GAP = "     "  # gap between two tasks on one line
_TASK_LABELS = {
    "look": "inspect",
    "replace": "replace agent",
    "connect": "connect",
    "reel": "filament",
    "approve": "approve",
}
_NAME_WIDTH = 32  # columns of a model's name
_OTHER_LINE_COUNT = 12  # number of lines of a short page, not counting the lines of printers
_PIPE_WIDTH = 200  # maximum columns of a line of joined texts, on a page without a maximum width


def render_status(view: api.StatusSummary, width: int | None = None, height: int | None = None) -> Text:
    """Lay out the status page.

    Parameters
    ----------
    view
        The farm.
    width
        Width of the terminal in columns; None for lines of any length.
    height
        Height of the terminal in lines; None for a page of any length.
    """
    lines = fit_blocks(_list_blocks(view, width, None), None)
    if height is not None and len(lines) > height:
        lines = fit_blocks(_list_blocks(view, width, height), height)
    return Text("\n").join(lines)


def _list_blocks(view: api.StatusSummary, width: int | None, height: int | None) -> list[Block]:
    """List the blocks of the page; with a `height`, list one line for each job, and urgent printers first."""
    now, is_brief = view.fleet.now, height is not None
    open_jobs = [job for job in view.jobs if not _is_finished(job)]
    ended_jobs = [job for job in view.jobs if _is_finished(job)]
    printers = view.printers
    if height is not None and len(printers) > height - _OTHER_LINE_COUNT:
        printers = sorted(printers, key=compute_urgency_s)
    headings, *table = lay_out_printers(printers, now, width)
    max_lines = 1 if is_brief else None  # lines of a job
    open_job_lines = [
        line for lines in _list_open_job_lines(open_jobs, now, width) for line in lines[:max_lines]
    ]
    ended_lines = [line for job in ended_jobs for line in _list_job_lines(job, now, width)[:max_lines]]
    night = [] if view.night is None else _lay_out_texts("NIGHT", [format_night(view.night)], "", width)
    cluster = [] if view.cluster is None else _lay_out_texts("COMPUTE", [view.cluster.text], "", width)
    return [
        Block(wrap_text(_format_title(view.fleet), width, _INDENT)),
        Block(_list_task_lines(view.todo, width), rank=1, min_lines=4),
        Block(night, rank=4, min_lines=1),
        Block(open_job_lines, rank=3, noun="job" if is_brief else "line", min_lines=4),
        Block(_list_wait_lines(view.waits, width), rank=5, min_lines=2),
        Block(cluster, rank=4, min_lines=1),
        Block([headings], rank=2, min_lines=1),
        Block(table, rank=2, noun="printer" if len(table) == len(printers) else "line", min_lines=8),
        Block(ended_lines, rank=6, noun="ended job" if is_brief else "line"),
    ]


def _is_finished(job: api.JobSummary) -> bool:
    """Return whether a job is finished; a printed job still waits for verdicts."""
    return JobState(job.state).ended and job.state != JobState.PRINTED


def _format_title(fleet: api.FleetView) -> Text:
    title = Text(f"{fleet.name}: {parse_time(fleet.now):%a %H:%M}", style=HEADING_STYLE)
    if fleet.time_scale != 1:
        title.append(f"  (simulated, {fleet.time_scale:g} times faster)", style=NOTE_STYLE)
    return title


def _list_task_lines(todo: list[api.Todo], width: int | None) -> list[Text]:
    """List all tasks for people on as few lines as possible."""
    other_tasks = [item for item in todo if item.code not in _TASK_LABELS]
    tasks = [
        f"clear {format_count(len(item.printers), 'bed')}: {item.brief or shorten_names(item.printers)}"
        if item.code == "clear"
        else item.text
        for item in sorted(other_tasks, key=lambda item: item.code == "clear")
    ]
    for code, label in _TASK_LABELS.items():
        briefs = _summarise_tasks(item for item in todo if item.code == code)
        line = f"{label}: {', '.join(briefs)}"
        fits = _INDENT + len(line) <= (width or _PIPE_WIDTH)
        tasks += [line] if briefs and fits else [f"{label}: {brief}" for brief in briefs]
    if not tasks:
        return _lay_out_texts("DO NOW", ["nothing"], "", width)
    return _lay_out_texts("DO NOW", tasks, _TASK_GAP, width, URGENT_STYLE)


def _summarise_tasks(items: Iterable[api.Todo]) -> list[str]:
    """Summarise the tasks; printers with the same problem, such as those on one USB hub, share a summary."""
    problems: dict[str, list[tuple[str, str]]] = {}  # by the text without the printer's name
    briefs: list[str] = []
    for item in items:
        brief, name = item.brief or item.text, "".join(item.printers[:1])
        if name and brief.startswith(f"{name}: "):
            problem = brief.removeprefix(f"{name}: ")
            problems.setdefault(problem.replace(name, "*"), []).append((name, problem))
        else:
            briefs.append(brief)
    return [
        f"{shorten_names(name for name, _ in group)}: {group[0][1]}" for group in problems.values()
    ] + briefs


def _lay_out_texts(
    label: str,
    texts: Sequence[str],
    separator: str,
    width: int | None,
    label_style: str = HEADING_STYLE,
    text_style: str = "",
) -> list[Text]:
    """Join texts into as few lines as possible, and wrap those that are longer than a line."""
    lines: list[str] = []
    for text in texts:
        if lines and _INDENT + len(lines[-1]) + len(separator) + len(text) <= (width or _PIPE_WIDTH):
            lines[-1] += separator + text
        else:
            lines.append(text)
    line_heads = [label, *[""] * len(lines)]
    return [
        line
        for line_head, text in zip(line_heads, lines, strict=False)
        for line in wrap_text(
            Text.assemble((line_head.ljust(_INDENT), label_style), (text.rstrip(), text_style)),
            width,
            _INDENT,
        )
    ]


def format_night(view: api.NightView) -> str:
    """Describe last night: the numbers of plates by outcome, and the filament that was used."""
    other_counts = {"failed": view.failed, "still printing": view.printing, "not started": view.waiting}
    counts = "".join(f", {count} {label}" for label, count in other_counts.items() if count)
    waste = f" + {format_mass(view.wasted_grams)} wasted" if view.wasted_grams >= 0.5 else ""
    plates = (
        f"{view.printed} of {format_count(view.plates, 'plate')} printed"
        if view.plates
        else "nothing printed"
    )
    return f"{plates}{counts}; {format_mass(view.grams)}{waste}"


def _list_open_job_lines(jobs: Sequence[api.JobSummary], now: str, width: int | None) -> Iterator[list[Text]]:
    """Yield the lines of each open job; queued jobs that wait for the same reason share their lines."""
    jobs_by_hold: dict[str, list[api.JobSummary]] = {}
    for job in jobs:
        if _waits_in_queue(job) and job.hold is not None:
            jobs_by_hold.setdefault(job.hold.text, []).append(job)
    for job in jobs:
        jobs_with_same_hold = (
            jobs_by_hold.get(job.hold.text, []) if _waits_in_queue(job) and job.hold is not None else []
        )
        if len(jobs_with_same_hold) < 2:
            yield _list_job_lines(job, now, width)
        elif job is jobs_with_same_hold[0]:
            numbers = shorten_names(str(held_job.id) for held_job in jobs_with_same_hold)
            names = join_counted_names(held_job.name[:_NAME_WIDTH] for held_job in jobs_with_same_hold)
            text = f"{numbers} ({names}): {_list_job_figures(job, now)[0]}"
            yield _lay_out_texts("JOBS", [text], "", width)


def _waits_in_queue(job: api.JobSummary) -> bool:
    return job.progress is None and not job.plate_count and job.hold is not None


def _list_job_lines(job: api.JobSummary, now: str, width: int | None) -> list[Text]:
    first, *more = _list_job_figures(job, now)
    submitter = f" by {job.submitted_by}" if job.submitted_by else ""
    figures = [f"{job.name[:_NAME_WIDTH]}{submitter}: {first}", *more]
    texts = [f"{figure};" for figure in figures[:-1]] + figures[-1:]
    label_style, text_style = (NOTE_STYLE, NOTE_STYLE) if _is_finished(job) else (HEADING_STYLE, "")
    lines = _lay_out_texts(f"JOB {job.id}", texts, " ", width, label_style, text_style)
    if job.reason and job.state in (JobState.FAILED, JobState.PRINTING):
        lines += _lay_out_texts("", [job.reason], "", width, text_style=ERROR_STYLE)
    return lines


def _list_wait_lines(waits: Iterable[api.Wait], width: int | None) -> list[Text]:
    """List the reasons for which plates wait, each with all plates that wait for this reason."""
    lines: list[Text] = []
    for wait in waits:
        text = f"{shorten_names(wait.names)}: {wait.hold.text}"
        lines += _lay_out_texts("" if lines else "WAIT", [text], "", width)
    return lines


def _list_job_figures(job: api.JobSummary, now: str) -> list[str]:
    """List the progress and the key figures of a job."""
    if job.progress is not None and not job.plate_count:
        return [format_planning(job.progress)]
    if not job.plate_count:
        return [f"{job.state}, waits: {job.hold.text}" if job.hold is not None else str(job.state)]
    figures = [
        f"printed {job.printed}/{job.plate_count}"
        + (f", good {job.good}/{job.printed}" if job.printed else "")
    ]
    if job.options.copies > 1:
        figures[0] += f", copies {job.printed_copies}/{job.options.copies}"
    if job.state not in (JobState.PRINTING, JobState.PRINTED):
        figures[0] = f"{job.state}, {figures[0]}"
    if job.paused:
        figures.append(f"paused, `farm resume {job.id}`")
    figures.append(f"expected {format_duration(job.expected_s)}")
    if job.elapsed_s is not None and job.current_s is not None:
        has_ended, current_text = JobState(job.state).ended, format_duration(job.current_s)
        if has_ended or current_text != format_duration(job.expected_s):
            figures[-1] += f", {'actual' if has_ended else 'now'} {current_text}"
    if job.state == JobState.PRINTING and job.eta:
        figures[-1] += f" (ends {format_time(job.eta, now)})"
    if job.speedup and job.utilisation and job.plate_count > 1:
        figures.append(f"single printer {format_duration(job.serial_s)}")
        figures.append(f"speed-up {job.speedup:.1f}, utilisation {format_share(job.utilisation)}")
    if job.wasted_s > 0:
        figures.append(f"wasted {format_duration(job.wasted_s)}, {format_mass(job.wasted_grams)}")
    if job.progress is not None:
        figures.append(f"replanning: {format_planning(job.progress)}")
    if job.hold is not None:
        figures.append(job.hold.text)
    return figures
