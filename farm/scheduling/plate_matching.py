"""Matching of free printers with waiting plates, for the assignment and for the forecast. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain

from farm.scheduling.matching import Capabilities, FleetPrinter, WaitingPlate, may_take_spare
from farm.scheduling.plate_queue import QueueRank
from farm.scheduling.start_rules import StartRules, StartWindow, compute_needed_grams

Queue = Iterable[tuple[QueueRank, Iterable[WaitingPlate]]]
"""Waiting plates by job, as `PlateQueue` orders them."""


@dataclass(frozen=True, slots=True)
class FleetOrder:
    """Order of preference of the printers, and their kinds.

    Attributes
    ----------
    rank_by_name
        Rank of each printer in order of build height, then of name.
    kind_by_name
        Number that identifies the kind of each printer; printers of one kind differ only in name and reel.
    """

    rank_by_name: Mapping[str, int]
    kind_by_name: Mapping[str, int]

    @classmethod
    def from_printers(cls, printers: Iterable[FleetPrinter]) -> FleetOrder:
        """Determine the order and the kinds of printers."""
        by_height = sorted(printers, key=lambda p: (p.capabilities.height_mm, p.name))
        numbers: dict[tuple[Capabilities, bool], int] = {}
        return cls(
            {p.name: rank for rank, p in enumerate(by_height)},
            {
                p.name: numbers.setdefault((p.capabilities, p.may_print_unattended), len(numbers))
                for p in by_height
            },
        )


@dataclass(frozen=True, slots=True)
class MatchingInputs:
    """Input of the matching: state of the printers, and limits, at a given time.

    Attributes
    ----------
    fleet
        All printers by name, in their current state.
    free_printers
        Names of the printers to match, which are idle and have a clear bed.
    order
        Order and kinds of the printers.
    planned_printers
        The printers for which the waiting plates were planned.
    spare_printers
        Free printers that are kept for plates that failed elsewhere.
    extra_printer_counts
        Number of additional printers that a job may use; jobs without a limit are absent.
    start_limit
        Number of printers that may start to heat up now.
    rules, now_s
        Attended and quiet hours, and the present time in seconds since the epoch.
    """

    fleet: Mapping[str, FleetPrinter]
    free_printers: Collection[str]
    order: FleetOrder
    planned_printers: Collection[str]
    spare_printers: Collection[str]
    extra_printer_counts: Mapping[int, int]
    start_limit: int
    rules: StartRules
    now_s: float


def match_plates(queue: Queue, inputs: MatchingInputs) -> dict[str, WaitingPlate]:
    """Match free printers with waiting plates; return the plate of each printer that gets one.

    See `farm.scheduling.assignment.assign_plates` for the order and the choice.
    """
    matching = _Matching(inputs)
    max_starts = min(inputs.start_limit, len(inputs.free_printers))
    extra_printer_counts = dict(inputs.extra_printer_counts)
    unplaced_plates: list[WaitingPlate] = []
    for (*_, job), plates in queue:
        for plate in plates:
            if len(matching.plate_by_printer) >= max_starts:
                return matching.plate_by_printer
            if extra_printer_counts.get(job) == 0:
                break
            if not matching.may_place(plate):
                continue
            if matching.place(plate):
                if job in extra_printer_counts:
                    extra_printer_counts[job] -= 1
            elif plate.failed_on:
                unplaced_plates.append(plate)
    for plate in unplaced_plates:
        if len(matching.plate_by_printer) >= max_starts:
            break
        if (
            extra_printer_counts.get(plate.job) != 0
            and matching.place_on_any_printer(plate)
            and plate.job in extra_printer_counts
        ):
            extra_printer_counts[plate.job] -= 1
    return matching.plate_by_printer


@dataclass(frozen=True, slots=True)
class _PrinterKind:
    """Free printers that differ only in name and reel."""

    capabilities: Capabilities
    names: list[str]
    # In reverse order of preference, for plates that were planned for other printers. Printers that were
    # assigned meanwhile may still be in it.
    unassigned_printers: list[str]
    max_grams: float  # largest amount on a reel
    window: StartWindow

    @classmethod
    def from_printers(cls, names: list[str], inputs: MatchingInputs) -> _PrinterKind:
        """Describe a kind by the names of its free printers."""
        first = inputs.fleet[names[0]]
        max_grams = max(_get_available_grams(inputs.fleet[name]) for name in names)
        window = inputs.rules.find_start_window(first.may_print_unattended, inputs.now_s)
        planned_printers, rank = inputs.planned_printers, inputs.order.rank_by_name
        unassigned_printers = names.copy()
        if len(names) > 1:
            unassigned_printers.sort(key=lambda name: (name in planned_printers, rank[name]), reverse=True)
        return cls(first.capabilities, names, unassigned_printers, max_grams, window)


class _Matching:
    """Bipartite matching of plates and free printers, which is extended along augmenting paths."""

    def __init__(self, inputs: MatchingInputs) -> None:
        self.plate_by_printer: dict[str, WaitingPlate] = {}
        self._inputs = inputs
        kind = inputs.order.kind_by_name
        self._choices_by_plate: dict[str, list[str]] = {}
        kinds: dict[int, list[str]] = {}
        for name in inputs.free_printers:
            kinds.setdefault(kind[name], []).append(name)
        self._kinds = {number: _PrinterKind.from_printers(names, inputs) for number, names in kinds.items()}

    def may_place(self, plate: WaitingPlate) -> bool:
        """Return whether any kind of free printers can take a plate now."""
        for kind in self._kinds.values():  # a loop is faster than `any` for thousands of plates
            if plate.requirements.matches(kind.capabilities) and kind.window.allows(plate):
                return True
        return False

    def place(self, plate: WaitingPlate) -> bool:
        """Find a printer for a plate, and move other plates if necessary; return whether one was found."""
        return self._augment(plate, set())

    def place_on_any_printer(self, plate: WaitingPlate) -> bool:
        """Find a printer for a plate, including those on which it failed; return whether one was found."""
        for name in self._list_capable_printers(plate):
            if name not in self.plate_by_printer:
                self.plate_by_printer[name] = plate
                return True
        return False

    def _augment(self, plate: WaitingPlate, visited_printers: set[str]) -> bool:
        """Extend the matching by a plate along an augmenting path; return whether there was one."""
        if not plate.failed_on:  # most plates find an unassigned printer, without a list of all choices
            name = self._find_unassigned_printer(plate)
            if name is not None:
                self.plate_by_printer[name] = plate
                return True
        choices = [name for name in self._list_choices(plate) if name not in visited_printers]
        for name in choices:
            if name not in self.plate_by_printer:
                self.plate_by_printer[name] = plate
                return True
        for name in choices:
            if name not in visited_printers:
                visited_printers.add(name)
                if self._augment(self.plate_by_printer[name], visited_printers):
                    self.plate_by_printer[name] = plate
                    return True
        return False

    def _find_unassigned_printer(self, plate: WaitingPlate) -> str | None:
        """Return the best unassigned printer for a plate; None if there is none."""
        inputs, assigned, grams = self._inputs, self.plate_by_printer, compute_needed_grams(plate)
        best: str | None = None
        for kind in self._list_kinds(plate, grams):
            while kind.unassigned_printers and kind.unassigned_printers[-1] in assigned:
                kind.unassigned_printers.pop()
            names = reversed(kind.unassigned_printers)
            if (
                plate.planned_printer in inputs.free_printers
                and self._kinds[inputs.order.kind_by_name[plate.planned_printer]] is kind
            ):
                names = chain((plate.planned_printer,), names)
            for name in names:
                if (
                    name in assigned
                    or grams > _get_available_grams(inputs.fleet[name])
                    or not self._may_use(plate, name)
                ):
                    continue
                if best is None or self._rank_choice(plate, name) < self._rank_choice(plate, best):
                    best = name
                break
        return best

    def _rank_choice(self, plate: WaitingPlate, name: str) -> tuple[bool, bool, int]:
        """Return the sort key of a printer among the choices of a plate; the smallest is the best."""
        return (
            name != plate.planned_printer,
            name in self._inputs.planned_printers,
            self._inputs.order.rank_by_name[name],
        )

    def _list_choices(self, plate: WaitingPlate) -> list[str]:
        """Return the printers that can take a plate now, in order of preference."""
        if plate.id not in self._choices_by_plate:
            names = self._list_capable_printers(plate)
            if plate.failed_on:
                preferred_names = [name for name in names if name not in plate.failed_on]
                names = (
                    preferred_names if preferred_names or not self._has_failed_everywhere(plate) else names
                )
            names.sort(key=lambda name: self._rank_choice(plate, name))
            self._choices_by_plate[plate.id] = names
        return self._choices_by_plate[plate.id]

    def _has_failed_everywhere(self, plate: WaitingPlate) -> bool:
        """Return whether a plate failed on every printer that matches."""
        other_printers = (p for p in self._inputs.fleet.values() if p.name not in plate.failed_on)
        return not any(plate.requirements.matches(p.capabilities) for p in other_printers)

    def _list_capable_printers(self, plate: WaitingPlate) -> list[str]:
        """Return the free printers that can take a plate now, in order of build height."""
        inputs, grams = self._inputs, compute_needed_grams(plate)
        names = [
            name
            for kind in self._list_kinds(plate, grams)
            for name in kind.names
            if grams <= _get_available_grams(inputs.fleet[name]) and self._may_use(plate, name)
        ]
        names.sort(key=inputs.order.rank_by_name.__getitem__)
        return names

    def _list_kinds(self, plate: WaitingPlate, grams: float) -> list[_PrinterKind]:
        """Return the kinds of free printers that can now take a plate that needs this many grams."""
        return [
            kind
            for kind in self._kinds.values()
            if grams <= kind.max_grams
            and kind.window.allows(plate)
            and plate.requirements.matches(kind.capabilities)
        ]

    def _may_use(self, plate: WaitingPlate, name: str) -> bool:
        return name not in self._inputs.spare_printers or may_take_spare(plate, self._inputs.fleet)


def _get_available_grams(printer: FleetPrinter) -> float:
    return float("inf") if printer.grams is None else printer.grams
