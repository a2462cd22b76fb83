"""What the scheduler is told: printers, plates, and what each plate asks of a printer. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from farm.model import Bed, FilamentState, Hold, HoldCode, Link

Box = tuple[float, float, float, float, float]
"""min_x, min_y, max_x, max_y and height, in mm from the bed's centre."""

SLACK_MM = 0.05
"""Rounding of what a slice says of itself."""


@dataclass(frozen=True, slots=True)
class Kind:
    """What a printer can print, whatever it is doing."""

    room: tuple[Box, ...]  # one of them must hold all that a plate extrudes
    material: str
    colour: str | None
    nozzle_mm: float
    kin: str | None = None  # printers of one kin take the same G-code

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


@dataclass(frozen=True, slots=True)
class PrinterView:
    """All that decides whether a printer can take a plate."""

    name: str
    kind: Kind
    bed: Bed
    filament: FilamentState
    link: Link
    booked: bool  # an open print is booked on it
    look: str | None
    maintenance: str | None = None  # why a person has taken it out of use
    heating: bool = False
    free_s: float | None = None  # when its print should end, as expected when it began
    grams: float | None = None  # on its reel; None: nobody said
    reel_doubted: bool = False  # there may be less on it
    time_factor: float = 1.0  # as learned
    unattended: bool = True  # it may print while nobody is there
    why_attended: str = ""  # why it may not

    def obstacle(self) -> Hold | None:
        """Why nothing can start on it now; None where it is idle and clear."""
        if self.booked or self.link is Link.BUSY:
            return Hold(code=HoldCode.PRINTER_BUSY, text=f"{self.name} is printing")
        if self.maintenance is not None:
            return Hold(
                code=HoldCode.MAINTENANCE,
                text=f"{self.name} is in maintenance ({self.maintenance}), until "
                f"`farm maintenance {self.name} --done`",
            )
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
        if self.reel_doubted:
            return Hold(
                code=HoldCode.REEL_DOUBTED,
                text=f"how much is on the reel of {self.name} is not known since the books were restored: "
                f"weigh it, then `farm load {self.name} --grams G`",
            )
        return None


@dataclass(frozen=True, slots=True)
class Need:
    """What a plate, or a job that is not planned yet, asks of a printer."""

    material: str | None
    colour: str | None
    nozzle_mm: float | None
    box: Box | None = None  # what its plate extrudes; not known before it is planned
    kin: str | None = None  # of the printers that it was sliced for; None: any

    def matches(self, kind: Kind) -> bool:
        return (
            self.material in (None, kind.material)
            and self.colour in (None, kind.colour)
            and self.nozzle_mm in (None, kind.nozzle_mm)
            and self.kin in (None, kind.kin)
            and (self.box is None or kind.holds(self.box))
        )

    def words(self, lacking: tuple[Kind, ...] = ()) -> str:
        """All that it asks; only what one of these kinds lacks, where any is given."""
        asked = []
        for value, key in ((self.material, "material"), (self.colour, "colour")):
            if value and (not lacking or any(getattr(kind, key) != value for kind in lacking)):
                asked.append(value)
        if self.nozzle_mm and (not lacking or any(kind.nozzle_mm != self.nozzle_mm for kind in lacking)):
            asked.append(f"nozzle {self.nozzle_mm} mm")
        if self.kin and (not lacking or any(kind.kin != self.kin for kind in lacking)):
            asked.append(f"an {self.kin}, which it was sliced for")
        if self.box is not None:
            x0, y0, x1, y1, height = self.box
            width = f"{x1 - x0:.0f} mm of width, {y1 - y0:.0f} mm of depth"
            low = any(height > kind.height_mm + SLACK_MM for kind in lacking)
            narrow = any(not kind.holds((x0, y0, x1, y1, 0.0)) for kind in lacking)
            if not lacking:
                asked.append(f"{width} and {height:.0f} mm of height")
            else:
                asked += [f"{height:.0f} mm of height"] * low + [width] * narrow
        return ", ".join(asked)


@dataclass(frozen=True, slots=True)
class PlateView:
    """A waiting plate."""

    id: str
    need: Need
    job: int
    planned: str  # the printer that the plan gave it
    estimated_s: float
    priority: int = 0  # higher is earlier
    grams: float = 0.0
    heating_s: float = 0.0  # of `estimated_s`: what is not layers
    time_factor: float = 1.0  # of the planned printer, in `estimated_s`
    first_layer_s: float = 0.0  # from its start until its first layer lies
    failed_on: frozenset[str] = frozenset()
    places: int | None = None  # on how many more printers its job may print now; None: on all
    not_before_s: float | None = None

    @property
    def turn(self) -> tuple[int, int, float, str]:
        """Priority, then order of submission, then the longest: a job ends when its longest plate does."""
        return -self.priority, self.job, -self.estimated_s, self.id
