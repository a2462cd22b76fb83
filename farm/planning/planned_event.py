"""Event that records a plan, with its expected time on the fleet and its hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import replace

from farm.model import Job, Part, Plate
from farm.planning.plan import Plan
from farm.scheduling import FleetPrinter, Situation, StartRules, as_idle, describe_plates, forecast_prints
from farm.state import Books
from farm.state import events as ev


def build_planned_event(
    job: Job, plan: Plan, printers: Iterable[FleetPrinter], books: Books, rules: StartRules, now_s: float
) -> ev.JobPlanned:
    """Build the event of a plan, with its time: rounds, hours and the heating limit may extend it."""
    used = {plate.printer for plate in plan.plates}
    printers = list(printers)
    fleet = [as_idle(view) for view in printers if view.name in used]
    books = replace(books, plates={plate.id: plate for plate in plan.plates})
    waiting = list(describe_plates(plan.plates, books))
    situation = Situation(tuple(waiting), tuple(fleet), rules, now_s)
    expected = forecast_prints(situation)
    notices = plan.repairs
    materials = sorted({plate.material for plate in plan.plates})
    if len(materials) > 1:
        of = " and ".join(materials)
        notices = (
            *notices,
            f"Its parts are of {of}, like their printers: `--material` selects one.",
        )
    if job.done_by_s is not None:
        ends_s = forecast_prints(
            situation.with_printers(tuple(printers))
        ).ends_s  # in the present state of the printers: beds may not be clear
        if ends_s > job.done_by_s:
            deadline, ends = (rules.format_moment(at_s, now_s) for at_s in (job.done_by_s, ends_s))
            notices = (*notices, f"It was to be printed by {deadline}; the earliest possible is {ends}.")
    is_parallel = len({slot.printer for slot in expected.slots}) == len(plan.plates)
    at_once = expected.left or (is_parallel and rules.max_heating is None)
    return ev.JobPlanned(
        at_s=now_s,
        job=job.id,
        parts=plan.parts,
        plates=plan.plates,
        repairs=notices,
        scale=plan.scale,
        serial_s=plan.serial_s,
        expected_s=plan.expected_s if at_once else expected.ends_s - expected.starts_s,
        lower_bound_s=max(0.0, expected.lower_bound_s - expected.starts_s),
        picture=plan.picture,
        assembly=plan.assembly,
        decomposition=plan.decomposition,
        instructions=plan.instructions,
        plan=hash_plan(plan.parts, plan.plates),
        held=job.options.hold,
    )


def hash_plan(parts: Iterable[Part], plates: Iterable[Plate]) -> str:
    """Return the hash of a plan's parts, plates and printers: 12 hexadecimal digits."""
    facts = [
        sorted((part.id, part.plate, part.file) for part in parts),
        sorted((plate.id, plate.sha256, plate.printer, plate.material, plate.nozzle_mm) for plate in plates),
    ]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:12]
