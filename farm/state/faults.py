"""Classes of faults: losses, and failures that do not count as attempts. Pure.

The names that drivers report are `drivers.errors.Fault`.
"""

from __future__ import annotations

from enum import StrEnum

from drivers.errors import Fault


class FarmFault(StrEnum):
    """Fault of a print that is detected by the farm, not by a driver."""

    BY_A_PERSON = "by_a_person"  # a person saw it go wrong (`farm fail`)
    PRINT_LOST = "print_lost"  # its agent no longer has a record of it
    REFUSED = "refused"  # its agent refused to start it


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
"""Faults in which a board, or the connection to it, was lost."""
FAULTS_BY_PEOPLE: frozenset[str] = frozenset({FarmFault.BY_A_PERSON, Fault.ESTOP})
"""Faults of prints that a person ended."""
UNCOUNTED_FAULTS: frozenset[str] = FAULTS_BY_PEOPLE | {Fault.HOURS_ENDED, FarmFault.REFUSED}
"""Faults that do not count as an attempt of a plate, because the plate is not their cause."""
