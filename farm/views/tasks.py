"""The to-do list of `farm status`. Pure."""

from __future__ import annotations

from datetime import datetime

from farm import api
from farm.model import AgentSnapshot, Bed, Link, PlanStep, Printer
from farm.state.salvaged_parts import part_name, possibly_whole_print
from farm.views.context import ViewContext
from farm.views.deadlines import list_deadlines
from farm.views.operator_requests import list_requests


def list_tasks(context: ViewContext) -> list[api.Todo]:
    """List what a person has to do now, most urgent first; each printer appears once."""
    alarms, looks, absent, full, ending = [], [], [], [], []
    outage = context.books.outage
    if outage is not None:
        names = " ".join(outage.printers)
        text = (
            f"{names} were lost at the same time (power, USB hub or host?): inspect them, then `farm resume`"
        )
        text += "".join(_ask_whole(context, name) for name in outage.printers)
        looks.append(api.Todo(code="outage", printers=list(outage.printers), text=text))
    for section in context.fleet.printers:
        entry, snapshot = context.books.printer(section.name), context.snapshot(section.name)
        attempt = context.books.open_print_on(section.name)
        away = snapshot.link is Link.ABSENT or (
            snapshot.link in (Link.STARTING, Link.CONNECTING) and context.startup_over
        )
        if snapshot.alarm is not None:
            state = attempt.state if attempt is not None else snapshot.link
            text = f"go to {section.name} now: {snapshot.alarm} ({state}{_heat(snapshot)})"
            alarms.append(api.Todo(code="alarm", printers=[section.name], text=text))
            continue
        if entry.maintenance is not None and attempt is None:
            continue  # a person has it in hand
        if outage is not None and section.name in outage.printers:
            continue  # told once, for all of them
        why = entry.attention_reason or (snapshot.reason if snapshot.link is Link.FAULT else None)
        if section.enabled and away:
            also = f"; and inspect it: {entry.attention_reason}" if entry.attention_reason else ""
            if entry.unreported_since_s is not None:
                also += "; what it printed since the backup of the database is unknown"
            what = f"{section.name}: {snapshot.reason or 'no answer'}"
            text = f"connect {what}{also}"
            absent.append(api.Todo(code="connect", printers=[section.name], text=text, brief=what))
        elif snapshot.outdated and entry.attention_reason is None:
            what = f"{section.name} {snapshot.reason}"
            looks.append(api.Todo(code="replace", printers=[section.name], text=what, brief=what))
        elif why:
            ask = _ask_whole(context, section.name)
            what = f"{section.name} {why}{_when(context, entry)}{ask}"
            text = f"inspect {section.name}: {why}; then `farm cleared {section.name}`{ask}"
            looks.append(api.Todo(code="look", printers=[section.name], text=text, brief=what))
        elif attempt is not None:
            left_s, zone = context.remaining_s(attempt), context.fleet.zone
            ending += list_deadlines(attempt, context.reported_print(attempt), left_s, context.now_s, zone)
        elif entry.bed is not Bed.CLEAR:
            full.append(section.name)
    clear = []
    if full:
        beds = "1 bed" if len(full) == 1 else f"{len(full)} beds"
        text = f"clear {beds}: {' '.join(full)}, then `farm cleared PRINTER`"
        clear = [api.Todo(code="clear", printers=full, text=text)]
    own = [api.Todo(code="farm", printers=[], text=text) for text in _troubles(context)]
    return [*alarms, *own, *looks, *absent, *ending, *clear, *list_requests(context.books)]


def _ask_whole(context: ViewContext, printer: str) -> str:
    """The question whether a failed print is whole after all, and how to say so; empty where it cannot be."""
    attempt = possibly_whole_print(context.books, printer)
    if attempt is None:
        return ""
    part = part_name(context.books, attempt)
    return f"; if part {part} is good all the same: `farm cleared {printer} --good {part}`"


def _heat(snapshot: AgentSnapshot) -> str:
    """How hot it is."""
    heaters = (
        ("nozzle", snapshot.nozzle_c, snapshot.nozzle_target_c),
        ("bed", snapshot.bed_c, snapshot.bed_target_c),
    )
    return "".join(
        f", {name} {now_c:.0f} C, target {target_c or 0.0:.0f}"
        for name, now_c, target_c in heaters
        if now_c is not None
    )


def _troubles(context: ViewContext) -> list[str]:
    """What is wrong with the farm itself."""
    found = [context.warning] if context.warning else []
    for number, progress in context.progress.items():
        if progress.step is PlanStep.NO_ROOM:
            found.append(f"free space on the disk of {context.state.root}: job {number} waits for it")
    return found


def _when(context: ViewContext, printer: Printer) -> str:
    """Since when a printer has to be looked at."""
    if printer.attention_reason is None or printer.attention_since_s is None:
        return ""
    return datetime.fromtimestamp(printer.attention_since_s, context.fleet.zone).strftime(" %H:%M")
