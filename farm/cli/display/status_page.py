"""Status page: the tasks of people, the last night, the jobs, the printers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime, timedelta

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from farm import api
from farm.cli.display.console import ERROR, HEADING, NOTE, URGENT, make_table
from farm.cli.display.format import format_deviation, format_planning, format_share, format_time
from farm.model import Bed, HoldCode, JobState, Link, PrintState
from farm.text import format_count, format_duration, format_mass

_INDENT = 9  # columns of DO NOW, NIGHT and JOB
_TASK_GAP = "     "  # between two tasks on one line
_TASK_LABELS = {
    "look": "inspect",
    "replace": "replace agent",
    "connect": "connect",
    "reel": "filament",
    "approve": "approve",
}
_HEADINGS = ("PRINTER", "STATE", "PART", "ENDS", "VS PLAN", "FACTOR", "REEL", "NOZZLE", "BED", "ACTION")
_STATES = {"look": "inspect"}
"""States that the table words differently from `--json`."""
_NAME_WIDTH = 32  # columns of a model's name
_SAME_NIGHT = timedelta(hours=20)
"""Age up to which a time is shown without its weekday."""


def shorten_names(printers: Iterable[str]) -> str:
    """List names with consecutive numbers as ranges: um2-01..12 um2x-01."""
    runs: list[tuple[str, str, str]] = []  # common stem, first number, last number
    for name in sorted(printers, key=lambda name: (name.rstrip("0123456789"), len(name), name)):
        match = re.fullmatch(r"(.*?)(\d+)", name)
        stem, digits = match.groups() if match else (name, "")
        if digits and runs and runs[-1][0] == stem and int(digits) == int(runs[-1][2] or -2) + 1:
            runs[-1] = (stem, runs[-1][1], digits)
        else:
            runs.append((stem, digits, digits))
    return " ".join(stem + first + (f"..{last}" if last != first else "") for stem, first, last in runs)


def render_status(view: api.Status, width: int) -> RenderableType:
    """Lay out the status page on lines of `width` columns, if the texts are short enough."""
    now = Text(f"{view.fleet.name}: {format_time(view.fleet.now)}", style=HEADING)
    if view.fleet.time_scale != 1:
        now.append(f"  (simulated, {view.fleet.time_scale:g} times faster)", style=NOTE)
    rows: list[RenderableType] = [now, *_list_task_lines(view.todo, width)]
    if view.night is not None:
        rows.append(_format_line("NIGHT", format_night(view.night)))
    for job in view.jobs:
        rows += _list_job_lines(job, width)
    return Group(*rows, _make_printers_table(view.printers, datetime.fromisoformat(view.fleet.now)))


def _format_line(head: str, text: str, style: str = HEADING) -> Text:
    return Text.assemble((head.ljust(_INDENT), style), text)


def _list_task_lines(todo: list[api.Todo], width: int) -> list[Text]:
    """List all tasks of people, on as few lines as possible."""
    others = [item for item in todo if item.code not in _TASK_LABELS]
    tasks = [
        f"clear {format_count(len(item.printers), 'bed')}: {shorten_names(item.printers)}"
        if item.code == "clear"
        else item.text
        for item in sorted(others, key=lambda item: item.code == "clear")
    ]
    for code, label in _TASK_LABELS.items():
        briefs = [item.brief or item.text for item in todo if item.code == code]
        if briefs:
            tasks.append(f"{label}: {', '.join(briefs)}")
    return _fold_texts("DO NOW", tasks or ["nothing"], _TASK_GAP, width, URGENT)


def _fold_texts(head: str, texts: list[str], gap: str, width: int, style: str = HEADING) -> list[Text]:
    """Put texts side by side on as few lines as possible."""
    lines: list[str] = []
    for text in texts:
        if lines and _INDENT + len(lines[-1]) + len(gap) + len(text) <= width:
            lines[-1] += gap + text
        else:
            lines.append(text)
    heads = [head, *[""] * len(lines)]
    return [_format_line(one, text.rstrip(), style) for one, text in zip(heads, lines, strict=False)]


def format_night(view: api.NightView) -> str:
    """Format the counts of the last night."""
    rest = {"failed": view.failed, "still printing": view.printing, "not started": view.waiting}
    counts = "".join(f", {count} {words}" for words, count in rest.items() if count)
    waste = f" + {format_mass(view.wasted_grams)} wasted" if view.wasted_grams >= 0.5 else ""
    plates = (
        f"{view.printed} of {format_count(view.plates, 'plate')} printed"
        if view.plates
        else "nothing printed"
    )
    return f"{plates}{counts}; {format_mass(view.grams)}{waste}"


def _list_job_lines(job: api.JobView, width: int) -> list[Text]:
    first, *more = _list_job_facts(job)
    facts = [f"{job.name[:_NAME_WIDTH]}: {first}", *more]
    texts = [f"{fact};" for fact in facts[:-1]] + facts[-1:]
    lines = _fold_texts(f"JOB {job.id}", texts, " ", width)
    if job.reason and job.state in (JobState.FAILED, JobState.PRINTING):
        lines.append(_format_line("", job.reason, ERROR))
    waiting: dict[str, list[str]] = {}
    for plate in job.plates:
        if plate.hold is not None:
            waiting.setdefault(plate.hold.text, []).append(plate.id)
    for text, plates in waiting.items():
        lines.append(
            _format_line("", f"{shorten_names(plates)} {'waits' if len(plates) == 1 else 'wait'}: {text}")
        )
    return lines


def _list_job_facts(job: api.JobView) -> list[str]:
    """List the progress and the figures of a job."""
    if job.progress is not None:
        return [format_planning(job.progress)]
    if not job.parts:
        return [f"{job.state}, waits: {job.hold.text}" if job.hold is not None else str(job.state)]
    of = len(job.plates)
    parts = [f"printed {job.printed}/{of}" + (f", good {job.good}/{job.printed}" if job.printed else "")]
    if job.state not in (JobState.PRINTING, JobState.PRINTED):
        parts[0] = f"{job.state}, {parts[0]}"
    if job.paused:
        parts.append(f"paused, `farm resume {job.id}`")
    parts.append(f"expected {format_duration(job.estimated_s)}")
    if job.elapsed_s is not None and job.current_s is not None:
        parts[-1] += f", {'actual' if JobState(job.state).ended else 'now'} {format_duration(job.current_s)}"
    if job.state == JobState.PRINTING and job.eta:
        parts[-1] += f" (ends {format_time(job.eta)})"
    if job.speedup and job.utilisation:
        single = f"single printer {format_duration(job.serial_s)}, speed-up {job.speedup:.1f}"
        parts.append(f"{single}, utilisation {format_share(job.utilisation)}")
    if job.wasted_s > 0:
        parts.append(f"wasted {format_duration(job.wasted_s)}, {format_mass(job.wasted_grams)}")
    if job.hold is not None:
        parts.append(job.hold.text)
    if job.submitted_by:
        parts.append(f"by {job.submitted_by}")
    return parts


def _make_printers_table(printers: list[api.PrinterView], now: datetime) -> Table:
    rows = make_table(*_HEADINGS)
    for printer in printers:
        part, ends, deviation = "", "", ""
        state, last = _STATES.get(printer.state, printer.state), printer.last
        if printer.print is not None:
            part = printer.print.plate
            ends = f"in {format_duration(printer.print.remaining_s)} ({format_share(printer.print.progress)})"
        elif last is not None and printer.bed != Bed.CLEAR:
            part, ends = last.plate, f"at {_format_end(last.ended, now)}"
            deviation = format_deviation(last.off) if last.off is not None else ""
            if state == "idle":
                state = "remove" if last.state == PrintState.DONE else "to clear"
        rows.add_row(
            printer.name,
            state,
            part,
            ends,
            deviation,
            f"{printer.time_factor:.2f}",
            _format_reel(printer.reel),
            _format_nozzle(printer),
            _format_degrees(printer.bed_c, printer.targets.bed_c),
            _format_action(printer),
        )
    return rows


def _format_end(iso: str | None, now: datetime) -> str:
    """Format a time of day, with the weekday if it may be from an earlier day."""
    if iso is None or now - datetime.fromisoformat(iso) > _SAME_NIGHT:
        return format_time(iso)
    return datetime.fromisoformat(iso).strftime("%H:%M")


def _format_reel(reel: api.Reel) -> str:
    words = [reel.material.removeprefix("generic_").upper(), reel.colour or ""]
    if reel.grams is not None:
        words.append(f"{reel.grams:.0f}g")
    return " ".join(filter(None, words))


def _format_action(printer: api.PrinterView) -> str:
    """Name what the user must do before the printer prints again."""
    if printer.state == PrintState.PAUSED:
        return "resume"
    if printer.print is not None or printer.hold is None:
        return ""
    if printer.state == Link.ABSENT:
        return "connect"
    if printer.maintenance is not None:
        return f"maintenance --done ({printer.maintenance})"
    words = {
        HoldCode.NEEDS_INSPECTION: "inspect, then clear",
        HoldCode.BED_NOT_CLEAR: "clear",
        HoldCode.FILAMENT_UNKNOWN: "clear with --filament",
        HoldCode.PRINTER_ABSENT: "wait (connecting)",
    }
    return words.get(printer.hold.code, "")


def _format_nozzle(printer: api.PrinterView) -> str:
    """Show the nozzle's size in mm, and its temperature while it is heated."""
    heat = _format_degrees(printer.nozzle_c, printer.targets.nozzle_c) if printer.targets.nozzle_c else ""
    return f"{printer.reel.nozzle_mm:g} {heat}".rstrip()


def _format_degrees(now_c: float | None, target_c: float | None) -> str:
    if now_c is None:
        return "-"
    return f"{now_c:.0f}" + (f"/{target_c:.0f}" if target_c else "") + "C"
