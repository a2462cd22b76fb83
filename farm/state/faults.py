"""Faults as the books see them: losses, and failures that are not charged. Pure.

The names that drivers report are `drivers.errors.Fault`.
"""

from __future__ import annotations

from enum import StrEnum

from drivers.errors import Fault


class OwnFault(StrEnum):
    """Fault of a print that the farm finds, not a driver."""

    BY_A_PERSON = "by_a_person"  # a person saw it go wrong (`farm fail`)
    PRINT_LOST = "print_lost"  # its agent has no record of it any more
    REFUSED = "refused"  # its agent would not start it


LOSSES: frozenset[str] = frozenset(
    {
        Fault.PORT_LOST,
        Fault.AGENT_DIED,
        Fault.NO_ANSWER,
        Fault.REBOOT,
        Fault.KILL,
        OwnFault.PRINT_LOST,
    }
)
"""Faults in which a board, or the connection to it, was lost."""
BY_PEOPLE: frozenset[str] = frozenset({OwnFault.BY_A_PERSON, Fault.ESTOP})
"""Faults where a person ended the print."""
UNCHARGED: frozenset[str] = BY_PEOPLE | {Fault.HOURS_ENDED, OwnFault.REFUSED}
"""Faults that do not count as an attempt of a plate: nothing was wrong with it."""
