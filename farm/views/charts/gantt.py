"""Gantt chart of one job on the fleet: a row for each printer, a bar for each print. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files

from farm import api
from farm.model import PrintState, TextTime, Verdict
from farm.text import format_moment
from farm.views.charts.axis import TimeAxis, TimeMark

# Lengths in px; the right margin has room for half a time label.
_WIDTH, _ROW_HEIGHT, _LEFT_MARGIN, _RIGHT_MARGIN, _TOP_MARGIN = 1040, 22, 150, 36, 24
_MAX_MARKS = 8  # approximate number of time marks
_OTHER_JOB = "another job"
EXPECTED_KIND = "expected"

BAR_KINDS = ("good", "printed", "bad", "failed", "cancelled", "printing", EXPECTED_KIND, _OTHER_JOB)
"""Kinds of bars; `static/palette.css` defines their colours."""


@cache
def load_palette() -> str:
    """Load the style sheet with the colours of the kinds of bars, to embed it in a page."""
    return files("farm.views.charts").joinpath("static", "palette.css").read_text(encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Bar:
    """Bar of the Gantt chart, for a print.

    Attributes
    ----------
    kind
        One of `BAR_KINDS`.
    text
        Text of the tooltip.
    time
        Time in `text`, which pages convert to the reader's time zone; None if `text` contains none.
    """

    printer: str
    start: datetime
    end: datetime
    kind: str
    label: str
    text: str
    time: TextTime | None = None


@dataclass(frozen=True, slots=True)
class Box:
    """Position of a bar in the chart; lengths in px."""

    bar: Bar
    x: float
    width: float


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a printer; its top is at `y` px."""

    printer: str
    y: int
    boxes: tuple[Box, ...]


@dataclass(frozen=True, slots=True)
class Gantt:
    """Layout of a Gantt chart; lengths in px.

    Attributes
    ----------
    legend_kinds
        Kinds of the bars that are in the chart.
    names_width
        Width of the column of printer names; between it and the first bar is room for half a time label.
    """

    height: int
    marks: tuple[TimeMark, ...]
    rows: tuple[Row, ...]
    legend_kinds: tuple[str, ...]
    width: int = _WIDTH
    names_width: int = _LEFT_MARGIN - 40
    top: int = _TOP_MARGIN
    bar_height: int = _ROW_HEIGHT - 5


def name_outcome(state: PrintState, verdict: Verdict | None) -> str:
    """Return the outcome of a print, which is one of `BAR_KINDS`."""
    if state is PrintState.DONE:
        return str(verdict) if verdict else "printed"
    return str(state) if state.ended else "printing"


def list_bars(job: api.JobView, history: Sequence[api.HistoryRow], now: datetime) -> list[Bar]:
    """List the bars of a job's prints, and of other jobs' prints in the same time span."""
    job_bars = []
    for attempt in job.prints:
        if attempt.started is None:
            continue
        end = datetime.fromisoformat(attempt.ended) if attempt.ended else now
        kind = name_outcome(attempt.state, attempt.verdict)
        reason = attempt.reason or attempt.why
        text = f"{attempt.part} on {attempt.printer}: {kind}" + (f", {reason}" if reason else "")
        number = attempt.part.rpartition("/")[2].removeprefix("p")
        start = datetime.fromisoformat(attempt.started)
        job_bars.append(Bar(attempt.printer, start, max(start, end), kind, number, text))
    if not job_bars:
        return []
    first, last = min(bar.start for bar in job_bars), max(bar.end for bar in job_bars)
    return job_bars + [
        Bar(row.printer, start, end, _OTHER_JOB, "", f"{row.part} of another job")
        for row in history
        if row.job != job.id and row.started and row.ended
        for start, end in [(datetime.fromisoformat(row.started), datetime.fromisoformat(row.ended))]
        if end > first and start < last
    ]


def list_expected_bars(slots: Sequence[api.SlotView], now: datetime) -> list[Bar]:
    """List the bars of a timeline's prints that have not ended, from now until their expected ends."""
    bars = []
    for slot in slots:
        start, end = (datetime.fromisoformat(iso) for iso in (slot.starts, slot.ends))
        if end > now:
            parts = " ".join(slot.parts)
            time = TextTime(text=format_moment(end, now), at=slot.ends)
            text = f"{parts} on {slot.printer}: {EXPECTED_KIND} to end {time.text}"
            label = slot.parts[0].rpartition("/")[2].removeprefix("p") if start >= now else ""
            bars.append(Bar(slot.printer, max(start, now), end, EXPECTED_KIND, label, text, time))
    return bars


def lay_out_gantt(bars: Sequence[Bar]) -> Gantt | None:
    """Lay out bars over the time span of the job's own bars; return None if there are no bars."""
    if not bars:
        return None
    job_bars = [bar for bar in bars if bar.kind != _OTHER_JOB]
    first, last = min(bar.start for bar in job_bars), max(bar.end for bar in job_bars)
    zone = first.tzinfo or UTC
    width = _WIDTH - _LEFT_MARGIN - _RIGHT_MARGIN
    axis = TimeAxis(first.timestamp(), last.timestamp(), _LEFT_MARGIN, width, zone)

    def lay_out_bar(bar: Bar) -> Box:
        x = axis.compute_x(bar.start.timestamp())
        return Box(bar, x, max(1.5, axis.compute_x(bar.end.timestamp()) - x))

    rows = tuple(
        Row(
            printer,
            _TOP_MARGIN + _ROW_HEIGHT * number,
            tuple(lay_out_bar(bar) for bar in bars if bar.printer == printer),
        )
        for number, printer in enumerate(sorted({bar.printer for bar in bars}))
    )
    kinds = {bar.kind for bar in bars}
    return Gantt(
        height=_TOP_MARGIN + _ROW_HEIGHT * len(rows) + 4,
        marks=tuple(
            TimeMark(
                axis.compute_x(moment.timestamp()),
                moment.isoformat("T", "seconds"),
                format_moment(moment, first),
            )
            for moment in axis.list_times(_MAX_MARKS)
        ),
        rows=rows,
        legend_kinds=tuple(kind for kind in BAR_KINDS if kind in kinds),
    )
