"""Which plate goes to which printer now, and why every other plate waits. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from farm.model import Bed, FilamentState, Hold, HoldCode, Link

Box = tuple[float, float, float, float, float]
"""min_x, min_y, max_x, max_y and height, in mm from the bed's centre."""

SLACK_MM = 0.05
"""Rounding of what a slice says of itself."""


@dataclass(frozen=True, slots=True)
class PrinterView:
    """All that decides whether a printer can take a plate."""

    name: str
    room: tuple[Box, ...]  # one of them must hold all that a plate extrudes
    material: str
    colour: str | None
    nozzle_mm: float
    bed: Bed
    filament: FilamentState
    link: Link
    booked: bool  # an open print is booked on it
    look: str | None

    @property
    def height_mm(self) -> float:
        return max((height for *_, height in self.room), default=0.0)

    def holds(self, box: Box) -> bool:
        """Whether all of a plate lies in its room."""
        x0, y0, x1, y1, height = box
        slack = SLACK_MM
        return any(
            left <= x0 + slack and front <= y0 + slack and x1 <= right + slack and y1 <= back + slack
            for left, front, right, back, top in self.room
            if height <= top + slack
        )

    def obstacle(self) -> Hold | None:
        """Why nothing can start on it now; None where it is idle and clear."""
        if self.booked or self.link is Link.BUSY:
            return Hold(code=HoldCode.PRINTER_BUSY, text=f"{self.name} is printing")
        if self.look is not None:
            return Hold(
                code=HoldCode.NEEDS_A_LOOK,
                text=f"{self.name} needs a look ({self.look}), then `farm cleared {self.name}`",
            )
        if self.link is not Link.READY:
            return Hold(code=HoldCode.PRINTER_ABSENT, text=f"{self.name} does not answer ({self.link})")
        if self.bed is not Bed.CLEAR:
            return Hold(
                code=HoldCode.BED_NOT_CLEAR,
                text=f"the bed of {self.name} is not clear: clear it, then `farm cleared {self.name}`",
            )
        if self.filament is FilamentState.UNKNOWN:
            return Hold(
                code=HoldCode.FILAMENT_UNKNOWN,
                text=f"where the filament of {self.name} is is not known: "
                f"`farm cleared {self.name} --filament parked` (or at_nozzle) says it",
            )
        return None


@dataclass(frozen=True, slots=True)
class Need:
    """What a plate, or a job that is not planned yet, asks of a printer."""

    material: str | None
    colour: str | None
    nozzle_mm: float | None
    box: Box | None = None  # what its plate extrudes; not known before it is planned

    def matches(self, printer: PrinterView) -> bool:
        return (
            self.material in (None, printer.material)
            and self.colour in (None, printer.colour)
            and self.nozzle_mm in (None, printer.nozzle_mm)
            and (self.box is None or printer.holds(self.box))
        )


@dataclass(frozen=True, slots=True)
class PlateView:
    """A waiting plate, in the order of the queue."""

    id: str
    need: Need
    job: int
    planned: str  # the printer that the plan gave it
    estimated_s: float
    failed_on: frozenset[str] = frozenset()
    places: int | None = None  # on how many more printers its job may print now; None: on all


@dataclass(frozen=True, slots=True)
class Assignment:
    plate: str
    printer: str


def assign(
    plates: Sequence[PlateView], printers: Iterable[PrinterView]
) -> tuple[list[Assignment], dict[str, Hold]]:
    """Give each waiting plate a printer, or a reason.

    A plate keeps the printer of its plan while that one can take it now; otherwise it goes to any matching
    printer that is idle and clear and that no other waiting plate was planned for. A plate goes back to
    a printer on which it failed only where no other that matches is free. A job that was given a number of
    printers never prints on more of them at once.

    Parameters
    ----------
    plates
        Waiting plates, first in the queue first.
    printers
        The fleet, in any order: the answer is the same.

    Returns
    -------
    assignments, holds
        Each printer at most once, each plate in exactly one of the two.
    """
    fleet = {printer.name: printer for printer in sorted(printers, key=lambda p: p.name)}
    free = {name for name, printer in fleet.items() if printer.obstacle() is None}
    places = {plate.job: plate.places for plate in plates if plate.places is not None}
    given: list[Assignment] = []
    left: list[PlateView] = []

    def give(plate: PlateView, printer: str) -> None:
        given.append(Assignment(plate.id, printer))
        free.discard(printer)
        if plate.job in places:
            places[plate.job] -= 1

    for plate in plates:
        planned = fleet.get(plate.planned)
        fits = planned is not None and plate.planned in free and plate.need.matches(planned)
        if fits and plate.planned not in plate.failed_on and places.get(plate.job) != 0:
            give(plate, plate.planned)
        else:
            left.append(plate)
    # Within a job the longest first: what is left of it ends when its longest plate does.
    for plate in sorted(left, key=lambda p: (p.job, -p.estimated_s)):
        if places.get(plate.job) == 0:
            continue
        matching = [name for name in sorted(free) if plate.need.matches(fleet[name])]
        choice = min(matching, key=lambda n: (n in plate.failed_on, fleet[n].height_mm, n), default=None)
        if choice is not None:
            give(plate, choice)
            left.remove(plate)
    return given, {plate.id: _hold(plate, fleet, places.get(plate.job)) for plate in left}


def _hold(plate: PlateView, fleet: dict[str, PrinterView], places: int | None) -> Hold:
    if places == 0:
        return Hold(
            code=HoldCode.ALL_ITS_PRINTERS_BUSY,
            text="its job prints on as many printers as it was given (--printers)",
        )
    planned = fleet.get(plate.planned)
    if planned is not None and plate.need.matches(planned):
        obstacle = planned.obstacle()
        if obstacle is not None:
            return obstacle
    matching = [printer for printer in fleet.values() if plate.need.matches(printer)]
    if not matching:
        return Hold(
            code=HoldCode.NO_SUCH_PRINTER, text=f"no printer of the fleet matches: {_words(plate.need)}"
        )
    obstacles = [obstacle for printer in matching if (obstacle := printer.obstacle()) is not None]
    if obstacles:
        return obstacles[0]
    return Hold(code=HoldCode.PRINTER_BUSY, text="every matching printer was given another plate")


def _words(need: Need) -> str:
    asked = [str(value) for value in (need.material, need.colour) if value]
    if need.nozzle_mm:
        asked.append(f"nozzle {need.nozzle_mm} mm")
    if need.box is not None:
        x0, y0, x1, y1, height = need.box
        asked.append(f"{x1 - x0:.0f} mm of width, {y1 - y0:.0f} mm of depth and {height:.0f} mm of height")
    return ", ".join(asked) or "nothing asked"
