"""Event that records a plan, with its expected time on the fleet and its hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import replace

from farm.model import Job, Part, Plate, compute_assembly_ratio
from farm.planning.plan import Plan
from farm.scheduling import (
    FleetPrinter,
    PlateQueue,
    Situation,
    StartRules,
    describe_plates,
    forecast_prints,
    make_idle_printer,
)
from farm.state import Books
from farm.state import events as ev


def build_planned_event(
    job: Job, plan: Plan, printers: Iterable[FleetPrinter], books: Books, rules: StartRules, now_s: float
) -> ev.JobPlanned:
    """Build the event that records a plan, with its expected time on idle printers.

    If a printer prints several plates, or fleet.yaml limits heating, the time includes the waits between
    a printer's plates, and the waits because of attended hours, quiet hours and the heating limit.
    """
    used_printers = {plate.printer for plate in plan.plates}
    printers = list(printers)
    fleet = [make_idle_printer(printer) for printer in printers if printer.name in used_printers]
    parts = {part.id: part for part in plan.parts}
    books = replace(books, plates={plate.id: plate for plate in plan.plates}, parts=parts)
    waiting_plates = PlateQueue.from_plates(describe_plates(plan.plates, books))
    situation = Situation(waiting_plates, tuple(fleet), rules, now_s)
    forecast = forecast_prints(situation)
    notices = plan.repairs
    materials = sorted({plate.material for plate in plan.plates})
    if len(materials) > 1:
        material_names = " and ".join(materials)
        notices = (
            *notices,
            f"Its parts will be printed in {material_names}, as loaded on their printers: "
            "`--material` selects one.",
        )
    if job.done_by_s is not None or job.assembled_by_s is not None:
        # Deadlines depend on the current state of the printers; the forecast above assumes idle printers.
        print_end_s = forecast_prints(situation.with_printers(tuple(printers))).end_s
        gluing_s = (plan.assembly_s or 0.0) * compute_assembly_ratio(books.jobs.values())
        notices = (*notices, *_describe_missed_deadlines(job, print_end_s, gluing_s, rules, now_s))
    is_parallel = len({slot.printer for slot in forecast.slots}) == len(plan.plates)
    uses_plan_time = forecast.unprintable_plates or (is_parallel and rules.max_heating is None)
    return ev.JobPlanned(
        at_s=now_s,
        job=job.id,
        parts=plan.parts,
        plates=plan.plates,
        repairs=notices,  # the field also stores notices that are not repairs
        scale=plan.scale,
        serial_s=plan.serial_s,
        expected_s=plan.expected_s if uses_plan_time else forecast.end_s - forecast.start_s,
        lower_bound_s=max(0.0, forecast.lower_bound_s - forecast.start_s),
        picture=plan.picture,
        assembly=plan.assembly,
        decomposition=plan.decomposition,
        instructions=plan.instructions,
        assembly_s=plan.assembly_s,
        plan=hash_plan(plan.parts, plan.plates),
        held=job.options.hold,
    )


def _describe_missed_deadlines(
    job: Job, print_end_s: float, gluing_s: float, rules: StartRules, now_s: float
) -> Iterator[str]:
    """Yield a sentence for each deadline that will be missed; gluing the parts takes `gluing_s`."""
    deadlines = (
        ("printed", job.done_by_s, print_end_s),
        ("assembled", job.assembled_by_s, print_end_s + gluing_s),
    )
    for state, deadline_s, end_s in deadlines:
        if deadline_s is not None and end_s > deadline_s:
            deadline, earliest_time = (rules.format_moment(at_s, now_s) for at_s in (deadline_s, end_s))
            yield (
                f"It cannot be {state} by {deadline}: the earliest possible time is "
                f"{earliest_time} ({rules.zone})."
            )


def hash_plan(parts: Iterable[Part], plates: Iterable[Plate]) -> str:
    """Return the hash of a plan's parts, plates and printers: 12 hexadecimal digits."""
    properties = [
        sorted((part.id, part.plate, part.file) for part in parts),
        sorted((plate.id, plate.sha256, plate.printer, plate.material, plate.nozzle_mm) for plate in plates),
    ]
    return hashlib.sha256(json.dumps(properties).encode()).hexdigest()[:12]
