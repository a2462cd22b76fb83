"""Expected time of a plate on a printer, including heat-up, start and end code."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

from drivers.printers import PROFILES, Profile
from farm.config import PrinterSection
from slicing.settings import EngineSettings

START_CODE_S = 26.0
"""Time of homing, purging and the moves around them, without heat-up (bench/printing/plate_time.py)."""
END_CODE_S = 10.0
"""Time of parking, homing and the last moves, until the head is still (bench/printing/plate_time.py)."""
HOMING_S = 7.0
"""Time of the homing, during which the bed heats."""


def compute_plate_seconds(
    profile: Profile, sliced_s: float, nozzle_c: float, bed_c: float, time_factor: float = 1.0
) -> float:
    """Return the seconds from the first command of a print to its last.

    Parameters
    ----------
    profile
        The printer model, for its heaters.
    sliced_s
        Time of the layers according to the slicer.
    nozzle_c, bed_c
        First-layer temperatures. The start code heats the bed first, then the nozzle.
    time_factor
        Ratio of the printer's time for layers to their sliced time (farm.state.printer_speed).
    """
    bed_s = max(0.0, profile.bed.compute_heating_s(bed_c) - HOMING_S)
    return (
        START_CODE_S
        + bed_s
        + profile.nozzle.compute_heating_s(nozzle_c)
        + sliced_s * time_factor
        + END_CODE_S
    )


def compute_overhead_s(section: PrinterSection, settings: EngineSettings) -> float:
    """Return the seconds that a plate takes on a printer in addition to the time of its layers."""
    return compute_plate_seconds(PROFILES[section.model], 0.0, settings.nozzle_c, settings.bed_c)


def reassign_loads(
    loads_s: Mapping[str, float], kinds: Mapping[str, Hashable], time_factors: Mapping[str, float]
) -> dict[str, str]:
    """Exchange the loads of printers of one kind, so that the fastest printer has the largest load.

    Parameters
    ----------
    loads_s
        Load of each printer in the plan, in seconds, by name; 0 for a printer without an entry.
    kinds
        Kind of each usable printer, by name.
    time_factors
        Time factors of the printers, by name; 1 for a printer without an entry.

    Returns
    -------
    dict
        For each printer, the printer that gets its load: a permutation.
    """
    new_owners: dict[str, str] = {}
    for kind in set(kinds.values()):
        names = sorted(name for name in kinds if kinds[name] == kind)
        factors = {name: time_factors.get(name, 1.0) for name in names}
        if len(set(factors.values())) > 1:
            names_by_load = sorted(names, key=lambda name: -loads_s.get(name, 0.0))
            new_owners |= dict(zip(names_by_load, sorted(names, key=factors.__getitem__), strict=True))
        else:
            new_owners |= dict(zip(names, names, strict=True))
    return new_owners
