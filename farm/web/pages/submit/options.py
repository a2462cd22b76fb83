"""Options of a job as fields of a form. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from pydantic import ValidationError

from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions
from farm.text import describe_first_error

UNITS = {"1": "millimetres", "10": "centimetres", "25.4": "inches", "1000": "metres"}
"""Names of the units of length, by their length in millimetres."""
QUALITIES = ("glue", "glue-strong", "paper", "paper-hidden", "draft", "fast", "normal", "high")
"""Names of the qualities of the farm and of Cura."""


class Goal(StrEnum):
    """Goal from which the number of printers follows."""

    AUTO = "auto"  # as many printers as shorten the printing time
    COUNT = "count"  # a given number of printers
    DEADLINE = "deadline"  # as few parts as can be printed by a given time
    GLUING_DEADLINE = "glued"  # as few parts as can be printed and glued by then


class Start(StrEnum):
    """Choice of the time at which printing starts."""

    NOW = "now"
    OVERNIGHT = "overnight"
    TIME = "at"


class NextStep(StrEnum):
    """Choice of the step that follows the submission."""

    PLAN = "plan"  # show the plan without printing
    PRINT = "print"
    HOLD = "hold"  # plan the job, and wait for approval


_PLAIN_FIELDS = (  # fields that are passed on unchanged as the option of the same name
    "longest_side_mm",
    "quality",
    "material",
    "colour",
    "copies",
    "pin_mm",
    "name",
    "note",
    "spares",
    "priority",
)
DEFAULTS: Mapping[str, str] = {
    **{
        field: "" if (value := getattr(JobOptions(), field)) is None else str(value)
        for field in _PLAIN_FIELDS
    },
    "scale": "1",
    "goal": Goal.AUTO,
    "printers": "",
    "done_by": "",
    "assembled_by": "",
    "start": Start.NOW,
    "at": "",
    "marks": "",
}
"""Values of the fields of an empty form."""


def read_job_options(fields: Mapping[str, str]) -> JobOptions:
    """Read the options of a job from the fields of a form; for an empty field, the default is used.

    Raises
    ------
    FarmError
        If a field is invalid; the message names it.
    """
    values: dict[str, object] = {name: fields[name] for name in _PLAIN_FIELDS if fields.get(name, "").strip()}
    try:
        if fields.get("scale", "1") != "1" and "longest_side_mm" not in values:
            values["scale"] = fields["scale"]
        goal, start = Goal(fields.get("goal", Goal.AUTO)), Start(fields.get("start", Start.NOW))
        next_step = NextStep(fields.get("next", NextStep.PLAN))
    except ValueError as error:
        raise FarmError(f"{error}: send the form again from its page", ErrorCode.SETTINGS) from error
    if goal is Goal.COUNT:
        values["printers"] = _require_field(fields, "printers", "give the number of printers")
    if goal is Goal.DEADLINE:
        values["done_by"] = _require_field(fields, "done_by", "give the time by which the job is printed")
    if goal is Goal.GLUING_DEADLINE:
        values["assembled_by"] = _require_field(
            fields, "assembled_by", "give the time by which the job is glued"
        )
    if start is Start.TIME:
        values["at"] = _require_field(fields, "at", "give the time at which the job starts")
    values["marks"] = fields.get("marks", "") != ""
    values["overnight"] = start is Start.OVERNIGHT
    values["dry_run"] = next_step is NextStep.PLAN
    values["hold"] = next_step is not NextStep.PRINT
    try:
        return JobOptions.model_validate(values)
    except ValidationError as error:
        raise FarmError(describe_first_error(error.errors()), ErrorCode.SETTINGS) from error


def _require_field(fields: Mapping[str, str], name: str, text: str) -> str:
    value = fields.get(name, "").strip()
    if not value:
        raise FarmError(text, ErrorCode.SETTINGS)
    return value
