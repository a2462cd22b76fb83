"""What the names of faults mean to the books. The drivers' own names are `drivers.errors.Fault`. Pure."""

from __future__ import annotations

from enum import StrEnum

from drivers.errors import Fault


class OwnFault(StrEnum):
    """Why a print failed, where no agent's word says it."""

    BY_A_PERSON = "by_a_person"  # a person saw it go wrong (`farm fail`)
    PRINT_LOST = "print_lost"  # its agent knows nothing of it any more
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
"""A board, or the way to it, was gone; the others are a printer's own."""
BY_PEOPLE: frozenset[str] = frozenset({OwnFault.BY_A_PERSON, Fault.ESTOP})
"""A person ended the print."""
UNCHARGED: frozenset[str] = BY_PEOPLE | {Fault.HOURS_ENDED, OwnFault.REFUSED}
"""No attempt of a plate: nothing went wrong with it."""
