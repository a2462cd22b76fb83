"""Events and lists of jobs, for programs that follow the farm."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from farm.api.base import SCHEMA, View
from farm.model import JobState


class EventView(View):
    """Entry of the event log; fields that do not apply to the event are null."""

    number: int
    at: str
    kind: str
    job: int | None
    plate: str | None
    printer: str | None
    print_id: str | None
    by: str | None
    state: str | None
    reason: str | None


class JobRow(View):
    """Job in a list; `GET /jobs/{number}` returns the other fields."""

    id: int
    name: str
    state: JobState
    submitted: str
    submitted_by: str | None
    ended: str | None
    note: str | None
    plates: int
    printed: int
    good: int
    error: str | None
    reason: str | None
    assembled: str | None = None  # time at which a person reported that its parts are glued
    assembly_s: float | None = None  # time that the gluing took


class Jobs(View):
    """Jobs in order of submission."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    jobs: list[JobRow]
