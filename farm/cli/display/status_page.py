"""What `farm status` shows: what a person has to do now, the night, the jobs, the printers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime, timedelta

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from farm import api
from farm.cli.display.console import table
from farm.cli.display.format import moment, off_plan, planning
from farm.model import Bed, HoldCode, JobState, Link, PrintState
from farm.text import count, mass, span

_INDENT = 9  # of what stands after DO NOW, NIGHT and JOB
_APART = "     "  # between two things to do on one line
_LABELS = {
    "look": "look at",
    "replace": "replace",
    "connect": "connect",
    "reel": "reels",
    "approve": "approve",
}
_HEADINGS = ("PRINTER", "STATE", "PART", "ENDED", "VS PLAN", "FACTOR", "REEL", "NOZZLE", "BED", "NEEDS")
_NAME_WIDTH = 32
_THIS_NIGHT = timedelta(hours=20)


def names(printers: Iterable[str]) -> str:
    """Names in a row, with those that only count on drawn together: um2-01..12 um2x-01."""
    runs: list[tuple[str, str, str]] = []  # what they share, the first number, the last
    for name in sorted(printers, key=lambda name: (name.rstrip("0123456789"), len(name), name)):
        match = re.fullmatch(r"(.*?)(\d+)", name)
        stem, digits = match.groups() if match else (name, "")
        if digits and runs and runs[-1][0] == stem and int(digits) == int(runs[-1][2] or -2) + 1:
            runs[-1] = (stem, runs[-1][1], digits)
        else:
            runs.append((stem, digits, digits))
    return " ".join(stem + first + (f"..{last}" if last != first else "") for stem, first, last in runs)


def board(view: api.Status, width: int) -> RenderableType:
    """The whole status, on lines no longer than a terminal is wide where that can be."""
    now = Text(f"{view.fleet.name}: {moment(view.fleet.now)}", style="bold")
    if view.fleet.time_scale != 1:
        now.append(f"  (simulated, {view.fleet.time_scale:g} times faster)", style="dim")
    rows: list[RenderableType] = [now, *_do_now(view.todo, width)]
    if view.night is not None:
        rows.append(_line("NIGHT", night(view.night)))
    for job in view.jobs:
        rows += _job_lines(job, width)
    return Group(*rows, _printers(view.printers, datetime.fromisoformat(view.fleet.now)))


def _line(head: str, text: str, style: str = "bold") -> Text:
    return Text.assemble((head.ljust(_INDENT), style), text)


def _do_now(todo: list[api.Todo], width: int) -> list[Text]:
    """Everything that waits for a person, in as few lines as it takes."""
    others = [item for item in todo if item.code not in _LABELS]
    things = [
        f"take off {len(item.printers)}: {names(item.printers)}" if item.code == "clear" else item.text
        for item in sorted(others, key=lambda item: item.code == "clear")
    ]
    for code, label in _LABELS.items():
        briefs = [item.brief or item.text for item in todo if item.code == code]
        if briefs:
            things.append(f"{label}: {', '.join(briefs)}")
    return _folded("DO NOW", things or ["nothing"], _APART, width, "bold red")


def _folded(head: str, things: list[str], apart: str, width: int, style: str = "bold") -> list[Text]:
    """Things in a row, on as few lines as it takes."""
    lines: list[str] = []
    for thing in things:
        if lines and _INDENT + len(lines[-1]) + len(apart) + len(thing) <= width:
            lines[-1] += apart + thing
        else:
            lines.append(thing)
    heads = [head, *[""] * len(lines)]
    return [_line(one, text.rstrip(), style) for one, text in zip(heads, lines, strict=False)]


def night(view: api.NightView) -> str:
    """What became of the plates since the afternoon before."""
    rest = {"failed": view.failed, "still printing": view.printing, "not started": view.waiting}
    counts = "".join(f", {count} {words}" for words, count in rest.items() if count)
    waste = f" + {mass(view.wasted_grams)} wasted" if view.wasted_grams >= 0.5 else ""
    plates = f"{view.printed} of {count(view.plates, 'plate')} printed" if view.plates else "nothing printed"
    return f"{plates}{counts}; {mass(view.grams)}{waste}"


def _job_lines(job: api.JobView, width: int) -> list[Text]:
    first, *more = _course(job)
    course = [f"{job.name[:_NAME_WIDTH]}: {first}", *more]
    parts = [f"{part};" for part in course[:-1]] + course[-1:]
    lines = _folded(f"JOB {job.id}", parts, " ", width)
    if job.reason and job.state in (JobState.FAILED, JobState.PRINTING):
        lines.append(_line("", job.reason, "red"))
    waiting: dict[str, list[str]] = {}
    for plate in job.plates:
        if plate.hold is not None:
            waiting.setdefault(plate.hold.text, []).append(plate.id)
    for text, plates in waiting.items():
        lines.append(_line("", f"{names(plates)} {'waits' if len(plates) == 1 else 'wait'}: {text}"))
    return lines


def _course(job: api.JobView) -> list[str]:
    """How a job goes, thing by thing."""
    if job.progress is not None:
        return [planning(job.progress)]
    if not job.parts:
        return [f"{job.state}, waits: {job.hold.text}" if job.hold is not None else str(job.state)]
    of = len(job.plates)
    parts = [f"printed {job.printed}/{of}" + (f", good {job.good}/{job.printed}" if job.printed else "")]
    if job.state not in (JobState.PRINTING, JobState.PRINTED):
        parts[0] = f"{job.state}, {parts[0]}"
    if job.paused:
        parts.append(f"paused, `farm resume {job.id}`")
    parts.append(f"expected {span(job.estimated_s)}")
    if job.elapsed_s is not None and job.current_s is not None:
        parts[-1] += f", {'reached' if JobState(job.state).ended else 'now'} {span(job.current_s)}"
    if job.state == JobState.PRINTING and job.eta:
        parts[-1] += f" (ends {moment(job.eta)})"
    if job.speedup and job.utilisation:
        alone = f"alone {span(job.serial_s)}, speed-up {job.speedup:.1f}"
        parts.append(f"{alone}, use {100 * job.utilisation:.0f} %")
    if job.wasted_s > 0:
        parts.append(f"wasted {span(job.wasted_s)}, {mass(job.wasted_grams)}")
    if job.hold is not None:
        parts.append(job.hold.text)
    if job.submitted_by:
        parts.append(f"by {job.submitted_by}")
    return parts


def _printers(printers: list[api.PrinterView], now: datetime) -> Table:
    rows = table(*_HEADINGS)
    for printer in printers:
        part, end, off = "", "", ""
        state, last = printer.state, printer.last
        if printer.print is not None:
            part = printer.print.plate
            end = f"in {span(printer.print.remaining_s)} {printer.print.progress:4.0%}"
        elif last is not None and printer.bed != Bed.CLEAR:
            part, end = last.plate, _ended(last.ended, now)
            off = off_plan(last.off) if last.off is not None else ""
            if state == "idle":
                state = "remove" if last.state == PrintState.DONE else "to clear"
        rows.add_row(
            printer.name,
            state,
            part,
            end,
            off,
            f"{printer.time_factor:.2f}",
            _reel(printer.reel),
            _nozzle(printer),
            _degrees(printer.bed_c, printer.targets.bed_c),
            _needs(printer),
        )
    return rows


def _ended(iso: str | None, now: datetime) -> str:
    """The time of day; with the day, where it may be another's."""
    if iso is None or now - datetime.fromisoformat(iso) > _THIS_NIGHT:
        return moment(iso)
    return datetime.fromisoformat(iso).strftime("%H:%M")


