"""Groups of faults: losses, and failures that do not count as attempts. Pure.

Drivers report the faults of `drivers.errors.Fault`; the farm itself detects those of `FarmFault`.
"""

from __future__ import annotations

from enum import StrEnum

from drivers.errors import Fault


class FarmFault(StrEnum):
    """Fault of a print that is detected by the farm, not by a driver."""

    BY_A_PERSON = "by_a_person"  # a person saw that the print went wrong (`farm fail`)
    PRINT_LOST = "print_lost"  # the agent has no record of the print
    REFUSED = "refused"  # the agent refused to start the print


LOSSES: frozenset[str] = frozenset(
    {
        Fault.PORT_LOST,
        Fault.AGENT_DIED,
        Fault.NO_ANSWER,
        Fault.REBOOT,
        Fault.KILL,
        FarmFault.PRINT_LOST,
    }
)
"""Faults in which the farm loses a board, or the connection to it."""
FAULTS_BY_PEOPLE: frozenset[str] = frozenset({FarmFault.BY_A_PERSON, Fault.ESTOP})
"""Faults of prints that failed because a person stopped them."""
UNCOUNTED_FAULTS: frozenset[str] = FAULTS_BY_PEOPLE | {Fault.HOURS_ENDED, FarmFault.REFUSED}
"""Faults that do not count as an attempt of a plate, because the plate is not their cause."""
