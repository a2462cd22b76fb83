"""Progress of a job until it ends: a progress bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from farm import api
from farm.cli.client import Client
from farm.cli.display.console import open_console
from farm.errors import DaemonUnreachable
from farm.model import JobState, PlanProgress, PlanStep, PrintState
from farm.text import format_count, format_duration
from farm.wording import format_cached_plates, format_filament, format_planning, format_time

T = TypeVar("T")
_RESTART_TIMEOUT_S = 60.0  # a restarted daemon answers again within this time
_POLL_INTERVAL_S = 0.5


def retry_during_restart(request: Callable[[], T]) -> T:
    """Repeat a request while the daemon restarts.

    Raises
    ------
    DaemonUnreachable
        If the daemon has not answered for `_RESTART_TIMEOUT_S`.
    """
    deadline_s: float | None = None
    while True:
        try:
            return request()
        except DaemonUnreachable:
            now_s = time.monotonic()
            deadline_s = deadline_s or now_s + _RESTART_TIMEOUT_S
            if now_s > deadline_s:
                raise
            time.sleep(_POLL_INTERVAL_S)


@contextmanager
def show_upload(quiet: bool = False) -> Iterator[Callable[[api.UploadView], None]]:
    """Show the progress of an upload: an updated line on a terminal, or one line for each step."""
    screen = open_console(stderr=True)
    if quiet or not sys.stderr.isatty():
        steps = set[str]()

        def print_step(view: api.UploadView) -> None:
            if view.step not in steps and not quiet:
                steps.add(view.step)
                screen.print(f"  {view.step}")

        yield print_step
        return
    with screen.status("sending") as status:
        yield lambda view: status.update(describe_upload(view))


def describe_upload(view: api.UploadView) -> str:
    """Describe the progress of an upload in a few words."""
    share = f" {view.received / view.size:.0%}" if view.received < view.size else ""
    return f"{view.step}{share}"


@contextmanager
def show_progress(number: int, quiet: bool = False) -> Iterator[Callable[[api.JobView], None]]:
    """Show the progress of a job: each step as a line, and on a terminal also a progress bar.

    Yields
    ------
    Callable
        Function that shows the progress in a new view of the job.
    """
    screen = open_console(stderr=True)
    lines = ProgressLines(screen, quiet)
    columns = (TextColumn("{task.description}"), BarColumn(40), TextColumn("{task.fields[text]}"))
    is_terminal = sys.stderr.isatty()
    with Progress(*columns, console=screen, disable=quiet or not is_terminal) as bar:
        task = bar.add_task(f"job {number}", total=1.0, text="")

        def update(view: api.JobView) -> None:
            lines.update(view)
            share, text = _format_progress(view)
            bar.update(task, completed=share, text=text)

        yield update


def follow_job(client: Client, number: int, quiet: bool = False) -> api.JobStatus:
    """Show the progress of a job until it is printed, cancelled or failed. Ctrl-C does not stop the job."""
    with show_progress(number, quiet) as update:
        while True:
            response = retry_during_restart(lambda: client.fetch_job(number))
            update(response.job)
            if JobState(response.job.state).ended:
                return response
            time.sleep(_POLL_INTERVAL_S)


class ProgressLines:
    """Progress lines of a job, each printed once."""

    def __init__(self, screen: Console, quiet: bool) -> None:
        self._screen = screen
        self._quiet = quiet
        self._printed_lines: set[str] = set()

    def update(self, view: api.JobView) -> None:
        """Print the changes since the last call."""
        if view.waits_for_person:
            holds = [view.hold, *(plate.hold for plate in view.plates)]
            for text in sorted({hold.text for hold in holds if hold is not None}):
                self._print_once(f"waits for you: {text}", is_urgent=True)
        elif view.hold is not None and view.state == JobState.QUEUED:
            self._print_once(f"waits: {view.hold.text}")
        if view.progress is not None:
            key = _format_step(view.progress.model_copy(update={"remaining_s": None}))
            self._print_once(_format_step(view.progress), key)
        if view.expected_s is not None:
            amount = format_filament(view.grams or 0.0, view.filament_mm or 0.0, view.price, view.currency)
            parts = format_count(len(view.parts), "part")
            cached_count = sum(plate.cached for plate in view.plates)
            cache_note = f"; {format_cached_plates(cached_count)}" if cached_count else ""
            self._print_once(
                f"planned: {parts}, expected {format_duration(view.expected_s)}, {amount}{cache_note}"
            )
        if view.printed:
            self._print_once(f"printed {view.printed} of {len(view.plates)} parts")
        for attempt in view.prints:
            if attempt.state == PrintState.FAILED:
                self._print_once(f"{attempt.part} failed on {attempt.printer}: {attempt.reason}")

    def _print_once(self, line: str, key: str | None = None, is_urgent: bool = False) -> None:
        """Print a line, unless a line with the same key was printed; the default key is the line."""
        key = key or line
        if key not in self._printed_lines and (is_urgent or not self._quiet):
            self._printed_lines.add(key)
            self._screen.print(f"  {line}")


def _format_step(progress: PlanProgress) -> str:
    """Describe a step of planning in a text that rarely changes, because each new text is printed."""
    if progress.step is PlanStep.SLICING:
        return f"slicing {format_count(progress.of, 'plate')}"
    if progress.step is PlanStep.DECOMPOSING and progress.share is not None:
        quarters = math.floor(4 * progress.share)
        remaining_s = None if quarters == 0 else progress.remaining_s
        return format_planning(
            progress.model_copy(update={"share": quarters / 4, "remaining_s": remaining_s})
        )
    return format_planning(progress)


def _format_progress(view: api.JobView) -> tuple[float, str]:
    if view.progress is not None:
        progress = view.progress
        return progress.share or progress.done / (progress.of or 1), format_planning(progress)
    if view.state != JobState.PRINTING or not view.expected_s:
        return (1.0 if view.state in (JobState.PRINTED, JobState.DONE) else 0.0), str(view.state)
    share = min(1.0, (view.elapsed_s or 0.0) / view.expected_s)
    return (
        share,
        f"{view.printed}/{len(view.plates)} parts, ends {format_time(view.eta, view.now)}",
    )