def _reel(reel: api.Reel) -> str:
    words = [reel.material.removeprefix("generic_").upper(), reel.colour or ""]
    if reel.grams is not None:
        words.append(f"{reel.grams:.0f}g")
    return " ".join(filter(None, words))


def _needs(printer: api.PrinterView) -> str:
    """What a person would have to do for it to print on."""
    if printer.state == PrintState.PAUSED:
        return "resume"
    if printer.print is not None or printer.hold is None:
        return ""
    if printer.state == Link.ABSENT:
        return "connect"
    if printer.maintenance is not None:
        return f"maintenance --done ({printer.maintenance})"
    words = {
        HoldCode.NEEDS_A_LOOK: "a look, cleared",
        HoldCode.BED_NOT_CLEAR: "cleared",
        HoldCode.FILAMENT_UNKNOWN: "cleared --filament",
        HoldCode.PRINTER_ABSENT: "connecting",
    }
    return words.get(printer.hold.code, "")


def _nozzle(printer: api.PrinterView) -> str:
    """Its size, and how hot it is while it is heated."""
    heat = _degrees(printer.nozzle_c, printer.targets.nozzle_c) if printer.targets.nozzle_c else ""
    return f"{printer.reel.nozzle_mm:g} {heat}".rstrip()


def _degrees(now_c: float | None, target_c: float | None) -> str:
    if now_c is None:
        return "-"
    return f"{now_c:.0f}" + (f"/{target_c:.0f}" if target_c else "") + "C"
