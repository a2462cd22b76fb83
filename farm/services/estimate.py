"""How long a plate takes on a printer, heat-up, start and end code included."""

from __future__ import annotations

from drivers.profiles import Profile

START_S = 26.0
"""Homing, purging and the moves around them, beside the heat-up. Measured by bench/plate_time.py."""
END_S = 10.0
"""Parking, homing and the last moves, until the head is still. Measured by bench/plate_time.py."""
HOMING_S = 7.0
"""The bed heats while the head homes."""


def plate_seconds(profile: Profile, print_time_s: float, nozzle_c: float, bed_c: float) -> float:
    """Seconds from the first command of a print to its last.

    Parameters
    ----------
    profile
        The printer model, for its heaters.
    print_time_s
        What the slicer says the layers take.
    nozzle_c, bed_c
        First-layer temperatures. The bed heats first, as the start code says, and then the nozzle.
    """
    bed_s = max(0.0, profile.bed.seconds_to(bed_c) - HOMING_S)
    return START_S + bed_s + profile.nozzle.seconds_to(nozzle_c) + print_time_s + END_S
