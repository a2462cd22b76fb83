"""Policy of replanning: decides which waiting plates are sliced or cut for other printers. Pure.

A plate that waits for printers of one kind may be sliced for a free printer of another kind. The part of a
failed plate may be cut for several free printers. Either happens only if the part then finishes sooner by a
margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from farm.model import Bed, HoldCode
from farm.scheduling import (
    Capabilities,
    Demand,
    FleetPrinter,
    Situation,
    WaitingPlate,
    assign_plates,
    compute_printing_s,
    find_filament_shortage,
    forecast_prints,
)

MIN_GAIN_SHARE = 0.2
"""Minimum share of a part's remaining time that replanning must save."""
MIN_GAIN_S = 1800.0
"""Minimum time that replanning must save, because a new plan takes time too."""
JOINING_TIME_S = 336.0
"""Manual work for each additional piece: removing it from its bed (2 min) and gluing it (3.6 min)."""
SLICING_TIME_S, CUTTING_TIME_S = 120.0, 300.0
"""Typical wall-clock seconds of slicing, and of cutting followed by slicing."""
MAX_PIECES = 8
_CUT_TIME_RATIO = 1.15  # ratio of the time of all pieces to that of the whole part: cuts add walls and skins
_KIND_DEPENDENT_CODES = (
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.NEEDS_INSPECTION,
    HoldCode.PRINTER_ABSENT,
    HoldCode.MAINTENANCE,
    HoldCode.REEL_TOO_SHORT,
    HoldCode.REEL_UNCERTAIN,
    HoldCode.UNATTENDED,
    HoldCode.NO_SUCH_PRINTER,
)
"""Reasons to wait that may not apply to a printer of another kind."""


@dataclass(frozen=True, slots=True)
class Reslice:
    """Instruction to slice a waiting plate's part for a printer."""

    plate: str
    printer: str


@dataclass(frozen=True, slots=True)
class Recut:
    """Instruction to cut a failed plate's part for some printers."""

    plate: str
    printers: tuple[str, ...]


def saves_enough(current_end_s: float, new_end_s: float, now_s: float) -> bool:
    """Return whether an end at `new_end_s` instead of `current_end_s` saves enough time."""
    return new_end_s + max(MIN_GAIN_S, MIN_GAIN_SHARE * (current_end_s - now_s)) <= current_end_s


class EndForecast:
    """Forecast of the ends of the waiting plates of a situation, made on first use.

    A printer that needs inspection is used only if fleet.yaml has attended hours, in which a person inspects
    it.
    """

    def __init__(self, situation: Situation) -> None:
        self._situation = situation

    def find_end_s(self, plate: WaitingPlate) -> float:
        """Return the expected end of a plate in the queue with all others; infinity if unknown."""
        return self._ends_s.get(plate.id, float("inf"))

    @cached_property
    def _ends_s(self) -> dict[str, float]:
        situation = self._situation
        if situation.rules.attended_hours.windows:
            inspected_printers = (
                p if p.attention_reason is None else replace(p, attention_reason=None, bed=Bed.NOT_CLEAR)
                for p in situation.printers
            )
            situation = situation.with_printers(tuple(inspected_printers))
        return {slot.plate: slot.end_s for slot in forecast_prints(situation, include_bound=False).slots}


def compute_expected_end_s(plate: WaitingPlate, situation: Situation) -> float:
    """Return the expected end of a waiting plate in the queue with all others; infinity if unknown."""
    return EndForecast(situation).find_end_s(plate)


def compute_one_piece_end_s(plate: WaitingPlate, situation: Situation) -> float:
    """Return the expected end of a waiting plate's part in one piece, resliced if that is sooner."""
    other_printer = _find_best_printer(plate, situation.free_printers, situation)
    planned_end_s = compute_expected_end_s(plate, situation)
    return (
        planned_end_s
        if other_printer is None
        else min(planned_end_s, _estimate_resliced_end_s(plate, other_printer, situation))
    )


def choose_reslice(
    plate: WaitingPlate,
    situation: Situation,
    free_printers: Sequence[FleetPrinter],
    end_forecast: EndForecast | None = None,
) -> Reslice | None:
    """Choose a printer of another kind on which a waiting plate ends sooner, by at least the margin.

    Parameters
    ----------
    plate
        A plate that waits in the situation and is not assigned now.
    situation
        The current situation.
    free_printers
        The printers to which no other plate is assigned now.
    end_forecast
        The expected ends of the waiting plates, if already computed.

    Returns
    -------
    Reslice | None
        None if reslicing does not save enough time.
    """
    best = _find_best_printer(plate, free_printers, situation)
    if best is None:
        return None
    new_end_s = _estimate_resliced_end_s(plate, best, situation)
    if not saves_enough(
        (end_forecast or EndForecast(situation)).find_end_s(plate), new_end_s, situation.now_s
    ):
        return None
    return Reslice(plate.id, best.name)


