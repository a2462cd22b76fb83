"""Rows of the table of a job's parts. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from farm import api
from farm.model import PrintState, Role
from farm.text import format_duration
from farm.web.pages.jobs.actions import Action, find_printers_with_parts, list_part_actions
from farm.web.pages.sentences import Sentence
from farm.wording import format_deviation, format_filament


@dataclass(frozen=True, slots=True)
class PartRow:
    """Row of a part in the table.

    Attributes
    ----------
    name
        Name of the part without its job, as in the 3D model of the assembly.
    state
        State of its last print, or the verdict on it.
    remark
        Number of the attempt if there were several, and the bed on which the part lies.
    kind
        State for style sheets and scripts: waiting, printing, printed, good, bad, failed or cancelled.
    progress
        Completed share of the open print, from 0 to 1; None if there is none.
    end
        Expected or actual time at which its print ends, as ISO 8601; None if unknown.
    expected_time, current_estimate, actual_time
        Printing times: the time in the plan, the time of the open print as estimated from its progress, and
        the actual time of the last print.
    reason
        Reason why it waits or failed; empty if there is none.
    warnings
        Warnings of its plate, such as walls too thin to print.
    """

    id: str
    name: str
    printer: str
    state: str
    remark: str
    kind: str
    progress: float | None
    end: str | None
    expected_time: str
    current_estimate: str
    actual_time: str
    filament: str
    reason: Sentence
    warnings: Sequence[str]
    actions: tuple[Action, ...]


def list_part_rows(
    job: api.JobView,
    printers: Sequence[api.PrinterView],
    slots: Mapping[str, api.SlotView],
    role: Role,
) -> list[PartRow]:
    """List the rows of a job's parts.

    Parameters
    ----------
    job
        The job.
    printers
        All printers of the fleet.
    slots
        Printer and times of each plate, actual or expected, by the plate's id.
    role
        Role of the user.
    """
    plates = {plate.id: plate for plate in job.plates}
    beds = find_printers_with_parts(job, printers)
    open_prints = {printer.print.plate: printer.print for printer in printers if printer.print is not None}
    rows = []
    for part in job.parts:
        plate = plates[part.plate]
        last_print = part.own_prints[-1] if part.own_prints else None
        open_print, slot = open_prints.get(plate.id), slots.get(plate.id)
        rows.append(
            PartRow(
                id=part.id,
                name=part.id.rpartition("/")[2],
                printer=plate.printer if slot is None else slot.printer,
                state=_find_state(part, plate),
                remark=_format_remark(part, beds.get(part.id)),
                kind=_find_kind(part, plate),
                progress=None if open_print is None else open_print.progress,
                end=slot.ends if slot is not None else (last_print.ended if last_print is not None else None),
                expected_time=format_duration(plate.expected_s),
                current_estimate=_format_current_estimate(last_print, open_print, job.now),
                actual_time=_describe_actual_time(last_print, plate.expected_s),
                filament=format_filament(plate.grams, plate.filament_mm, plate.price, job.currency),
                reason=_explain_wait_or_failure(plate, last_print),
                warnings=plate.warnings,
                actions=tuple(list_part_actions(job, part, beds.get(part.id), role)),
            )
        )
    return rows


def _find_kind(part: api.PartView, plate: api.PlateStatus) -> str:
    last_print = part.own_prints[-1] if part.own_prints else None
    if plate.printing:
        return "printing"
    if last_print is None or plate.hold is not None:
        return "waiting"
    if last_print.state is PrintState.DONE:
        return str(part.verdict or "printed")
    return str(last_print.state)


def _find_state(part: api.PartView, plate: api.PlateStatus) -> str:
    return str(part.own_prints[-1].state) if plate.printing and part.own_prints else _find_kind(part, plate)


def _format_remark(part: api.PartView, printer: api.PrinterView | None) -> str:
    attempts = len(part.own_prints)
    remarks = [f"attempt {attempts}"] if attempts > 1 else []
    if printer is not None:
        remarks.append(f"on the bed of {printer.name}")
    return ", ".join(remarks)


def _format_current_estimate(
    last_print: api.PrintView | None, open_print: api.PrintProgress | None, now: str
) -> str:
    if open_print is None or last_print is None or last_print.started is None:
        return ""
    duration = datetime.fromisoformat(now) - datetime.fromisoformat(last_print.started)
    return format_duration(max(0.0, duration.total_seconds()) + open_print.remaining_s)


def _describe_actual_time(last_print: api.PrintView | None, expected_s: float) -> str:
    if (
        last_print is None
        or last_print.state is not PrintState.DONE
        or not (last_print.started and last_print.ended)
    ):
        return ""
    actual_s = (
        datetime.fromisoformat(last_print.ended) - datetime.fromisoformat(last_print.started)
    ).total_seconds()
    deviation = f" ({format_deviation(actual_s / expected_s - 1)})" if expected_s > 0 else ""
    return format_duration(actual_s) + deviation


def _explain_wait_or_failure(plate: api.PlateStatus, last_print: api.PrintView | None) -> Sentence:
    reasons: list[str] = []
    if last_print is not None and not plate.printing:
        reasons += filter(None, [last_print.reason or last_print.why or last_print.fault])
    if plate.hold is None:
        return Sentence("; ".join(reasons))
    return Sentence("; ".join((*reasons, plate.hold.text)), plate.hold.times)
