"""Printers as the books have them: bed, filament and reel; and outages of several."""

from __future__ import annotations

from enum import StrEnum

from farm.model.entity import Entity


class Bed(StrEnum):
    CLEAR = "clear"
    NOT_CLEAR = "not_clear"
    UNKNOWN = "unknown"


class FilamentState(StrEnum):
    PARKED = "parked"
    AT_NOZZLE = "at_nozzle"
    UNKNOWN = "unknown"


class Reel(Entity):
    """Filament on a printer, and its nozzle, as a person reported last."""

    material: str
    colour: str | None = None
    grams: float | None = None  # left; None: nobody said
    nozzle_mm: float
    doubted: bool = False  # `grams` are of a copy of the books: prints may have taken of them since


class Printer(Entity):
    """State of a printer in the books; the rest is telemetry."""

    name: str
    bed: Bed = Bed.NOT_CLEAR
    filament: FilamentState = FilamentState.UNKNOWN
    attention_reason: str | None = None  # why a person has to look before it prints again
    attention_since_s: float | None = None  # since when
    alarm: str | None = None  # what its agent last said of a heater that cannot be switched off
    alarm_s: float | None = None  # when it said so
    maintenance: str | None = None  # why a person has taken it out of use
    disconnected_at_s: float | None = None  # when its board was last found to be gone
    restored_s: float | None = None  # when its books were last put back from a copy
    unreported_since_s: float | None = None  # the books are a copy; its agent has not reported since
    reel: Reel | None = None  # None: as fleet.yaml says
    time_factor: float = 1.0  # its layers' time, reached over expected, as learned from its prints


class Outage(Entity):
    """Loss of several printers at once. Nothing starts until a person has confirmed that all is well."""

    id: int
    at_s: float
    printers: tuple[str, ...]
    confirmed_s: float | None = None