def choose_recut(plate: WaitingPlate, situation: Situation) -> Recut | None:
    """Choose the printers for which a failed plate's part is cut, if it then ends sooner by the margin.

    Candidates are the free printers that the other waiting plates do not need. The estimate assumes equal
    pieces; the actual cut is compared with the uncut part before it is used.

    Parameters
    ----------
    plate
        A plate that failed and waits in the situation.
    situation
        The current situation.

    Returns
    -------
    Recut | None
        None if cutting does not save enough time.
    """
    layers_s = plate.expected_s - plate.overhead_s
    piece = replace(plate, expected_s=plate.overhead_s + layers_s * _CUT_TIME_RATIO / 2, grams=0.0)
    free_printers = _list_unneeded_printers(plate, piece, situation)
    max_pieces = min(
        len(free_printers),
        MAX_PIECES,
        len(free_printers) if plate.extra_printer_count is None else plate.extra_printer_count,
    )
    if max_pieces < 2:
        return None
    factors = {p.name: p.time_factors.compute_factor(plate.feature_shares) for p in free_printers}
    free_printers.sort(
        key=lambda p: (p.name in plate.failed_on, factors[p.name], -p.capabilities.height_mm, p.name)
    )

    def compute_recut_end_s(count: int) -> float:
        max_factor = max(factors[p.name] for p in free_printers[:count]) / plate.time_factor
        start_s = situation.now_s + CUTTING_TIME_S * situation.time_scale
        return (
            start_s
            + plate.overhead_s
            + layers_s * _CUT_TIME_RATIO * max_factor / count
            + JOINING_TIME_S * count
        )

    count = min(range(2, max_pieces + 1), key=compute_recut_end_s)
    if not saves_enough(
        compute_one_piece_end_s(plate, situation), compute_recut_end_s(count), situation.now_s
    ):
        return None
    return Recut(plate.id, tuple(p.name for p in free_printers[:count]))


def _list_unneeded_printers(
    plate: WaitingPlate, piece: WaitingPlate, situation: Situation
) -> list[FleetPrinter]:
    """List the free printers that could start a piece of a plate and that no other waiting plate needs."""
    other_plates = situation.waiting_plates.without({plate.id})
    used_printers = {
        assignment.printer
        for assignment in assign_plates(replace(situation, waiting_plates=other_plates, spares={}))
    }
    return [
        p
        for p in situation.free_printers
        if p.name not in used_printers and _has_same_filament(plate, p) and _could_start(piece, p, situation)
    ]


def depends_on_printer_kind(code: HoldCode) -> bool:
    """Return whether a reason to wait may not apply to a printer of another kind."""
    return code in _KIND_DEPENDENT_CODES


def _has_same_filament(plate: WaitingPlate, printer: FleetPrinter) -> bool:
    requirements, capabilities = plate.requirements, printer.capabilities
    return capabilities.meets(
        (requirements.material, requirements.colour, None, None, requirements.allowed_printers)
    )


def is_other_kind(demand: Demand, kind: Capabilities) -> bool:
    """Return whether a kind of printer has the filament of a plate that was sliced for another kind."""
    material, colour, _, _, allowed_printers = demand
    return kind.meets((material, colour, None, None, allowed_printers)) and not kind.meets(demand)


def _differs_in_kind(plate: WaitingPlate, printer: FleetPrinter) -> bool:
    """Return whether a plate matches a printer, except for the kind of printer for which it was sliced."""
    box, kind = plate.requirements.box, printer.capabilities
    return is_other_kind(plate.demand, kind) and (box is None or kind.can_contain(box))


def _find_best_printer(
    plate: WaitingPlate, free_printers: Sequence[FleetPrinter], situation: Situation
) -> FleetPrinter | None:
    """Return the free printer of another kind on which a plate ends soonest; None if there is none."""
    startable_printers = [
        p
        for p in free_printers
        if _differs_in_kind(plate, p) and p.name not in plate.failed_on and _could_start(plate, p, situation)
    ]
    if plate.extra_printer_count == 0 or not startable_printers:
        return None
    return min(startable_printers, key=lambda p: (_estimate_resliced_s(plate, p), p.name))


def _could_start(plate: WaitingPlate, printer: FleetPrinter, situation: Situation) -> bool:
    has_filament = find_filament_shortage(plate, printer) is None
    return has_filament and situation.can_start(plate, printer)


def _estimate_resliced_end_s(plate: WaitingPlate, printer: FleetPrinter, situation: Situation) -> float:
    start_s = situation.now_s + SLICING_TIME_S * situation.time_scale
    return start_s + _estimate_resliced_s(plate, printer)


def _estimate_resliced_s(plate: WaitingPlate, printer: FleetPrinter) -> float:
    """Estimate the printing time of a plate if it is sliced for another printer.

    A finer nozzle takes longer because it prints finer lines; a coarser one is not assumed to be faster.
    """
    line_ratio = 1.0
    if plate.requirements.nozzle_mm is not None:
        line_ratio = max(1.0, (plate.requirements.nozzle_mm / printer.capabilities.nozzle_mm) ** 2)
    overhead_s = plate.overhead_s
    return overhead_s + (compute_printing_s(plate, printer) - overhead_s) * line_ratio
