"""Requests that are commands, and the responses to them."""

from __future__ import annotations

from enum import StrEnum

from pydantic import ConfigDict, Field

from farm.api.base import SCHEMA, Line, View
from farm.model import FilamentState, JobState


class QueuePlace(StrEnum):
    """Place to which a job is moved in the queue."""

    UP = "up"
    DOWN = "down"
    FIRST = "first"
    LAST = "last"


class PruneRequest(View):
    """Request to delete files beyond the limits of `fleet.keep`; with `dry_run`, only list their jobs."""

    dry_run: bool = False


class Reason(View):
    """Reason for a command, in the user's words."""

    why: Line = Field(default="", max_length=200)


class ClearedRequest(View):
    """Request to record that a bed is clear, and whether its part is good or bad."""

    filament: FilamentState | None = None
    bad: bool = False
    why: Line | None = Field(default=None, max_length=200)
    # id of a part that is usable although its print failed
    good: Line | None = Field(default=None, max_length=40)
    # id of the last print on the printer when the sender looked; a report on an earlier print is refused
    seen: Line | None = Field(default=None, max_length=64)


class ClearedResponse(View):
    """Response to the report that a bed is clear. A bad part is printed again, unless it was cancelled."""

    again: str | None = None  # id of the part that is printed again because it is bad; null if there is none
    good: str | None = None  # id of the part that is good although its print failed
    # printers that are already printing the good part again
    printed_on: list[str] = Field(default_factory=list)


class NameResponse(View):
    """Name of the part or printer that a command changed."""

    name: str


class LoadRequest(View):
    """Request to record a new reel or nozzle; a value is unchanged if its field is None."""

    material: str | None = Field(default=None, max_length=100)
    colour: Line | None = Field(default=None, max_length=40)
    grams: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    nozzle_mm: float | None = Field(default=None, gt=0, allow_inf_nan=False)


class ApproveRequest(View):
    """Request to release a job with the plan that the user has reviewed."""

    plan: str


class AssembledRequest(View):
    """Report that the parts of a job are glued, with the time that the gluing took."""

    minutes: float = Field(gt=0, le=10_000)


class DownRequest(View):
    """Request to shut down the farm: `now` first stops the open prints safely, `wait` lets them finish."""

    now: bool = False
    wait: bool = False


class QueueMove(View):
    """Request to move a job in the queue: to a `QueuePlace`, or before another job."""

    to: QueuePlace | None = None
    before: int | None = None


class JobStart(View):
    """Request to set the earliest start of a job, such as `22:00` or `fri 22:00`; `now` for no limit."""

    at: str = Field(min_length=1, max_length=40)


class QueueEntry(View):
    """One open job in the queue."""

    id: int
    name: str
    state: JobState
    waiting: int  # number of plates that have not started; 0 before the job is planned
    eta: str | None
    submitted_by: str | None


class Queue(View):
    """Open jobs with plates left to print, in the order in which they are scheduled."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    jobs: list[QueueEntry]
