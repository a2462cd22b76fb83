"""Copies of a model: the number of parts of each copy, and the plan of all copies. Pure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import Part, Plate, TimeFactors
from farm.planning.plan import DecomposeTask, Plan
from farm.planning.printer_settings import list_bed_boxes
from farm.scheduling import derive_plate_requirements, describe_capabilities

T = TypeVar("T")
MAX_PLATES = 2000
"""Maximum number of plates of a job with copies, for quick scheduling decisions."""


def iterate_part_counts(copy_count: int, printer_count: int, max_parts: int) -> Iterator[tuple[int, int]]:
    """Yield ascending numbers of rounds, each with the maximum number of parts per copy in these rounds.

    A person clears the beds between two rounds, so fewer rounds are preferred to more parts.

    Parameters
    ----------
    copy_count, printer_count
        Number of copies, and of printers that print them.
    max_parts
        Maximum number of parts of a copy, which is yielded last.

    Yields
    ------
    round_count, part_count
        Number of rounds, and of parts per copy; both ascend. All copies together have at most
        `round_count * printer_count` parts.
    """
    round_count = part_count = 0
    while part_count < max_parts:
        round_count += 1
        possible_count = min(max_parts, round_count * printer_count // copy_count)
        if possible_count > part_count:
            part_count = possible_count
            yield round_count, part_count


def choose_evenly_spaced_items(items: Sequence[T], count: int) -> list[T]:
    """Choose items at equal distances in a sequence.

    From printers that are sorted by kind, it chooses the same share of each kind.
    """
    return [items[i * len(items) // count] for i in range(count)]


def multiply_plan(plan: Plan, task: DecomposeTask) -> Plan:
    """Make the plan of all copies: the longest plates first, each on the printer on which it ends soonest.

    Parameters
    ----------
    plan
        The plan of one copy.
    task
        The job, with the number of copies and the printers.

    Returns
    -------
    Plan
        Plan of all copies; the names of parts and plates end with the number of the copy, such as 3/p01.2.
        For one copy, the plan itself.

    Raises
    ------
    FarmError
        With code `settings` if the plan would have more than `MAX_PLATES` plates.
    """
    copies = task.options.copies
    if copies == 1:
        return plan
    count = copies * len(plan.plates)
    if count > MAX_PLATES:
        raise FarmError(
            f"{copies} copies of {len(plan.plates)} parts are {count} plates, and a job has at most "
            f"{MAX_PLATES}: submit fewer copies at once",
            ErrorCode.SETTINGS,
        )
    plates = _assign_copies(plan, task)
    numbers = range(1, copies + 1)
    return replace(
        plan,
        parts=tuple(_copy_part(part, number) for number in numbers for part in plan.parts),
        plates=tuple(plates[_name_copy(plate.id, number)] for number in numbers for plate in plan.plates),
        serial_s=plan.serial_s * copies,
        assembly_s=None if plan.assembly_s is None else plan.assembly_s * copies,
    )


def _assign_copies(plan: Plan, task: DecomposeTask) -> dict[str, Plate]:
    """Assign each copy of each plate to a printer; return the copied plates by their name."""
    printers = _choose_printers(plan, task)
    loads_s: dict[str, float] = defaultdict(float)
    plates: dict[str, Plate] = {}
    for plate in sorted(plan.plates, key=lambda plate: (-plate.sliced_s, plate.id)):
        candidates = [section for section in printers if _can_print(section, plate)]
        choices = [_reassign_plate(plate, s, task.find_time_factors(s.name)) for s in candidates] or [plate]
        for number in range(1, task.options.copies + 1):
            chosen_plate = min(
                choices, key=lambda choice: (loads_s[choice.printer] + choice.expected_s, choice.printer)
            )
            loads_s[chosen_plate.printer] += chosen_plate.expected_s
            name = _name_copy(plate.id, number)
            parts = tuple(_name_copy(part, number) for part in plate.parts)
            plates[name] = chosen_plate.model_copy(update={"id": name, "parts": parts})
    return plates


def _choose_printers(plan: Plan, task: DecomposeTask) -> list[PrinterSection]:
    """Choose as many printers as the job may use, beginning with those of the plan."""
    used_printers = {plate.printer for plate in plan.plates}
    printers = sorted(task.printers, key=lambda section: section.name not in used_printers)
    return printers[: max(len(used_printers), task.options.printers or len(printers))]


def _can_print(section: PrinterSection, plate: Plate) -> bool:
    return derive_plate_requirements(plate).matches(describe_capabilities(section, list_bed_boxes))


def _reassign_plate(plate: Plate, section: PrinterSection, time_factors: TimeFactors) -> Plate:
    """Return the plate as planned for another printer, which can print the same G-code."""
    return plate.model_copy(
        update={
            "printer": section.name,
            "time_factor": time_factors.compute_factor(plate.feature_shares),
            "expected_s": plate.compute_expected_s(time_factors),
            "price": section.compute_price(plate.grams),
        }
    )


def _copy_part(part: Part, number: int) -> Part:
    names = {"id": _name_copy(part.id, number), "plate": _name_copy(part.plate, number)}
    return part.model_copy(update={**names, "copy_number": number})


def _name_copy(name: str, number: int) -> str:
    return f"{name}.{number}"
