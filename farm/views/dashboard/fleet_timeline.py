"""View of the fleet's timeline: rows of printers, bars of prints, bands of attended and quiet hours. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from farm.scheduling import Situation
from farm.text import format_duration
from farm.views.charts import TimeAxis, TimeMark
from farm.views.context import ViewContext
from farm.views.dashboard.fleet_plan import (
    PLANNED_KIND,
    FleetPlan,
    TimelinePrint,
    build_fleet_plan,
    list_spans,
)
from farm.views.dashboard.what_if import Change, JobDelay, try_change
from farm.views.jobs import count_waiting_plates

_WIDTH, _ROW_HEIGHT, _LEFT_MARGIN, _RIGHT_MARGIN, _TOP_MARGIN = 1200, 30, 110, 30, 44  # lengths in px
_BAR_HEIGHT = 22
_CHARACTER_WIDTH = 7.0  # approximate width of a character, px
_MARGIN_S = 1800.0  # time on the axis before the first print and after the last
_MIN_SPAN_S, _MAX_SPAN_S = 6 * 3600.0, 8 * 86400.0
SIGNS = {
    "good": "✓",
    "printed": "✓",
    "bad": "✗",
    "failed": "✗",
    "cancelled": "–",
    "printing": "▶",
    PLANNED_KIND: "",
}
"""Sign before the name of a part, by kind, because not everybody can distinguish the colours of the kinds."""


@dataclass(frozen=True, slots=True)
class Bar:
    """Bar of a print; lengths in px. `text` is the full description of the print."""

    x: float
    width: float
    kind: str
    label: str
    text: str
    job: int


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a printer; its top is at `y` px."""

    printer: str
    y: int
    bars: tuple[Bar, ...]


@dataclass(frozen=True, slots=True)
class Band:
    """Band in the background of the chart for a span of attended or quiet hours; lengths in px."""

    x: float
    width: float


@dataclass(frozen=True, slots=True)
class Chart:
    """Layout of the timeline; lengths in px."""

    rows: tuple[Row, ...]
    marks: tuple[TimeMark, ...]
    attended_bands: tuple[Band, ...]
    quiet_bands: tuple[Band, ...]
    now_x: float
    height: int
    kinds: tuple[tuple[str, str], ...]
    width: int = _WIDTH
    left: int = _LEFT_MARGIN
    top: int = _TOP_MARGIN
    bar_height: int = _BAR_HEIGHT


@dataclass(frozen=True, slots=True)
class TableRow:
    """Row of the table for a print, with its times as ISO 8601."""

    printer: str
    job: int
    name: str
    part: str
    kind: str
    start: str
    end: str


@dataclass(frozen=True, slots=True)
class DelayRow:
    """Ends of a job without and with a change, as ISO 8601; None if the job is not in the forecast."""

    job: int
    name: str
    end: str | None
    new_end: str | None
    delay_s: float | None


@dataclass(frozen=True, slots=True)
class WaitingJob:
    """Job whose start or place in the queue a what-if change can alter."""

    id: int
    name: str


@dataclass(frozen=True, slots=True)
class TimelineView:
    """Timeline of the fleet.

    Attributes
    ----------
    past_s
        Time from the start of the timeline to now, in seconds.
    unprintable_parts
        Parts that no printer can print.
    jobs_without_plan
        Jobs that are not planned yet, so that the timeline cannot show them.
    waiting_jobs
        Jobs with plates that have not started, which a what-if change can alter.
    change, delays
        The what-if change, and the ends of each job without and with it; None and empty without a change.
    """

    now: str
    zone: str
    past_s: float
    chart: Chart
    table: tuple[TableRow, ...]
    unprintable_parts: tuple[str, ...]
    jobs_without_plan: tuple[WaitingJob, ...]
    waiting_jobs: tuple[WaitingJob, ...]
    change: Change | None = None
    delays: tuple[DelayRow, ...] = ()


def describe_fleet_timeline(
    context: ViewContext, situation: Situation, past_s: float, change: Change | None = None
) -> TimelineView:
    """Describe the past, running and planned prints of the fleet.

    Parameters
    ----------
    context
        Current data of the farm.
    situation
        Situation for the forecast.
    past_s
        Time from the start of the timeline to now, in seconds.
    change
        What-if change to a job; the timeline shows the plan with this change. None: the present plan.

    Raises
    ------
    NotFoundError
        If the change names an unknown job.
    InvalidTransition
        If the job cannot be moved.
    """
    since_s, delays = context.now_s - past_s, list[JobDelay]()
    if change is None:
        plan = build_fleet_plan(context, situation, since_s)
    else:
        plan, delays = try_change(context, situation, change, since_s)
    jobs = context.books.list_open_jobs()
    return TimelineView(
        now=context.format_time(context.now_s) or "",
        zone=context.fleet.fleet.timezone,
        past_s=past_s,
        chart=_lay_out_chart(context, situation, plan, since_s),
        table=tuple(_make_table_row(context, timeline_print) for timeline_print in plan.prints),
        unprintable_parts=tuple(context.books.plates[name].parts[0] for name in plan.unprintable_plates),
        jobs_without_plan=tuple(WaitingJob(job.id, job.name) for job in jobs if not job.plates),
        waiting_jobs=tuple(
            WaitingJob(job.id, job.name) for job in jobs if count_waiting_plates(context.books, job)
        ),
        change=change,
        delays=tuple(_make_delay_row(context, delay) for delay in delays),
    )


