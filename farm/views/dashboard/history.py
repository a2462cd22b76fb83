"""View of the history page: ended prints of a period, their figures and jobs; the prints as CSV. Pure."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO

from farm import api
from farm.model import Job, JobState, Print
from farm.text import flatten_text
from farm.views.context import ViewContext
from farm.views.dashboard.figures import Figures, group_figures, name_month, sum_figures
from farm.views.history import make_history_row
from farm.views.jobs import compute_job_times
from farm.wording import describe_material

_DAY_S = 86400.0
_FORMULA_PREFIXES = ("=", "+", "-", "@", "\t", "\r")  # first characters of formulas in spreadsheet programs
_COLUMNS = (
    *("job", "name", "part", "printer", "state", "verdict", "fault", "reason", "why"),
    *("started", "ended", "took_s", "expected_s", "grams", "wasted", "submitted_by", "note"),
    *("assembled", "assembly_s"),
)


@dataclass(frozen=True, slots=True)
class HistoryFilter:
    """Filter for ended prints: maximum age in days, printer, and job. None accepts all."""

    days: int | None = None
    printer: str | None = None
    job: int | None = None


@dataclass(frozen=True, slots=True)
class JobOutcome:
    """Job that has ended, with its expected and actual parallel printing time in seconds.

    Attributes
    ----------
    assembled
        Time at which a person reported that the parts are glued.
    assembly_expected_s, assembly_s
        Gluing time: expected from the steps of the assembly, and reported by a person.
    """

    id: int
    name: str
    state: JobState
    ended: str | None
    expected_s: float | None
    actual_s: float | None
    assembled: str | None = None
    assembly_expected_s: float | None = None
    assembly_s: float | None = None

    @property
    def deviation(self) -> float | None:
        """Ratio of the actual to the expected time, minus 1; None if either is unknown."""
        return self.actual_s / self.expected_s - 1 if self.expected_s and self.actual_s else None


@dataclass(frozen=True, slots=True)
class HistoryView:
    """Ended prints, newest first, with figures of all prints.

    Attributes
    ----------
    rows
        The latest prints, as many as the page shows.
    hidden_count
        Number of older prints, which only the CSV file lists.
    """

    now: str
    history_filter: HistoryFilter
    printers: tuple[str, ...]
    total: Figures
    figures_by_printer: list[Figures]
    figures_by_material: list[Figures]
    figures_by_month: list[Figures]
    jobs: list[JobOutcome]
    rows: list[api.HistoryRow]
    hidden_count: int


def describe_history(context: ViewContext, history_filter: HistoryFilter, max_rows: int = 100) -> HistoryView:
    """Describe ended prints with their figures.

    Parameters
    ----------
    context
        Current data of the farm.
    history_filter
        Filter that selects the prints.
    max_rows
        Maximum number of listed prints, and of listed jobs; the figures include all prints.
    """
    books, zone = context.books, context.fleet.zone
    prints = select_prints(context, history_filter)
    jobs = [
        job
        for job in map(books.get_job, sorted({attempt.job for attempt in prints}, reverse=True))
        if job.state.ended
    ]
    shown_prints = prints[-max_rows:]
    return HistoryView(
        now=context.format_time(context.now_s) or "",
        history_filter=history_filter,
        printers=tuple(
            sorted({*context.fleet.names, *(attempt.printer for attempt in books.prints.values())})
        ),
        total=sum_figures("all", prints, books.plates),
        figures_by_printer=group_figures(prints, books.plates, lambda attempt: attempt.printer),
        figures_by_material=group_figures(
            prints,
            books.plates,
            lambda attempt: _name_material(context, books.plates[attempt.plate].material),
        ),
        figures_by_month=group_figures(prints, books.plates, lambda attempt: name_month(attempt, zone)),
        jobs=[_describe_outcome(context, job) for job in jobs[:max_rows]],
        rows=[make_history_row(context, attempt) for attempt in reversed(shown_prints)],
        hidden_count=len(prints) - len(shown_prints),
    )


def select_prints(context: ViewContext, history_filter: HistoryFilter) -> list[Print]:
    """Select ended prints that were started, in the order in which they ended.

    Raises
    ------
    NotFoundError
        If there is no such job.
    """
    if history_filter.job is not None:
        context.books.get_job(history_filter.job)
    since_s = 0.0 if history_filter.days is None else context.now_s - history_filter.days * _DAY_S
    prints = [
        attempt
        for attempt in context.books.prints.values()
        if attempt.state.ended
        and attempt.started_s is not None
        and history_filter.printer in (None, attempt.printer)
        and history_filter.job in (None, attempt.job)
        and (attempt.ended_s or 0.0) >= since_s
    ]
    return sorted(prints, key=lambda attempt: (attempt.ended_s or 0.0, attempt.id))


def _name_material(context: ViewContext, material: str) -> str:
    """Return the name of a material by its kind if a printer still has the material, else by its file."""
    kinds = (section.material_kind for section in context.fleet.printers if section.material == material)
    return describe_material(material, next(kinds, None))


def _describe_outcome(context: ViewContext, job: Job) -> JobOutcome:
    is_printed = job.state in (JobState.PRINTED, JobState.DONE)
    return JobOutcome(
        id=job.id,
        name=job.name,
        state=job.state,
        ended=context.format_time(job.ended_s),
        expected_s=job.expected_s,
        actual_s=compute_job_times(context, job).makespan_s if is_printed else None,
        assembled=context.format_time(job.assembled_s),
        assembly_expected_s=job.assembly_s,
        assembly_s=job.gluing_s,
    )


def write_csv(rows: Iterable[api.HistoryRow]) -> str:
    """Write prints as CSV (RFC 4180) with a line of headings; durations in seconds.

    A text that a spreadsheet program would take for a formula gets an apostrophe in front: users choose the
    names of models and write the notes, so that any text is possible.
    """
    text = StringIO()
    writer = csv.writer(text)
    writer.writerow(_COLUMNS)
    for row in rows:
        writer.writerow([_format_cell(getattr(row, column)) for column in _COLUMNS])
    return text.getvalue()


def _format_cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{value:.10g}"
    text = flatten_text(str(value))
    return f"'{text}" if text.lstrip().startswith(_FORMULA_PREFIXES) else text
