"""View of a printer's page: its state, temperatures, prints, faults and figures. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from farm import api
from farm.errors import NotFoundError
from farm.model import Hold, Print, Temperatures
from farm.state.event_rows import EventRow
from farm.views.charts import TemperatureChart, lay_out_temperatures
from farm.views.context import ViewContext
from farm.views.dashboard.figures import Figures, sum_figures
from farm.views.events import describe_event
from farm.views.history import list_prints
from farm.views.printers import describe_printer
from farm.views.tasks import list_tasks

_MAX_PRINTS = 20
_MAX_FAULTS = 10


@dataclass(frozen=True, slots=True)
class PrintStill:
    """Picture of a print: the moment in the print (such as `first layer`), the time, and the file."""

    moment: str
    taken: str
    file: str


@dataclass(frozen=True, slots=True)
class FaultView:
    """Print that failed or produced a bad part, with its fault, the reason and its stills."""

    job: int
    part: str
    ended: str | None
    fault: str | None
    text: str
    stills: tuple[PrintStill, ...]


@dataclass(frozen=True, slots=True)
class PrinterPage:
    """View of one printer, with its history.

    Attributes
    ----------
    tasks
        Tasks for people that concern the printer.
    chart
        Chart of the temperatures of the last hours; None if none were reported since the daemon started.
    prints, faults, printer_events
        The latest prints, faults, and events about the printer itself (such as a new reel), newest first.
    """

    now: str
    printer: api.PrinterView
    model: str
    tasks: tuple[api.Todo, ...]
    chart: TemperatureChart | None
    figures: Figures
    prints: list[api.PrintRow]
    faults: list[FaultView]
    printer_events: list[api.EventView]


def describe_printer_page(
    context: ViewContext,
    name: str,
    readings: Sequence[Temperatures],
    printer_events: Sequence[EventRow],
    hold: Hold | None,
    kept_for: str | None = None,
) -> PrinterPage:
    """Describe a printer with its history.

    Parameters
    ----------
    context
        Current data of the farm.
    name
        The printer.
    readings
        Temperatures of the printer, oldest first.
    printer_events
        Events about the printer itself (such as a new reel), newest first.
    hold, kept_for
        See `describe_printer`.

    Raises
    ------
    NotFoundError
        If the fleet has no such printer.
    """
    if name not in context.fleet.names:
        raise NotFoundError(f"there is no printer {name} in the fleet")
    section = context.fleet.find_printer(name)
    prints = [attempt for attempt in context.books.prints.values() if attempt.printer == name]
    return PrinterPage(
        now=context.format_time(context.now_s) or "",
        printer=describe_printer(context, section, hold, kept_for),
        model=section.model,
        tasks=tuple(task for task in list_tasks(context) if name in task.printers),
        chart=lay_out_temperatures(
            readings, context.now_s, context.fleet.zone, lambda at_s: context.format_time(at_s) or ""
        ),
        figures=sum_figures(name, prints, context.books.plates),
        prints=list(reversed(list_prints(context, None, name, None, _MAX_PRINTS))),
        faults=_list_faults(context, prints),
        printer_events=[describe_event(context.books, context.fleet.zone, row) for row in printer_events],
    )


def _list_faults(context: ViewContext, prints: Sequence[Print]) -> list[FaultView]:
    """List the latest ended prints with a fault, or a reason for a failure or verdict, newest first."""
    faulty_prints = [
        attempt
        for attempt in prints
        if attempt.state.ended and (attempt.fault or attempt.verdict_why or attempt.fail_reason)
    ]
    faulty_prints.sort(key=lambda attempt: attempt.ended_s or 0.0, reverse=True)
    return [_describe_fault(context, attempt) for attempt in faulty_prints[:_MAX_FAULTS]]


def _describe_fault(context: ViewContext, attempt: Print) -> FaultView:
    is_pruned = context.books.jobs[attempt.job].pruned_s is not None
    return FaultView(
        job=attempt.job,
        part=context.books.plates[attempt.plate].parts[0],
        ended=context.format_time(attempt.ended_s),
        fault=attempt.fault,
        text=attempt.reason or attempt.fail_reason or attempt.verdict_why or "",
        stills=tuple(
            PrintStill(
                moment=still.moment.replace("_", " "),
                taken=context.format_time(still.at_s) or "",
                file=f"print-{attempt.number}-{still.moment}.{still.file.rpartition('.')[2]}",
            )
            for still in attempt.stills
            if not is_pruned
        ),
    )