def _make_delay_row(context: ViewContext, job_delay: JobDelay) -> DelayRow:
    return DelayRow(
        job=job_delay.job.id,
        name=job_delay.job.name,
        end=context.format_time(job_delay.end_s),
        new_end=context.format_time(job_delay.new_end_s),
        delay_s=job_delay.delay_s,
    )


def _lay_out_chart(context: ViewContext, situation: Situation, plan: FleetPlan, since_s: float) -> Chart:
    """Lay out a plan from its start until its end, but at most until eight days from now."""
    last_s = max((timeline_print.end_s for timeline_print in plan.prints), default=context.now_s) + _MARGIN_S
    first_s = (
        min((timeline_print.start_s for timeline_print in plan.prints), default=context.now_s) - _MARGIN_S
    )
    begin_s = max(since_s, min(first_s, context.now_s - _MARGIN_S))
    end_s = min(max(last_s, begin_s + _MIN_SPAN_S), context.now_s + _MAX_SPAN_S)
    axis = TimeAxis(begin_s, end_s, _LEFT_MARGIN, _WIDTH - _LEFT_MARGIN - _RIGHT_MARGIN, context.fleet.zone)
    rows = []
    names = dict.fromkeys([*context.fleet.names, *(timeline_print.printer for timeline_print in plan.prints)])
    for number, name in enumerate(names):
        bars = (
            timeline_print
            for timeline_print in plan.prints
            if timeline_print.printer == name and timeline_print.start_s < end_s
        )
        rows.append(
            Row(
                name,
                _TOP_MARGIN + _ROW_HEIGHT * number,
                tuple(_lay_out_bar(context, axis, timeline_print) for timeline_print in bars),
            )
        )
    rules = situation.rules
    kinds = {timeline_print.kind for timeline_print in plan.prints}
    return Chart(
        rows=tuple(rows),
        marks=tuple(axis.list_marks()),
        attended_bands=_lay_out_bands(axis, list_spans(rules.attended_hours, begin_s, end_s)),
        quiet_bands=_lay_out_bands(axis, list_spans(rules.quiet_hours, begin_s, end_s)),
        now_x=axis.compute_x(context.now_s),
        height=_TOP_MARGIN + _ROW_HEIGHT * len(rows) + 4,
        kinds=tuple((kind, sign) for kind, sign in SIGNS.items() if kind in kinds),
    )


def _lay_out_bands(axis: TimeAxis, spans: Sequence[tuple[float, float]]) -> tuple[Band, ...]:
    return tuple(
        Band(axis.compute_x(begin_s), axis.compute_x(end_s) - axis.compute_x(begin_s))
        for begin_s, end_s in spans
    )


def _lay_out_bar(context: ViewContext, axis: TimeAxis, timeline_print: TimelinePrint) -> Bar:
    x = axis.compute_x(timeline_print.start_s)
    width = max(3.0, axis.compute_x(timeline_print.end_s) - x - 1.0)
    label = " ".join(filter(None, (SIGNS[timeline_print.kind], timeline_print.part)))
    if len(label) * _CHARACTER_WIDTH > width:
        label = SIGNS[timeline_print.kind] if width > 2 * _CHARACTER_WIDTH else ""
    duration = format_duration(timeline_print.end_s - timeline_print.start_s)
    part = f"{timeline_print.part} ({context.books.jobs[timeline_print.job].name})"
    text = f"{part} on {timeline_print.printer}: {timeline_print.kind}, {duration}"
    return Bar(x, width, timeline_print.kind, label, text, timeline_print.job)


def _make_table_row(context: ViewContext, timeline_print: TimelinePrint) -> TableRow:
    return TableRow(
        printer=timeline_print.printer,
        job=timeline_print.job,
        name=context.books.jobs[timeline_print.job].name,
        part=timeline_print.part,
        kind=timeline_print.kind,
        start=context.format_time(timeline_print.start_s) or "",
        end=context.format_time(timeline_print.end_s) or "",
    )
