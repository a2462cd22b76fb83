"""Printers and waiting plates: capabilities that must match requirements, and spare printers. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

from farm.model import NOMINAL_TIME_FACTORS, Bed, FilamentState, Hold, HoldCode, Link, Shares, TimeFactors

Demand = tuple[str | None, str | None, float | None, str | None, tuple[str, ...]]
"""Requirements of a plate apart from its size: material, colour, nozzle diameter in mm, printer family, and
names of printers; None or empty for any."""
Box = tuple[float, float, float, float, float]
"""min_x, min_y, max_x, max_y and height, in mm from the bed's centre."""

TOLERANCE_MM = 0.05
"""Tolerance of comparisons with the extents of a slice, which are rounded."""
TEMPORARY_CODES = (
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.REEL_UNCERTAIN,
)
"""Codes of obstacles (`FleetPrinter.find_obstacle`) that end by themselves or by a person's quick action."""


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a printer, independent of its state.

    Attributes
    ----------
    build_boxes
        Boxes in which the printer can print; one of them must contain all extrusion of a plate.
    family
        Family of printers that accept the same G-code; None if unknown.
    requested_name
        Name of the printer if an open job requests it; else None, so that printers of one kind are equal.
    """

    build_boxes: tuple[Box, ...]
    material: str
    colour: str | None
    nozzle_mm: float
    family: str | None = None
    material_kind: str | None = None
    requested_name: str | None = None

    def has_material(self, material: str | None) -> bool:
        """Return whether the printer has a material, given by its kind or by the name of its file."""
        return material in (None, self.material, self.material_kind)

    @cached_property
    def height_mm(self) -> float:
        return max((height_mm for *_, height_mm in self.build_boxes), default=0.0)

    def meets(self, demand: Demand) -> bool:
        """Return whether the printer meets a demand."""
        material, colour, nozzle_mm, family, allowed_printers = demand
        return (
            self.has_material(material)
            and colour in (None, self.colour)
            and nozzle_mm in (None, self.nozzle_mm)
            and family in (None, self.family)
            and (not allowed_printers or self.requested_name in allowed_printers)
        )

    def can_contain(self, box: Box) -> bool:
        """Return whether a box lies within one of the build boxes."""
        x0, y0, x1, y1, height_mm = box
        slack_mm = TOLERANCE_MM
        return any(
            left <= x0 + slack_mm
            and front <= y0 + slack_mm
            and x1 <= right + slack_mm
            and y1 <= back + slack_mm
            for left, front, right, back, top in self.build_boxes
            if height_mm <= top + slack_mm
        )


TIME_TOLERANCE_S = 10.0
"""Unit to which the times of plates are rounded when they are compared. The rounding delays the end of the
last part by little more than this."""


@dataclass(frozen=True)
class FleetPrinter:
    """Printer, with all data that determine whether a plate can be assigned to it."""

    name: str
    capabilities: Capabilities
    bed: Bed
    filament: FilamentState
    link: Link
    is_booked: bool  # a print that has not ended is assigned to it
    attention_reason: str | None  # reason why a person must inspect it; None if none
    maintenance: str | None = None  # reason why a person took it out of use
    is_heating: bool = False
    print_end_s: float | None = None  # expected end of its print
    job: int | None = None  # id of the job that it is printing
    heating_end_s: float | None = None  # expected end of its heat-up
    grams: float | None = None  # filament on its reel, without what its print needs; None: unknown
    is_reel_uncertain: bool = False  # `grams` may be too high
    time_factors: TimeFactors = NOMINAL_TIME_FACTORS  # learned from its prints
    may_print_unattended: bool = True  # may print while nobody is present
    attended_reason: str = ""  # reason why it may not print unattended

    def find_obstacle(self) -> Hold | None:
        """Return the reason why no print can start now; None if the printer is idle and its bed is clear."""
        return self._obstacle

    @cached_property
    def _obstacle(self) -> Hold | None:
        if self.is_booked or self.link is Link.BUSY:
            return Hold(code=HoldCode.PRINTER_BUSY, text=f"{self.name} is printing")
        if self.maintenance is not None:
            return Hold(
                code=HoldCode.MAINTENANCE,
                text=f"{self.name} is in maintenance ({self.maintenance}), until "
                f"`farm maintenance {self.name} --done`",
            )
        if self.attention_reason is not None:
            return Hold(
                code=HoldCode.NEEDS_INSPECTION,
                text=f"inspect {self.name} ({self.attention_reason}), then `farm cleared {self.name}`",
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
                text=f"the position of the filament in {self.name} is unknown: "
                f"`farm cleared {self.name} --filament parked` (or at_nozzle) sets it",
            )
        if self.is_reel_uncertain:
            return Hold(
                code=HoldCode.REEL_UNCERTAIN,
                text=f"the filament left on {self.name} is unknown since the database was restored: "
                f"weigh its reel, then `farm load {self.name} --grams G`",
            )
        return None


@dataclass(frozen=True, slots=True)
class Requirements:
    """Requirements of a plate, or of a job without a plan, on a printer."""

    material: str | None
    colour: str | None
    nozzle_mm: float | None
    box: Box | None = None  # extent of its plate; unknown before it is planned
    family: str | None = None  # printer family that it was sliced for; None: any
    allowed_printers: tuple[str, ...] = ()  # printers that its job requests; empty: any

    @property
    def demand(self) -> Demand:
        """Requirements without the size."""
        return self.material, self.colour, self.nozzle_mm, self.family, self.allowed_printers

    def matches(self, capabilities: Capabilities) -> bool:
        """Return whether a printer with these capabilities meets the requirements."""
        return capabilities.meets(self.demand) and (self.box is None or capabilities.can_contain(self.box))

    def describe(self, mismatched_capabilities: tuple[Capabilities, ...] = ()) -> str:
        """Describe the requirements that capabilities do not meet; all requirements if none are given."""
        texts = []
        if self.material and (
            not mismatched_capabilities
            or not all(kind.has_material(self.material) for kind in mismatched_capabilities)
        ):
            texts.append(self.material)
        if self.colour and (
            not mismatched_capabilities or any(kind.colour != self.colour for kind in mismatched_capabilities)
        ):
            texts.append(self.colour)
        if self.nozzle_mm and (
            not mismatched_capabilities
            or any(kind.nozzle_mm != self.nozzle_mm for kind in mismatched_capabilities)
        ):
            texts.append(f"nozzle {self.nozzle_mm} mm")
        if self.family and (
            not mismatched_capabilities or any(kind.family != self.family for kind in mismatched_capabilities)
        ):
            texts.append(f"a printer of the family {self.family}")
        if self.allowed_printers and (
            not mismatched_capabilities
            or any(kind.requested_name not in self.allowed_printers for kind in mismatched_capabilities)
        ):
            texts.append(" or ".join(self.allowed_printers))
        if self.box is not None:
            x0, y0, x1, y1, height_mm = self.box
            area = f"{x1 - x0:.0f} mm of width, {y1 - y0:.0f} mm of depth"
            needs_height = any(height_mm > kind.height_mm + TOLERANCE_MM for kind in mismatched_capabilities)
            needs_area = any(not kind.can_contain((x0, y0, x1, y1, 0.0)) for kind in mismatched_capabilities)
            if not mismatched_capabilities:
                texts.append(f"{area} and {height_mm:.0f} mm of height")
            else:
                texts += [f"{height_mm:.0f} mm of height"] * needs_height + [area] * needs_area
        return ", ".join(texts)


@dataclass(frozen=True)
class WaitingPlate:
    """Plate that waits for a printer, with all data that determine its assignment."""

    id: str
    requirements: Requirements
    job: int
    planned_printer: str
    expected_s: float  # time on the planned printer, including heating
    priority: int = 0  # plates of a higher priority are printed earlier
    rank: float | None = None  # rank among jobs of equal priority; None for the job's id
    grams: float = 0.0
    overhead_s: float = 0.0  # part of `expected_s` apart from the layers: heat-up, start and end code
    time_factor: float = 1.0  # factor of the planned printer, included in `expected_s`
    feature_shares: Shares | None = None  # shares of the features in the time of its layers
    first_layer_s: float = 0.0  # time from its start to the end of its first layer
    failed_on: frozenset[str] = frozenset()  # printers on which its prints failed
    is_reprint: bool = False  # it was printed before, but the print failed or its part is bad
    extra_printer_count: int | None = None  # number of further printers that its job may use; None: no limit
    not_before_s: float | None = None  # start time of its job; None: as soon as possible
    glue_rank: int = 0  # position of its part in the order of gluing; 0: none
    name: str = ""  # name for people: see `farm.model.name_plate`

    @cached_property
    def priority_key(self) -> tuple[int, float, int, float, int, float, str]:
        """Sort key: priority, order of submission, then the longest first (LPT).

        Plates with the same time, rounded to `TIME_TOLERANCE_S`, are in the order in which they are glued.
        """
        longest_first = -round(self.expected_s / TIME_TOLERANCE_S)
        return *self.queue_rank, longest_first, self.glue_rank, -self.expected_s, self.id

    @cached_property
    def demand(self) -> Demand:
        """Requirements without the size; thousands of plates have few distinct demands."""
        return self.requirements.demand

    @cached_property
    def queue_rank(self) -> tuple[int, float, int]:
        """Sort key of its job."""
        return -self.priority, self.job if self.rank is None else self.rank, self.job


def choose_spares(
    printers: Iterable[FleetPrinter], planned_printers: Collection[str], spare_count: int
) -> frozenset[str]:
    """Choose the tallest free printers for which no waiting plate was planned, at most `spare_count`."""
    free = [p for p in printers if p.name not in planned_printers and p.find_obstacle() is None]
    free.sort(key=lambda p: (p.capabilities.height_mm, p.name), reverse=True)
    return frozenset(printer.name for printer in free[:spare_count])


def may_take_spare(plate: WaitingPlate, fleet: Mapping[str, FleetPrinter]) -> bool:
    """Return whether a plate may take a spare printer: it failed, or its planned printer is out of use."""
    planned_printer = fleet.get(plate.planned_printer)
    if (
        plate.failed_on
        or planned_printer is None
        or not plate.requirements.matches(planned_printer.capabilities)
    ):
        return True
    return (
        planned_printer.maintenance is not None
        or planned_printer.attention_reason is not None
        or planned_printer.link in (Link.ABSENT, Link.FAULT)
    )
