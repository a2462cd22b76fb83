"""Recorded state of printers: bed, filament and reel; their temperatures; outages of several printers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from farm.model.entity import Entity
from farm.model.plate import FeatureFactors, TimeFactors


class Bed(StrEnum):
    """State of a printer's bed."""

    CLEAR = "clear"
    NOT_CLEAR = "not_clear"
    UNKNOWN = "unknown"


class FilamentState(StrEnum):
    """Position of the tip of the filament."""

    PARKED = "parked"
    AT_NOZZLE = "at_nozzle"
    UNKNOWN = "unknown"


class Reel(Entity):
    """Filament on a printer, and its nozzle, as last reported by a person."""

    material: str
    kind: str | None = None  # kind of the material, such as PLA; None: unknown
    colour: str | None = None
    grams: float | None = None  # remaining filament; None: unknown
    nozzle_mm: float
    uncertain: bool = False  # True if `grams` is from a backup; later prints may have used some


class HostLoss(Entity):
    """Loss of the connection to a host with printers; their prints may continue."""

    host: str
    at_s: float  # time of the first loss, if several hosts were lost together
    reason: str


class Printer(Entity):
    """Recorded state of a printer; everything else is telemetry."""

    name: str
    bed: Bed = Bed.NOT_CLEAR
    filament: FilamentState = FilamentState.UNKNOWN
    attention_reason: str | None = None  # reason why a person has to inspect it before the next print
    attention_since_s: float | None = None  # time since which it needs inspection
    alarm: str | None = None  # its agent's last report of a heater that cannot be switched off
    alarm_s: float | None = None  # time of that report
    maintenance: str | None = None  # reason why a person has taken it out of use
    disconnected_at_s: float | None = None  # time at which the connection to its board was lost
    host_loss: HostLoss | None = None  # loss of the connection to its host; None while connected
    restored_s: float | None = None  # time at which the database was restored from a backup
    unreported_since_s: float | None = None  # time of the restored backup; None after its agent's report
    reel: Reel | None = None  # None: the reel in fleet.yaml
    time_factor: float = 1.0  # ratio of actual to sliced time of its layers, learned from its prints
    feature_factors: FeatureFactors | None = None  # the same ratio by feature; None: too few prints so far

    @property
    def time_factors(self) -> TimeFactors:
        """Ratios of actual to sliced time on this printer, overall and by feature."""
        by_feature = None if self.feature_factors is None else self.feature_factors.factors
        return TimeFactors(self.time_factor, by_feature)


class Outage(Entity):
    """Loss of several printers at the same time. No print starts until a person has confirmed the outage."""

    id: int
    at_s: float
    printers: tuple[str, ...]
    confirmed_s: float | None = None


@dataclass(frozen=True, slots=True)
class Temperatures:
    """Highest readings within a minute, in whole degrees Celsius, and the last targets; None: no reading."""

    at_s: float
    nozzle_c: int | None
    bed_c: int | None
    nozzle_target_c: int | None
    bed_target_c: int | None
