"""Buttons for a job and its parts, according to the states of both and to the user's role. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from farm import api
from farm.model import Bed, HoldCode, JobState, PrintState, Role


@dataclass(frozen=True, slots=True)
class Action:
    """Button of a page.

    Attributes
    ----------
    path
        Route to which the button posts.
    label
        Text on the button.
    fields
        Names and values of the hidden fields in the button's form.
    is_destructive
        True if the action cannot be undone; the page then asks for confirmation.
    """

    path: str
    label: str
    fields: tuple[tuple[str, str], ...] = ()
    is_destructive: bool = False


def list_job_actions(job: api.JobView, role: Role) -> list[Action]:
    """List the buttons for a job; the first is the one that the user most likely needs.

    Parameters
    ----------
    job
        The job.
    role
        Role of the user.
    """
    if not role.allows(Role.PRINT) or JobState(job.state).ended:
        return []
    path, actions = f"/jobs/{job.id}", []
    if job.state == JobState.HELD:
        actions.append(Action(f"{path}/release", "Print it", (("plan", job.plan or ""),)))
    elif job.state in (JobState.QUEUED, JobState.PLANNING) and job.options.hold:
        actions.append(Action(f"{path}/release", "Print it as soon as it is planned"))
    if job.options.dry_run:
        actions.append(Action(f"{path}/keep", "Keep it for approval"))
    elif job.paused:
        actions.append(Action(f"{path}/resume", "Resume"))
    else:
        actions.append(Action(f"{path}/pause", "Pause"))
    label = "Discard the plan" if job.options.dry_run else f"Cancel job {job.id}"
    actions.append(Action(f"{path}/cancel", label, is_destructive=not job.options.dry_run))
    return actions


def can_report_assembly(job: api.JobView, role: Role) -> bool:
    """Return whether a user may report the time that gluing the parts of a job took."""
    is_printed = job.state in (JobState.PRINTED, JobState.DONE)
    is_cut = len(job.parts) > len({part.copy_number for part in job.parts})
    return is_printed and is_cut and role.allows(Role.PRINT)


def list_part_actions(
    job: api.JobView, part: api.PartView, printer: api.PrinterView | None, role: Role
) -> Iterator[Action]:
    """Yield the buttons for a part.

    Parameters
    ----------
    job, part
        The part, and its job.
    printer
        Printer on whose bed the printed part lies; None if the part is on no bed.
    role
        Role of the user.
    """
    if not role.allows(Role.PRINT) or job.options.dry_run:
        return
    path = f"/jobs/{job.id}/parts/{part.id.rpartition('/')[2]}"
    plate = next(candidate for candidate in job.plates if candidate.id == part.plate)
    last_print = part.own_prints[-1] if part.own_prints else None
    if printer is not None and printer.last is not None and role.allows(Role.OPERATE):
        is_done = last_print is not None and last_print.state is PrintState.DONE
        good, bad = ("Good", "Bad") if is_done else ("Usable", "Not usable")
        clear_path, seen = f"/printers/{printer.name}/cleared", ("seen", printer.last.id)
        yield Action(clear_path, f"{good}, and {printer.name} is clear", (seen, ("good", part.id)))
        verdict = (("bad", "true"),) if is_done else ()
        yield Action(clear_path, f"{bad}, and {printer.name} is clear", (seen, *verdict))
    if plate.printing or plate.hold is not None:
        is_paused = (last_print is not None and last_print.state is PrintState.PAUSED) or (
            plate.hold is not None and plate.hold.code is HoldCode.PAUSED
        )
        yield Action(f"{path}/resume", "Resume") if is_paused else Action(f"{path}/pause", "Pause")
        yield Action(f"{path}/cancel", "Cancel this part", is_destructive=True)
    elif job.pruned is None and last_print is not None:
        yield Action(f"{path}/reprint", "Print again", is_destructive=True)


def find_printers_with_parts(
    job: api.JobView, printers: Sequence[api.PrinterView]
) -> dict[str, api.PrinterView]:
    """Find the printers on whose beds printed parts of a job lie, by part id.

    Only the last print of each part counts: an earlier print, which failed, may lie on another bed, and must
    not get the verdict.
    """
    beds = {
        (printer.last.plate, printer.name): printer
        for printer in printers
        if printer.last is not None and printer.bed is not Bed.CLEAR and printer.print is None
    }
    places = {part.id: (part.plate, part.own_prints[-1].printer) for part in job.parts if part.own_prints}
    return {part: beds[place] for part, place in places.items() if place in beds}
