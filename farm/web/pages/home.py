"""Home page and its route: tasks for people, printers in the order in which their prints end, and jobs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from fastapi import APIRouter, Request, Response

from farm import api
from farm.http import describe_farm
from farm.model import HoldCode, JobState, Link, PrintState, TextTime
from farm.text import format_count, format_mass
from farm.web.notes import Note, User
from farm.web.pages.page_context import PageContext
from farm.web.pages.rendering import render_page
from farm.web.pages.sentences import Sentence
from farm.wording import format_planning, group_holds, shorten_names

_URGENT_CODES = ("alarm", "outage")
_STATES_WITHOUT_TEMPERATURE = (Link.ABSENT, Link.STARTING, Link.CONNECTING)
"""States of a printer whose temperatures are unknown."""
_MAX_ENDED_JOBS = 8


@dataclass(frozen=True, slots=True)
class BedToClear:
    """Bed to clear, with its printer, the plate on it, and the decision that a person must make on the part.

    Attributes
    ----------
    printer
        Name of the printer.
    label
        Label of the last plate that was printed on the bed; None if there is none.
    awaits_verdict
        True if the part of the plate waits for a verdict.
    seen_print
        Id of the last print on the bed, or "none". The form sends it, so that an outdated page cannot clear
        a later plate.
    good_part
        Part of a failed print that may nevertheless be good.
    """

    printer: str
    label: str | None
    awaits_verdict: bool
    seen_print: str
    good_part: str | None = None


@dataclass(frozen=True, slots=True)
class Task:
    """Task for a person.

    Attributes
    ----------
    key
        Id that does not change while the task exists.
    code
        Code from the to-do list; `heat` for heaters that are on without a print.
    text
        Sentence that says what to do.
    printers, jobs
        Printers and jobs that the task concerns.
    beds
        Beds whose clearing ends the task.
    times
        Times that the text contains.
    """

    key: str
    code: str
    text: str
    printers: Sequence[str] = ()
    jobs: Sequence[api.JobView] = ()
    beds: Sequence[BedToClear] = ()
    times: Sequence[TextTime] = ()

    @property
    def is_urgent(self) -> bool:
        """True if a person should act at once."""
        return self.code in (*_URGENT_CODES, "heat")


@dataclass(frozen=True, slots=True)
class Tile:
    """Printer on the page, with the name of the model that it prints and the expected end of its print."""

    printer: api.PrinterView
    model: str
    end: str | None
    is_hot: bool


@dataclass(frozen=True, slots=True)
class JobCard:
    """Job on the page, with a text about its progress, and the reasons why it or its plates wait."""

    job: api.JobView
    progress: str
    wait_reasons: Sequence[Sentence]


def render_home(status: api.Status, user: User, note: Note | None = None) -> str:
    """Render the home page.

    Parameters
    ----------
    status
        Status of the farm.
    user
        User of the page.
    note
        Message about the user's last action.
    """
    cards = [describe_job_card(job) for job in status.jobs]
    ended_cards = [
        card for card in cards if JobState(card.job.state).ended and card.job.state != JobState.PRINTED
    ]
    return render_page(
        "home.html",
        status.fleet,
        "/",
        user,
        note,
        now=status.fleet.now,
        time_scale=status.fleet.time_scale,
        tasks=list_home_tasks(status),
        tiles=list_tiles(status),
        jobs=[card for card in cards if card not in ended_cards],
        ended=ended_cards[-_MAX_ENDED_JOBS:][::-1],
        night=describe_night(status.night),
    )


def list_home_tasks(status: api.Status) -> list[Task]:
    """List the tasks for people, most urgent first: the to-do list, and heaters on without a print."""
    printers = {printer.name: printer for printer in status.printers}
    jobs = {job.id: job for job in status.jobs}
    keys = _make_task_keys(status.todo)
    tasks = [_describe_task(key, todo, printers, jobs) for key, todo in zip(keys, status.todo, strict=True)]
    alarms = {name for task in tasks if task.code == "alarm" for name in task.printers}
    hot_printers = [printer for printer in status.printers if is_hot(printer) and printer.name not in alarms]
    heat_tasks = [
        Task(f"heat-{printer.name}", "heat", _describe_heat(printer), [printer.name])
        for printer in hot_printers
    ]
    urgent_tasks = [task for task in tasks if task.is_urgent]
    return [*urgent_tasks, *heat_tasks, *(task for task in tasks if not task.is_urgent)]


def _make_task_keys(todos: Iterable[api.Todo]) -> Iterator[str]:
    """Yield a key for each task: its code, jobs and printers, and a number if these are not unique."""
    key_counts = Counter[str]()
    for todo in todos:
        subjects = () if todo.code in ("clear", "host") else (*map(str, todo.jobs), *todo.printers)
        key = "-".join((todo.code, *subjects))
        key_counts[key] += 1
        yield key if key_counts[key] == 1 else f"{key}-{key_counts[key]}"


def is_hot(printer: api.PrinterView) -> bool:
    """Return whether a printer without an open print has heaters that are not reported as off."""
    is_known = printer.nozzle_c is not None and printer.state not in _STATES_WITHOUT_TEMPERATURE
    return is_known and printer.print is None and not printer.heaters_off


def _describe_heat(printer: api.PrinterView) -> str:
    temperatures = (("nozzle", printer.nozzle_c), ("bed", printer.bed_c))
    heat = ", ".join(f"{name} {now_c:.0f} °C" for name, now_c in temperatures if now_c is not None)
    return f"Go to {printer.name}: it has no print, but its heaters are not confirmed off ({heat})"


def _describe_task(
    key: str, todo: api.Todo, printers: dict[str, api.PrinterView], jobs: dict[int, api.JobView]
) -> Task:
    names, beds = todo.printers, list[BedToClear]()
    text = todo.brief or todo.text
    match todo.code:
        case "clear":
            text = f"Clear {format_count(len(names), 'bed')}"
            beds = [describe_bed(printers[name]) for name in names]
        case "look":
            text = f"Inspect {names[0]}: {printers[names[0]].look or todo.brief}"
            beds = [describe_bed(printers[name], todo.good.get(name)) for name in names]
        case "outage":
            loss = f"{' '.join(names)} were lost at the same time (power, USB hub or host?)"
            text = f"{loss}: inspect them, then let them continue"
        case "resume":
            text = todo.text.partition(": `farm")[0]
        case "approve":
            text = f"Approve {text}"
        case "stopped":
            text = f"Decide on {text}, which was ended by the emergency stop"
        case "alarm":
            text = todo.text[:1].upper() + todo.text[1:]
        case "farm":
            text = todo.text
        case "host":  # a host may have hundreds of printers, so there is no button for each
            return Task(key, todo.code, text, [])
        case "connect":
            text = f"Connect {text}"
    task_jobs = [jobs[number] for number in todo.jobs if number in jobs]
    text = text[:1].upper() + text[1:] if not names else text
    return Task(key, todo.code, text, names, task_jobs, beds, todo.times)


def describe_bed(printer: api.PrinterView, good_part: str | None = None) -> BedToClear:
    """Describe the plate on the bed of a printer, and the decision that a person must make about its part."""
    last_print = printer.last
    awaits_verdict = (
        last_print is not None and last_print.state is PrintState.DONE and last_print.verdict is None
    )
    last_print_id = last_print.id if last_print is not None else "none"
    return BedToClear(
        printer.name,
        last_print.label if last_print is not None else None,
        awaits_verdict,
        last_print_id,
        good_part,
    )


def list_tiles(status: api.Status) -> list[Tile]:
    """List the printers in the order in which their prints end; printers without a print come last.

    The ends are rounded down to minutes, so that two printers whose prints end at similar times rarely swap
    their places in the list.
    """
    models, now = {job.id: job.name for job in status.jobs}, status.fleet.now
    tiles = [
        Tile(
            printer,
            models.get(printer.print.job, "") if printer.print else "",
            _format_end(printer, now),
            is_hot(printer),
        )
        for printer in status.printers
    ]
    return sorted(tiles, key=lambda tile: (tile.end is None, tile.end or "", tile.printer.name))


def _format_end(printer: api.PrinterView, now: str) -> str | None:
    if printer.print is None:
        return None
    end = datetime.fromisoformat(now) + timedelta(seconds=printer.print.remaining_s)
    return end.replace(second=0, microsecond=0).isoformat("T", "seconds")


def describe_job_card(job: api.JobView) -> JobCard:
    """Describe the progress of a job, and the reasons why it or its plates wait."""
    progress = format_planning(job.progress) if job.progress is not None else ""
    if job.plates:
        replanning_text = f"; replanning: {progress}" if progress else ""
        progress = f"{job.printed} of {format_count(len(job.plates), 'plate')} printed{replanning_text}"
    return JobCard(job, progress, list(_list_wait_reasons(job)))


def _list_wait_reasons(job: api.JobView) -> Iterator[Sentence]:
    """Yield the reasons why a job and its plates wait, each once."""
    if job.error and job.state != JobState.CANCELLED:
        yield Sentence(job.reason or job.error)
    if job.hold is not None:
        is_held = job.hold.code is HoldCode.APPROVAL
        yield Sentence("waits for approval") if is_held else Sentence(job.hold.text, job.hold.times)
    for hold, names in group_holds([job]):
        if job.hold is None or hold.text != job.hold.text:
            yield Sentence(f"{shorten_names(names)}: {hold.text}", hold.times)


def describe_night(night: api.NightView | None) -> str | None:
    """Describe last night in a sentence."""
    if night is None:
        return None
    counts = {"failed": night.failed, "still printing": night.printing, "not started": night.waiting}
    other_counts = "".join(f", {count} {label}" for label, count in counts.items() if count)
    waste = f", {format_mass(night.wasted_grams)} of it wasted" if night.wasted_grams >= 0.5 else ""
    plates = f"{night.printed} of {format_count(night.plates, 'plate')} printed{other_counts}"
    return f"{plates}; {format_mass(night.grams)} of filament{waste}"


def make_home_routes(pages: PageContext) -> APIRouter:
    """Return the route of the home page."""
    router = APIRouter(include_in_schema=False)

    async def render(user: User, note: Note | None = None) -> str:
        return render_home(describe_farm(pages.services), user, note)

    pages.live_pages.add("/", lambda user, _variable, _query: render(user))

    @router.get("/")
    async def show_home(request: Request) -> Response:
        return await pages.answer(request, render)

    return router
