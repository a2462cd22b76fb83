"""How long a plate takes on a printer, heat-up, start and end code included."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

from drivers.printers import PROFILES, Profile
from farm.config import PrinterSection
from slicing.settings import EngineSettings

START_S = 26.0
"""Homing, purging and the moves around them, beside the heat-up. Measured by bench/plate_time.py."""
END_S = 10.0
"""Parking, homing and the last moves, until the head is still. Measured by bench/plate_time.py."""
HOMING_S = 7.0
"""The bed heats while the head homes."""


def plate_seconds(
    profile: Profile, print_time_s: float, nozzle_c: float, bed_c: float, factor: float = 1.0
) -> float:
    """Seconds from the first command of a print to its last.

    Parameters
    ----------
    profile
        The printer model, for its heaters.
    print_time_s
        What the slicer says the layers take.
    nozzle_c, bed_c
        First-layer temperatures. The bed heats first, as the start code says, and then the nozzle.
    factor
        What was learned of the printer (farm.state.time_factor); of its layers alone.
    """
    bed_s = max(0.0, profile.bed.seconds_to(bed_c) - HOMING_S)
    return START_S + bed_s + profile.nozzle.seconds_to(nozzle_c) + print_time_s * factor + END_S


def prelude_seconds(section: PrinterSection, settings: EngineSettings) -> float:
    """What a plate takes on this printer beside its layers."""
    return plate_seconds(PROFILES[section.model], 0.0, settings.nozzle_c, settings.bed_c)


def quickest_first(
    loads_s: Mapping[str, float], kinds: Mapping[str, Hashable], factors: Mapping[str, float]
) -> dict[str, str]:
    """Which printer takes whose work, so that the most of it goes to the quickest of equal printers.

    Parameters
    ----------
    loads_s
        What a plan gives each printer to print, in seconds; of those that are not named, nothing.
    kinds
        What each printer can print, for every printer that may be used: work moves only among equals.
    factors
        What was learned of each printer; 1 where nothing was.

    Returns
    -------
    dict
        For every printer, the one that takes its work: a permutation.
    """
    takes: dict[str, str] = {}
    for kind in set(kinds.values()):
        names = sorted(name for name in kinds if kinds[name] == kind)
        speeds = {name: factors.get(name, 1.0) for name in names}
        if len(set(speeds.values())) > 1:
            loaded = sorted(names, key=lambda name: -loads_s.get(name, 0.0))
            takes |= dict(zip(loaded, sorted(names, key=speeds.__getitem__), strict=True))
        else:
            takes |= dict(zip(names, names, strict=True))
    return takes
