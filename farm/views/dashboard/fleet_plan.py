"""Ended, running and forecast prints of the fleet over time. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from farm.model import Print
from farm.scheduling import Hours, Situation, forecast_prints
from farm.views.charts import name_outcome
from farm.views.context import ViewContext

PLANNED_KIND = "planned"


@dataclass(frozen=True, slots=True)
class TimelinePrint:
    """Print of a plate on a printer; times in seconds since the epoch.

    Attributes
    ----------
    kind
        Outcome of the print (`good`, `printed`, `bad`, `failed`, `cancelled`), or `printing` or `planned`.
    """

    printer: str
    job: int
    part: str
    kind: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """Past, running and planned prints of the fleet, and the plates that no printer can print."""

    prints: tuple[TimelinePrint, ...]
    unprintable_plates: tuple[str, ...]

    def find_job_ends_s(self) -> dict[int, float]:
        """Return the end of the last running or planned print of each job, by job id."""
        ends_s: dict[int, float] = {}
        for entry in self.prints:
            if entry.kind in (PLANNED_KIND, "printing"):
                ends_s[entry.job] = max(entry.end_s, ends_s.get(entry.job, entry.end_s))
        return ends_s


def build_fleet_plan(context: ViewContext, situation: Situation, since_s: float) -> FleetPlan:
    """Build the plan of the fleet: the prints since a time, and the forecast of all waiting plates.

    Parameters
    ----------
    context
        Current data of the farm.
    situation
        Situation for the forecast, with the waiting plates and the expected ends of running prints.
    since_s
        Time in seconds since the epoch; prints that ended before it are left out.
    """
    forecast = forecast_prints(situation, include_bound=False)
    plates = context.books.plates
    planned_prints = (
        TimelinePrint(
            slot.printer,
            plates[slot.plate].job,
            plates[slot.plate].parts[0],
            PLANNED_KIND,
            slot.start_s,
            slot.end_s,
        )
        for slot in forecast.slots
    )
    prints = [*_list_started_prints(context, since_s), *planned_prints]
    prints.sort(key=lambda entry: (entry.start_s, entry.printer))
    return FleetPlan(tuple(prints), forecast.unprintable_plates)


def _list_started_prints(context: ViewContext, since_s: float) -> Iterator[TimelinePrint]:
    """Yield the open prints, and those that ended since a time; open prints last until their expected end."""
    for attempt in context.books.prints.values():
        if attempt.state.ended and (attempt.started_s is None or (attempt.ended_s or 0.0) < since_s):
            continue
        start_s = attempt.started_s if attempt.started_s is not None else attempt.assigned_s
        part = context.books.plates[attempt.plate].parts[0]
        kind = name_outcome(attempt.state, attempt.verdict)
        yield TimelinePrint(
            attempt.printer,
            attempt.job,
            part,
            kind,
            start_s,
            _find_end_s(context, attempt, start_s),
        )


def _find_end_s(context: ViewContext, attempt: Print, start_s: float) -> float:
    if attempt.ended_s is not None:
        return max(start_s, attempt.ended_s)
    return context.now_s + max(60.0, context.estimate_remaining_s(attempt))


def list_spans(hours: Hours, begin_s: float, end_s: float) -> list[tuple[float, float]]:
    """List the spans of `hours` within an interval, clipped to the interval."""
    spans, at_s = [], begin_s
    while at_s < end_s:
        span = hours.find_span(at_s) or hours.find_next_span(at_s)
        if span is None or span[0] >= end_s:
            break
        spans.append((max(begin_s, span[0]), min(end_s, span[1])))
        at_s = span[1]
    return spans
